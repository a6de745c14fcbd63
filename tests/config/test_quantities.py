from __future__ import annotations

from typing import Annotated, Any

import pytest
from pydantic import TypeAdapter, ValidationError

from hydrabeam_mpi.config.quantities import (
    Degrees,
    File,
    FilePatterns,
    FluxRange,
    FreqRange,
    Freqs,
    Hertz,
    Jansky,
    JdRange,
    LstRange,
    Metres,
    Seconds,
    SiderealHours,
)


def parse(kind: Any, value: Any) -> Any:
    return TypeAdapter(Annotated[kind, "as in a job"]).validate_python(value)


@pytest.mark.parametrize(
    ("kind", "value", "expected"),
    [
        (Hertz, "131 MHz", 131e6),
        (Hertz, "97.65625 kHz", 97656.25),
        (Hertz, 131e6, 131e6),
        (Hertz, 131000000, 131e6),
        (Hertz, "131e6", 131e6),
        (Metres, "14.6 m", 14.6),
        (Metres, "1 cm", 0.01),
        (Metres, 0, 0.0),
        (Seconds, "10 s", 10.0),
        (Seconds, "1.5 min", 90.0),
        (Jansky, "100 mJy", 0.1),
        (Degrees, "-30.7215 deg", -30.7215),
        (Degrees, "0.5 rad", 28.6478897565412),
        (SiderealHours, "6 h", 6.0),
        (SiderealHours, "6 hourangle", 6.0),
        (SiderealHours, "90 deg", 6.0),
        (SiderealHours, 6.5, 6.5),
        (SiderealHours, "360 deg", 24.0),
        (LstRange, ("23 h", "1 h"), (23.0, 1.0)),
        (LstRange, (0, 24), (0.0, 24.0)),
        (FreqRange, ("100 MHz", 200e6), (100e6, 200e6)),
        (Freqs, ("131 MHz", "129 MHz"), (131e6, 129e6)),
    ],
)
def test_understood(kind: Any, value: Any, expected: Any) -> None:
    assert parse(kind, value) == expected


@pytest.mark.parametrize(
    ("kind", "value", "words"),
    [
        (Hertz, "131 m", "a frequency, a number in Hz or text such as '131 MHz'"),
        (Hertz, "131 megaherz", "a frequency"),
        (Hertz, "MHz", "greater than 0|a frequency"),
        (Hertz, "", "a frequency"),
        (Hertz, True, "a frequency"),
        (Hertz, [131e6], "a frequency"),
        (Hertz, -131e6, "greater than 0"),
        (Hertz, "0 Hz", "greater than 0"),
        (Metres, "14.6 s", "a length, a number in m"),
        (Seconds, "10 m", "a time, a number in s"),
        (Jansky, "1 K", "a flux density, a number in Jy"),
        (Degrees, "1 h", "an angle, a number in deg"),
        (SiderealHours, "6h30m", "a sidereal time, a number in h"),
        (SiderealHours, "6 m", "a sidereal time"),
        (SiderealHours, 90, "less than or equal to 24"),
        (SiderealHours, -1, "greater than or equal to 0"),
        (LstRange, (6, "90 deg"), "two different times"),
        (JdRange, (2459867.0, 2459866.0), "lower value first"),
        (JdRange, (59866.0, 59867.0), "greater than or equal to 2437665"),
        (FreqRange, (200e6, 100e6), "lower value first"),
        (FluxRange, (10, 1), "lower value first"),
        (FluxRange, (0, 1), "greater than or equal to 0.0000"),
        (Freqs, (131e6, "131 MHz"), "each value once"),
        (Freqs, (), "at least 1"),
        (File, "", "a file name, not an empty text"),
        (FilePatterns, ["a.uvh5", " "], "a file name, not an empty text"),
    ],
)
def test_refused(kind: Any, value: Any, words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        parse(kind, value)
