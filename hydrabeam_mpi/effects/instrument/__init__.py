"""Effects of antennas, cables, clocks and of the basis of the beam; one a module."""
