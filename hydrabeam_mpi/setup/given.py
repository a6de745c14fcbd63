"""What is in memory instead of in the files that a job names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hydrabeam_mpi.inference.prior import Prior
from hydrabeam_mpi.io.inferred import Inferred
from hydrabeam_mpi.io.uvsource import UVInMemory


@dataclass(frozen=True, eq=False)
class Given:
    """Objects in place of files; where there is none, the job says what is read.

    Attributes
    ----------
    data : tuple of UVInMemory
        In place of ``[data] files``.
    beam : pyuvdata.UVBeam, pyuvdata.BeamInterface or pyuvdata analytic beam, optional
        In place of ``[beam] source``.
    sky : pyradiosky.SkyModel, optional
        In place of ``[sky] file``.
    noise : UVInMemory, optional
        Sigma (Jy) of each visibility, in place of ``[noise] file``.
    priors : sequence of Prior, optional
        One for all channels or one for each, in place of ``[prior] file``.
    earlier : Inferred, optional
        A result, in place of ``[prior] file``.
    """

    data: tuple[UVInMemory, ...] = ()
    beam: Any = None
    sky: Any = None
    noise: UVInMemory | None = None
    priors: Sequence[Prior] | None = None
    earlier: Inferred | None = None

    @property
    def fields(self) -> frozenset[str]:
        """The keys of a job that name no file because of these."""
        named = {
            "[data] files": bool(self.data),
            "[beam] source": self.beam is not None,
            "[sky] file": self.sky is not None,
            "[noise] file": self.noise is not None,
            "[prior] file": self.priors is not None or self.earlier is not None,
        }
        return frozenset(field for field, is_given in named.items() if is_given)


NOTHING = Given()
"""All is in files, or built in."""
