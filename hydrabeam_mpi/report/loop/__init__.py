"""The loop's part of the page."""
