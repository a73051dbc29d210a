"""The phase diagram of optic cups: regimes, fits of the scaling laws, transitions.

Only rows of numbers are used, whoever computed them; NumPy and SciPy are all that is needed.
"""
