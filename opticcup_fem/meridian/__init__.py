"""The meridian model: axisymmetric shells as curves, and their stability in every wavenumber."""
