"""What the loop says and writes."""
