"""Figures of the beam and its posterior."""
