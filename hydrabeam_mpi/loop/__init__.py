"""Closing the loop: what is left of the data, which effect it comes from, and the model with that effect."""
