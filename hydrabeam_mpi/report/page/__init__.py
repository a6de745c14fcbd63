"""The page: its sections, words, style, and what it reads."""
