"""Effects of the sky and of what lies before it; one a module."""
