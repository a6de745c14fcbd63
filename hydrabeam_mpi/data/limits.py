"""Limits that hold for all observations: what lies beyond them was not measured, but misread or damaged."""

from __future__ import annotations

# 1962 to 2100: beyond, the rotation of the Earth is not known or guessed.
FIRST_JD, LAST_JD = 2437665.0, 2488070.0
# Metres above or below sea level. The ground is within 9 km of it; a location on a sphere for Earth is 22 km off.
MAX_HEIGHT = 100e3
# Metres between two antennas on Earth.
EARTH_DIAMETER = 12.8e6
# Hz: the bands 4 to 12 in which the ITU divides the radio spectrum.
RADIO = (3e3, 3e12)
# Visibilities in Jy, counts of a correlator, gains, nsamples: a transmitter of 1 kW in 1 Hz a metre away is 1e28 Jy.
# Products of four such numbers are within reach of double precision, and so are those of their inverses.
LARGEST = 1e30
