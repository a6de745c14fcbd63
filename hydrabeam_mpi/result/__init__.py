"""What is written of an inference: numbers, maps, files."""
