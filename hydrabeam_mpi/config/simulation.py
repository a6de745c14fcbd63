"""The tables of a job file that describe a simulation."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from hydrabeam_mpi.config.base import Section, key, refuse_unused
from hydrabeam_mpi.config.effects import Injected
from hydrabeam_mpi.config.quantities import Bandwidth, Degrees, File, Freqs, JulianDate, LstRange, Metres, Seconds
from hydrabeam_mpi.data.limits import EARTH_DIAMETER, LARGEST, MAX_HEIGHT


class Array(Section):
    """The antennas of a simulation: a hexagon, or positions from a file."""

    hex: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]] = key(
        (4, 7), "antennas in the first and in the middle row"
    )
    spacing: Metres = key(14.6, "m between neighbours", gt=0, le=EARTH_DIAMETER)
    file: File | None = key(None, "text, CSV or uvh5 with positions (m ENU), instead of the hexagon")

    @model_validator(mode="after")
    def _is_a_hexagon(self) -> Self:
        for name in ("hex", "spacing") if self.file else ():
            if getattr(self, name) != type(self).model_fields[name].default:
                refuse_unused(self, name, "a hexagon", "positions from a file")
        side, diagonal = self.hex
        if diagonal < max(side, 2):
            raise ValueError(f"hex = [{side}, {diagonal}] is no array; give [first row, middle row], such as [4, 7]")
        return self


class Perturbation(Section):
    """The perturbed beam of HDBI II, eqs 15 to 22; stretch 1 and sidelobe 0 leave the beam as it is."""

    stretch: tuple[Annotated[float, Field(ge=1, le=LARGEST)], Annotated[float, Field(ge=1, le=LARGEST)]] = key(
        (1.01, 1.02), "of the main lobe along East-West and North-South"
    )
    sidelobe: float = key(0.2, "largest relative modulation of the sidelobes", ge=0, le=LARGEST)


class Simulate(Section):
    """Mock data as in HDBI II, section 3: array, times, channels, perturbed beam and noise."""

    array: Array = Array()
    latitude: Degrees = key(-30.7215, "deg, of the array", ge=-90, le=90)
    longitude: Degrees = key(21.4283, "deg East", ge=-180, le=360)
    height: Metres = key(1051.69, "m, above the ellipsoid", ge=-MAX_HEIGHT, le=MAX_HEIGHT)
    start: JulianDate = key(2459866.0, "JD after which the first LST comes first")
    lst_range: LstRange = key((6.0, 12.0), "h, the last excluded")
    n_times: int = key(60, "of a night, evenly spaced in LST", ge=1)
    nights: int = key(1, "one after the other, of the same LSTs", ge=1)
    freqs: Freqs = key((131e6,), "Hz, ascending")
    channel_width: Bandwidth = key(100e3, "Hz, by which noise is averaged")
    integration_time: Seconds = key(10.0, "s, likewise", gt=0, le=86400)
    nsamples: float = key(100.0, "integrations averaged, such as nights", gt=0, le=LARGEST)
    noise: bool = key(True, "add noise by the radiometer equation")
    perturb: Perturbation = Perturbation()
    effects: tuple[Injected, ...] = ()

    @model_validator(mode="after")
    def _ascends(self) -> Self:
        if list(self.freqs) != sorted(self.freqs):
            raise ValueError("freqs do not ascend; sort them")
        return self

    @model_validator(mode="after")
    def _has_a_sample(self) -> Self:
        if (samples := self.channel_width * self.integration_time * self.nsamples) < 1:
            raise ValueError(
                f"channel_width, integration_time and nsamples give {samples:.3g} independent samples, less than one"
                "; make one of them larger"
            )
        return self
