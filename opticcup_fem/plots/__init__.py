"""Pictures of a run, made from its records only."""
