"""Hostile input: seeded damage to every kind of file that is read, kills at random moments, a disk that is full."""
