"""A fitted model applied to other data: what `hydrabeam predict` and `predict` share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hydrabeam_mpi.api.applied import Applied, apply_result, read_if_named, say_carried, setup_for, summary_of
from hydrabeam_mpi.api.result import Result
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.api.shared import begun, origin_of
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.inference.predictive_checks import LARGEST_PREDICTIVE
from hydrabeam_mpi.loop.selection.heldout_numbers import HeldoutNumbers, heldout_numbers
from hydrabeam_mpi.mpi import together
from hydrabeam_mpi.terminal.progress import say, warn
from hydrabeam_mpi.words import megahertz_of

AS_HELDOUT = "rms_expected_as_heldout"
"""The rms that is expected where as much is left as of the data that were held out from the result."""


@dataclass(frozen=True)
class Prediction(Applied):
    """How near a fitted model comes to data that it has not seen.

    On ranks other than 0 there is nothing in it but the job.

    Attributes
    ----------
    job : Job
        The data and the sky.
    summary : dict
        What ``prediction.json`` says: of all channels together, and in ``channels`` of each, the rms in Jy, explained
        variance, reduced chi^2 over the noise alone and under the posterior predictive, and the log density of the
        data; ``carried_over``, ``not_carried_over`` and ``at_prior``, which effects hold in these data; ``warnings``.
    about : dict
        Where it comes from.
    """

    told_in = "prediction.json"


def predict(result: Result | str | Path, setup: Setup) -> Prediction:
    """Predict data with a fitted model, without fitting it again.

    The result's beams, with their errors, and those of its effects that hold in other data predict all of the data of
    the setup, of which those that the result was made from are no part. Of the setup count its data, noise and sky, and
    its model beam for comparison.

    Collective: all ranks of the setup's communicator.

    Parameters
    ----------
    result : Result, str or Path
        Of `infer`, `close_loop` or `load`, or its folder; what rank 0 has counts.
    setup : Setup
        Its channels must be among those of the result, and its polarisation that one.

    Returns
    -------
    Prediction

    Raises
    ------
    InputError
        On all ranks, if the result cannot be applied to these data.
    """
    result = read_if_named(setup.comm, result)
    setup = setup_for(result, setup)
    with begun(setup) as (folder, threads):
        return run_prediction(result, setup, folder, threads)


def run_prediction(result: Result, setup: Setup, folder: Path | None, threads: int) -> Prediction:
    """Predict data. Collective: all ranks of the setup.

    Parameters
    ----------
    result : Result
    setup : Setup
        By `setup_for`.
    folder : Path, optional
        For simulated data.
    threads : int
        BLAS threads of this rank, for the record.
    """
    clock = Clock()
    problem, context, fitted, carried = apply_result(result, setup, folder, clock)
    say_carried(setup.comm, carried)
    with clock.time("heldout"):
        numbers = heldout_numbers(context, fitted)
    prediction = Prediction(setup.job)
    with together(setup.comm):
        if setup.comm.rank == 0:
            left = left_of_heldout(result.summary["channels"])
            told = _numbers(numbers, context.setup.observation.freqs, problem.channel_numbers.tolist(), left)
            summary = summary_of(result, problem, carried, told)
            doubts = warnings_of(told["channels"])
            warn(doubts)
            summary |= {"warnings": [*doubts, *summary["warnings"]], "phases_s": clock.seconds}
            prediction = Prediction(setup.job, summary, origin_of(setup, problem, threads))
    return prediction


def warnings_of(channels: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say where a result leaves far more of other data than it expects.

    Parameters
    ----------
    channels : sequence of mapping
        What is told of each.
    """
    said = []
    chi2 = max(one["predictive_chi2"] for one in channels)
    if chi2 > LARGEST_PREDICTIVE:
        said.append(
            f"Reduced chi^2 is up to {chi2:.3g} under the posterior predictive (noise, beam and effects): these data "
            "are not as the result has it. Gains, flux scale, sky or antennas differ from those of its own data, or "
            "the result left as much of these."
        )
    if worse := [one for one in channels if one["rms"] > one["rms_zero"]]:
        freqs = megahertz_of(one["freq_hz"] for one in worse)
        said.append(f"At {freqs} MHz the prediction leaves more of the data than predicting zero does.")
    return said


def left_of_heldout(channels: Sequence[Mapping[str, Any]]) -> FloatArray:
    """Return how large the data that were held out from a result are beside what it expects of them, (Nfreqs,).

    That is the root of their reduced chi^2 under its posterior predictive, one at least: a model that left more than
    noise where it was found is not expected to leave less elsewhere. NaN where none were held out.

    Parameters
    ----------
    channels : sequence of mapping
        Of the result's summary.
    """
    chi2 = [one.get("heldout_chi2_predictive") for one in channels]
    return np.sqrt([np.nan if one is None else max(one, 1.0) for one in chi2])


def _numbers(numbers: HeldoutNumbers, freqs: FloatArray, channels: list[int], left: FloatArray) -> dict[str, Any]:
    """Say and return the numbers of all channels together, and of each of some ``channels`` of the result.

    What was ``left`` of the result's own held-out data is that of `left_of_heldout`.
    """
    by_channel = [{"freq_hz": float(freqs[f]), **numbers.of_channel(f)} for f in channels]
    told: dict[str, Any] = numbers.of_all
    n, scale = np.array([one["n"] for one in by_channel]), left[channels]
    for one, of_one in zip([told, *by_channel], [np.sqrt(n @ scale**2 / n.sum()), *scale], strict=True):
        one[AS_HELDOUT] = None if np.isnan(of_one) else float(of_one * one["rms_expected"])
    as_heldout = f", or {told[AS_HELDOUT]:.4g} Jy if as much is left as of its own" if told[AS_HELDOUT] else ""
    say(
        f"rms of {told['n']:.0f} visibilities {told['rms_zero']:.4g} Jy, less the model beam {told['rms_model']:.4g} "
        f"Jy, with its best scale {told['rms_model_scaled']:.4g} Jy, less the prediction {told['rms']:.4g} Jy (noise "
        f"{told['rms_noise']:.4g} Jy; expected, as uncertain as beam and effects are: {told['rms_expected']:.4g} Jy"
        f"{as_heldout})"
    )
    say(
        f"explained variance {told['explained']:.6g}; reduced chi^2 {told['noise_only_chi2']:.4g} over the noise "
        f"alone, {told['predictive_chi2']:.4g} under the posterior predictive"
    )
    return {**told, "channels": by_channel}
