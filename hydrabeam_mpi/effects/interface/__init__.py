"""What every effect offers, and what it may see of the data."""
