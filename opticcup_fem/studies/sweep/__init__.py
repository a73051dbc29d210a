"""Parameter studies: tasks, their cache, the pool that computes them, and tables of results."""
