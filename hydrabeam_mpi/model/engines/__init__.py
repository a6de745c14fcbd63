"""The visibility engines by the names that a job gives them; a new one has a file here and a line in `ENGINES`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.extras import check_extra
from hydrabeam_mpi.registry import Registry

if TYPE_CHECKING:
    from hydrabeam_mpi.data.observation import FloatArray
    from hydrabeam_mpi.model.engines.base import Engine
    from hydrabeam_mpi.model.engines.smearing import Smearing

ENGINES: Registry[Engine] = Registry("hydrabeam_mpi.model.engines", "gemm", "nufft", "auto", ending="Engine")


def make_engine(
    kind: str, vectors: FloatArray, points: FloatArray | None = None, smearing: Smearing | None = None
) -> Engine:
    """Build the engine of that name.

    Parameters
    ----------
    kind : str
        One of `ENGINES`.
    vectors : ndarray, (Nvectors, 3)
        Baseline vectors in metres ENU.
    points : ndarray, (Npoints, 3), optional
        Where antennas stand: fringes of their differences take fewer exponentials.
    smearing : Smearing, optional
        Over what visibilities are means.

    Raises
    ------
    InputError
        If `check_engine` does.
    """
    check_engine(kind, smearing is not None)
    engine = ENGINES[kind](vectors)
    engine.points, engine.smearing = points, smearing
    return engine


def check_engine(kind: str, is_smeared: bool = False) -> None:
    """Make sure that there is an engine of that name, and what it needs.

    Raises
    ------
    InputError
        If there is none of that name, a package that it needs is not installed, or visibilities that are means over
        integrations and channels are asked of one that has them of one instant and frequency only.
    """
    if kind not in ENGINES:
        raise InputError(f"unknown engine {kind!r}", field="[solver] engine", remedy=f"known: {', '.join(ENGINES)}")
    if kind != "gemm":
        check_extra("nufft", "[solver] engine")
    if kind == "nufft" and is_smeared:
        told = "'nufft' has visibilities of one instant and one frequency, and [data] smearing asks for means"
        raise InputError(told, field="[solver] engine", remedy="set engine = 'gemm' or 'auto'")
