"""Figures of the data: visibilities with model and residual, their spectra, the array and the sources."""
