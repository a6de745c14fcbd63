"""Effects of antennas, cables and clocks, and of the beam's basis; one per module."""
