"""Numerical experiments: each runs a case and writes its records."""
