"""What the instrument or the sky may do and the model lacks: one file an effect, one protocol (`base`)."""
