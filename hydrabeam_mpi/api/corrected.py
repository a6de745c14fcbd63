"""What data are without the instrument's effects, and the files that have it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.api.applied import Applied
from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.fit.taken_out import Parts
from hydrabeam_mpi.io.calwrite import write_gains
from hydrabeam_mpi.io.uvdata import Block
from hydrabeam_mpi.io.uvwrite import uvh5_in_parts

WHAT = {
    "corrected": "Visibilities without the instrument's effects: (V / (g_i g_j*) - added).",
    "model": "The sky as the inferred beam sees it: corrected visibilities without residual.",
    "residual": "Corrected visibilities minus their model.",
    "added": "What effects had added to the visibilities before the gains multiplied them.",
}
"""The files of visibilities, and their histories."""
ALONE = "The job named no gains to divide the data by before."


@dataclass(frozen=True)
class Correction(Applied):
    """Data, and what of them is the instrument's: V = g_i g_j* (corrected + added), corrected = model + residual.

    On ranks other than 0 there is nothing in it but the job.

    Attributes
    ----------
    job : Job
        The data.
    observation : Observation, optional
    visibilities : dict
        ``corrected``, ``model``, ``residual`` and ``added``, each (Nfreqs, Ntimes, Nbls, 1), Jy, in the convention
        V = 1/2 I B; zero where flagged.
    flags : ndarray of bool, same shape
        True where nothing is known: where the data, or the gains that the job names, are flagged or have no samples or
        noise, in what the job excludes or the result left out, and on all baselines of bad antennas.
    nsamples : ndarray, same shape
        As the data have them.
    autos : ndarray, (Nfreqs, Ntimes, Nants, Nfeeds)
        Corrected autocorrelations, Jy; zero where flagged, NaN where there are none.
    auto_flags, auto_nsamples : ndarray, same shape as ``autos``
        Likewise.
    gains : ndarray of complex, (Nfreqs, Ntimes, Nants)
        The factors g of the feed or feeds of the setup's polarisation, of antennas in the order of
        ``observation.antenna_numbers``. Relative to the gains that ``[data] gains`` of the job names, by which, and by
        ``flux_scale``, data have been calibrated before; total where it names none.
    gain_flags : ndarray of bool, same shape
        Of bad antennas, and of gains that single times have of their own and the result does not tell. What these
        gains are part of is flagged, too.
    bad_antennas : frozenset of int
        Numbers of antennas of which all is flagged, in ``gains.calfits``, too.
    data_history : str
        What the files of the data say of themselves.
    summary : dict
        What ``correction.json`` says: titles of the effects that are ``taken_out``, which hold in these data, what is
        ``flagged``, and warnings.
    about : dict
        Where it comes from.
    """

    told_in = "correction.json"
    observation: Observation | None = None
    visibilities: dict[str, ComplexArray] = field(default_factory=dict)
    flags: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    nsamples: FloatArray = field(default_factory=lambda: np.zeros(0))
    autos: FloatArray = field(default_factory=lambda: np.zeros(0))
    auto_flags: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    auto_nsamples: FloatArray = field(default_factory=lambda: np.zeros(0))
    gains: ComplexArray = field(default_factory=lambda: np.zeros(0, dtype=complex))
    gain_flags: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    bad_antennas: frozenset[int] = frozenset()
    data_history: str = ""

    @property
    def auto_block(self) -> Block:
        """The autocorrelations as they are written."""
        stored = ~np.isnan(self.autos)
        return Block(np.nan_to_num(self.autos).astype(complex), self.auto_flags, self.auto_nsamples, stored)

    @property
    def histories(self) -> dict[str, str]:
        """What the files of visibilities, and ``gains``, say of themselves, after what the data's own files say."""
        taken = "; ".join(self.summary["taken_out"]) or "none"
        by = f"hydrabeam_mpi {self.about['versions']['hydrabeam_mpi']}, result {self.summary['result']}"
        given = ", ".join(map(str, self.job.data.gains))
        before = f"They are relative to gains by which the data were divided before, of {given}." if given else ALONE
        histories = {**WHAT, "gains": f"Gains of effects that were taken out of data, V / (g_i g_j*). {before}"}
        said = self.data_history.rstrip("\n")
        return {
            name: f"{said}\n{what} Effects taken out: {taken}. Written by {by}.\n".lstrip("\n")
            for name, what in histories.items()
        }

    def write_data(self, folder: Path) -> None:
        """Write visibilities and gains."""
        if self.observation is None:
            return  # it is there already
        with in_files(self, folder, self.observation, bool(np.isfinite(self.autos).any())) as add:
            add(np.arange(self.observation.Ntimes), self)
        self.write_gains(folder, self.observation)

    def write_gains(self, folder: Path, observation: Observation) -> None:
        """Write gains alone."""
        write_gains(folder, observation, self.gains, self.histories["gains"], self.gain_flags)


Add = Callable[[IntArray, Correction], None]
"""Takes some times."""


@contextmanager
def in_files(correction: Correction, folder: Path, observation: Observation, has_autos: bool) -> Iterator[Add]:
    """Give a function that writes some times into the files of visibilities."""
    with ExitStack() as stack:
        writers = {
            name: stack.enter_context(
                uvh5_in_parts(
                    folder / f"{name}.uvh5", observation, has_autos and name == "corrected", correction.histories[name]
                )
            )
            for name in Parts._fields
        }

        def add(times: IntArray, part: Correction) -> None:
            for name, write in writers.items():
                autos = part.auto_block if has_autos and name == "corrected" else None
                write(times, part.visibilities[name], part.flags, part.nsamples, autos)

        yield add
