"""Doubts about the data, said on the console and first among the summary's warnings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from astropy.time import Time

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.named import expand
from hydrabeam_mpi.data.observation import C_M_PER_S, EARTH_RATE, Observation
from hydrabeam_mpi.io.gains import doubt_about_gains
from hydrabeam_mpi.model.bases.base import has_part
from hydrabeam_mpi.model.earth_orientation import beyond_table
from hydrabeam_mpi.model.fit import FittedBeam
from hydrabeam_mpi.setup.skies import are_apparent
from hydrabeam_mpi.words import megahertz_of

# Seconds that a clock and a sidereal clock may differ by: UT1 - UTC, up to 0.9 s, and the equation of the equinoxes,
# up to 1.2 s, either of which a file's sidereal times may lack.
SIDEREAL_TOLERANCE = 2.1
# Of a source's visibility, lost in the mean over an integration and a channel: of which little is known any better.
SMEARED = 0.01


def cautions_of_data(job: Job, observation: Observation) -> tuple[str, ...]:
    """Say what is doubtful about the data by their metadata."""
    smearing = None if job.data.simulate or job.data.smearing else _of_smearing(observation)
    gains = expand(job.data.gains, "[data] gains", "file")
    said = [
        _of_units(job, observation),
        doubt_about_gains(gains, observation) if gains else None,
        *cautions_of_times(job, observation),
        _of_sidereal_times(observation),
        smearing,
    ]
    return tuple(caution for caution in (*observation.doubts, *said) if caution)


def cautions_of_times(job: Job, observation: Observation) -> tuple[str, ...]:
    """Say how far the sources may be off their places for want of a table of the Earth's orientation."""
    beyond = beyond_table(observation.times) if are_apparent(job) else None
    return (beyond,) if beyond else ()


def cautions_of_basis(job: Job, model: FittedBeam) -> tuple[str, ...]:
    """Say that widths of the prior do not follow from the model beam, where it has no part in some functions.

    Where the data choose the widths they choose those too, and nothing is to be done.
    """
    n_lacking = int(np.count_nonzero(~has_part(model.basis.amplitudes(model.coeffs))))
    chosen = job.prior.floor or job.prior.widths == "evidence"
    if job.prior.kind != "fraction" or chosen or not n_lacking:
        return ()
    return (
        f"The model beam has no part in {n_lacking} of the {model.basis.n_modes} functions, as a round beam has none "
        "in those that vary with azimuth, and a symmetric one none in those of odd orders. How large these may be is "
        "guessed from the functions next to them in order and from simulated beams, which mostly serves: nothing need "
        "be done. [prior] floor states another size, and with widths = 'evidence', as by default in the loop, the data "
        "choose it.",
    )


def cautions_of_flags(channels: Sequence[dict[str, Any]], holds_out: bool) -> tuple[str, ...]:
    """Say which channels have no data, given their summaries.

    Parameters
    ----------
    channels : sequence of dict
    holds_out : bool
        Whether the job asks for data to be held out.
    """
    empty = megahertz_of(channel["freq_hz"] for channel in channels if not channel["n_data"])
    untested = megahertz_of(channel["freq_hz"] for channel in channels if holds_out and "heldout_n" not in channel)
    said = []
    if empty:
        said.append(f"At {empty} MHz all data to fit are flagged: what is given for the beam there is its prior.")
    if untested:
        said.append(f"At {untested} MHz all held-out data are flagged: nothing tests the beam there.")
    return tuple(said)


def _of_units(job: Job, observation: Observation) -> str | None:
    """Say that nothing calibrates the data."""
    if not observation.uncalibrated or job.data.gains:
        return None
    return (
        'The files say that their visibilities are not calibrated (vis_units is "uncalib"), and the job applies no '
        "gains ([data] gains): if so, the inferred beam takes up gains and units, and means nothing."
    )


def _of_sidereal_times(observation: Observation) -> str | None:
    """Say that the sidereal times are not those of times and place."""
    expected = Time(observation.times, format="jd", location=observation.location).sidereal_time("apparent").rad
    turn = np.abs(np.angle(np.exp(1j * (observation.lsts - expected)))).max()
    seconds = turn * 43200 / np.pi
    if seconds <= SIDEREAL_TOLERANCE + observation.integration_time.max():
        return None
    return (
        f"The files' sidereal times (lst_array) are up to {seconds:.0f} s off those of their times and place: times, "
        "sidereal times or the telescope's longitude are wrong. UVData.set_lsts_from_time_array() recomputes them."
    )


def _of_smearing(observation: Observation) -> str | None:
    """Say how much means over an integration and a channel lose at most, which the model does not."""
    numbers = observation.antenna_numbers
    order = np.argsort(numbers)
    first, second = order[np.searchsorted(numbers, observation.antpairs, sorter=order)].T
    vectors = observation.antpos[second] - observation.antpos[first]
    pole = np.array([0.0, np.cos(observation.latitude), np.sin(observation.latitude)])
    # Turns of the fringe of the source that turns fastest, and of one on the horizon in the baseline's direction.
    fastest = np.linalg.norm(np.cross(vectors, pole), axis=1).max(initial=0.0) * EARTH_RATE / C_M_PER_S
    in_time = fastest * observation.freqs.max() * observation.integration_time.max()
    in_channel = np.linalg.norm(vectors, axis=1).max(initial=0.0) / C_M_PER_S * observation.channel_width.max()
    by_time, by_channel = (1 - np.sinc(min(turns, 1.0)) for turns in (in_time, in_channel))
    if max(by_time, by_channel) < SMEARED:
        return None
    seconds, khz = observation.integration_time.max(), observation.channel_width.max() / 1e3
    lost = ((by_time, f"{seconds:.4g} s"), (by_channel, f"{khz:.4g} kHz"))
    told = [f"a mean over {length} loses up to {part:.0%}" for part, length in lost if part >= SMEARED]
    if observation.is_phased:
        return (
            f"Of a source on the longest baselines of a drift scan {' and '.join(told)}. The files are phased: if they "
            "were averaged so, a source loses by its distance from the place that they follow instead. The model takes "
            "data as of one instant and one frequency, and [data] smearing is of drift scans alone."
        )
    return (
        f"Of a source on the longest baselines {' and '.join(told)}. The model takes data as of one instant and one "
        "frequency, as most simulators write them, and if these are so nothing is to be done. Correlators write such "
        "means: [data] smearing = true."
    )
