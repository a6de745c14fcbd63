"""What is left in the data after a fit: sums, statistics, where it is, what it looks like."""
