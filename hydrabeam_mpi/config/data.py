"""The table ``[data]`` of a job: which visibilities."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from hydrabeam_mpi.config.base import Section, key
from hydrabeam_mpi.config.quantities import (
    AntennaPair,
    Bandwidth,
    FilePatterns,
    FreqRange,
    Freqs,
    JdRange,
    LstRange,
    Metres,
    OneOrMore,
    Polarizations,
)
from hydrabeam_mpi.config.simulation import Simulate
from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.errors import InputError

Scales = Annotated[tuple[Annotated[float, Field(ge=1 / LARGEST, le=LARGEST)], ...], *OneOrMore, Field(min_length=1)]
"""One for all channels, written as a number, or one for each."""


class Data(Section):
    """Which visibilities: files and a selection of them, or a simulation."""

    files: FilePatterns = key((), "uvh5, uvfits, measurement sets or miriad; wildcards allowed")
    simulate: Simulate | None = None
    polarization: Polarizations = key(
        ("ee",),
        "e, n by direction where the files tell it, else x, y by feed; to infer several at once, a list",
    )
    pol_convention: Literal["sum", "avg"] | None = key(
        None, "of files that do not state it: 'sum' is V = I B / 2, 'avg' is V = I B; gains that state it overrule this"
    )
    gains: FilePatterns = key((), "calfits or calh5 to apply; wildcards allowed")
    antennas: tuple[int, ...] | None = key(None, "keep only these")
    exclude_antennas: tuple[int, ...] = key((), "leave these out")
    antpairs: tuple[AntennaPair, ...] | None = key(None, "keep only these baselines, [[ant1, ant2], ...]")
    exclude_baselines: tuple[AntennaPair, ...] = key((), "take these as flagged, [[ant1, ant2], ...]")
    exclude_times: tuple[JdRange, ...] = key((), "JD, take integrations within as flagged, [[from, to], ...]")
    flux_scale: Scales = key(
        (1.0,), "factor that brings data and their noise to Jy, where they are not: a number, or a list, one a channel"
    )
    lst_range: LstRange | None = key(None, "h, [from, to]; may wrap through 24 h")
    time_range: JdRange | None = key(None, "JD, [from, to], to keep")
    every_time: int = key(1, "keep one in so many of the integrations that are left", ge=1)
    freq_range: FreqRange | None = key(None, "Hz, [from, to]")
    freqs: Freqs | None = key(None, "Hz, the nearest channels")
    channels: tuple[Annotated[int, Field(ge=0)], ...] | None = key(None, "by number, from 0")
    channel_width: Bandwidth | None = key(None, "Hz, where the files are wrong about it")
    smearing: bool = key(False, "whether data are means over their integrations and channels, or of an instant each")
    min_bl_length: Metres = key(0.0, "m, shorter baselines are left out", ge=0)
    max_bl_length: Metres | None = key(None, "m, longer ones are left out", gt=0)
    redundancy_tol: Metres = key(1e-7, "m, within which baselines are the same", gt=0)

    @property
    def pol(self) -> str:
        """The one polarisation.

        Raises
        ------
        InputError
            If there are several.
        """
        if len(self.polarization) > 1:
            raise InputError(
                f"has {len(self.polarization)} polarisations, and this takes one at a time",
                field="[data] polarization",
                remedy=f'set polarization = "{self.polarization[0]}"',
            )
        return self.polarization[0]

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if bool(self.files) == (self.simulate is not None):
            raise ValueError("no data; give either files = [...] or a [data.simulate] table")
        fixed = ("gains", "pol_convention", "freq_range", "freqs", "channels", "channel_width")
        given = next((key for key in fixed if getattr(self, key)), None)
        if self.simulate is not None and given:
            raise ValueError(f"{given} is for data from files; leave it out, or set it in [data.simulate]")
        return self
