"""The paper, figure by figure, from computations of our own."""
