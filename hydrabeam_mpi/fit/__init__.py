"""The fit: rows into sums, sums into posteriors, over ranks."""
