"""Pieces that several effects are made of."""
