"""The kinds of values that a job file holds: quantities with units, ranges, names, files."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, ValidationInfo

from hydrabeam_mpi.data.limits import FIRST_JD, LARGEST, LAST_JD, RADIO


@dataclass(frozen=True)
class Quantity:
    """Takes a plain number in ``unit``, or text with any unit of the same kind."""

    what: str
    unit: str
    example: str

    def __call__(self, value: Any) -> float:
        """Return the number in ``unit``."""
        expected = f"{self.what}, a number in {self.unit} or text such as '{self.example}'"
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise ValueError(expected)
        try:
            return _parse(value, self.unit) if isinstance(value, str) else float(value)
        except Exception as error:  # astropy raises whatever the arithmetic in a text raises
            raise ValueError(expected) from error


def _parse(text: str, unit: str) -> float:
    """Return the number in ``unit`` that a text names."""
    from astropy import units  # only where a text is parsed, as it takes half a second

    quantity = units.Quantity(text)
    if quantity.unit == units.dimensionless_unscaled:
        return float(quantity.value)
    # An hour of sidereal time is an hour of angle.
    target, same = (units.hourangle, [(units.h, units.hourangle)]) if unit == "h" else (unit, [])
    # In as many digits as a decimal number keeps: 360 deg are 24 h, not 24.000000000000004.
    return float(f"{quantity.to_value(target, same):.15g}")


Bandwidth = Annotated[float, BeforeValidator(Quantity("a frequency", "Hz", "131 MHz")), Field(gt=0, le=RADIO[1])]
Hertz = Annotated[Bandwidth, Field(ge=RADIO[0])]
Metres = Annotated[float, BeforeValidator(Quantity("a length", "m", "14.6 m"))]
Seconds = Annotated[float, BeforeValidator(Quantity("a time", "s", "10 s"))]
Jansky = Annotated[float, BeforeValidator(Quantity("a flux density", "Jy", "0.1 Jy"))]
Degrees = Annotated[float, BeforeValidator(Quantity("an angle", "deg", "90 deg"))]
SiderealHours = Annotated[float, BeforeValidator(Quantity("a sidereal time", "h", "6 h")), Field(ge=0, le=24)]
JulianDate = Annotated[float, Field(ge=FIRST_JD, le=LAST_JD)]
Polarization = Literal["ee", "nn", "en", "ne", "xx", "yy", "xy", "yx"]
AntennaPair = tuple[int, int]


def _ascends(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError("[from, to] with the lower value first")
    return pair


def _is_some_time(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] == pair[1]:
        raise ValueError("[from, to] with two different times, [0, 24] for a whole day")
    return pair


def _are_distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(set(values)) < len(values):
        raise ValueError("a list that names each value once")
    return values


# From greater to smaller wraps through 24 h.
LstRange = Annotated[tuple[SiderealHours, SiderealHours], AfterValidator(_is_some_time)]
JdRange = Annotated[tuple[JulianDate, JulianDate], AfterValidator(_ascends)]
FreqRange = Annotated[tuple[Hertz, Hertz], AfterValidator(_ascends)]
Flux = Annotated[Jansky, Field(ge=1 / LARGEST, le=LARGEST)]
FluxRange = Annotated[tuple[Flux, Flux], AfterValidator(_ascends)]
Freqs = Annotated[tuple[Hertz, ...], AfterValidator(_are_distinct), Field(min_length=1)]
# One of something is written without a list.
OneOrMore = (
    BeforeValidator(lambda values: tuple(values) if isinstance(values, list | tuple) else (values,)),
    PlainSerializer(lambda values: values[0] if len(values) == 1 else values),
)
Polarizations = Annotated[tuple[Polarization, ...], *OneOrMore, AfterValidator(_are_distinct), Field(min_length=1)]


def from_job(name: Any, info: ValidationInfo) -> Any:
    """Take a file name, text or Path, as relative to the folder of the job, if the validation's context names it."""
    if not str(name).strip() or name == Path():
        raise ValueError("a file name, not an empty text")
    folder = (info.context or {}).get("folder")
    return name if folder is None else type(name)(folder / os.path.expanduser(name))


File = Annotated[Path, AfterValidator(from_job)]
FilePatterns = tuple[Annotated[str, AfterValidator(from_job)], ...]
