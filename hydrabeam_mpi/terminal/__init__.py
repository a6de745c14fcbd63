"""The console: what is said there, how far things are, and how a run is interrupted."""
