"""Chains: whether they mix, and what beam and sky, gains and noise owe to each other."""
