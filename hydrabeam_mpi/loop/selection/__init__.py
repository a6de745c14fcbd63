"""Which effect is tried, accepted and kept, round after round."""
