"""Chains of draws from the joint posterior of beam, sky, gains, noise and effects."""
