"""``hydrabeam init``: a commented job file, filled in from data files."""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hydrabeam_mpi.commands.inputs import Inputs, sort_inputs
from hydrabeam_mpi.config import Job, Section
from hydrabeam_mpi.config.data import Data
from hydrabeam_mpi.config.effects import Loop
from hydrabeam_mpi.config.frequency import OverFrequency
from hydrabeam_mpi.config.sample import Sample
from hydrabeam_mpi.config.sections import Basis, Beam, Holdout, Noise, Output, Prior, Sky, SkyColumns, Smooth, Solver
from hydrabeam_mpi.config.text import frequency_text, keys_text, table_text
from hydrabeam_mpi.data.observation import Array, BoolArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.data.redundancy import find_redundant_groups
from hydrabeam_mpi.data.runs import runs_of
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.beamfits import SAME_FREQ, BeamFile
from hydrabeam_mpi.io.catalogue import is_of_date, read_model
from hydrabeam_mpi.io.disk import replacing
from hydrabeam_mpi.io.noise import amid
from hydrabeam_mpi.io.reading import quiet
from hydrabeam_mpi.io.uvsummary import Summary, summarise
from hydrabeam_mpi.simulation.truth import BEAM as TRUE_BEAM
from hydrabeam_mpi.tables import embedded_beam
from hydrabeam_mpi.terminal.progress import say

CATALOGUE, BEAM = "CATALOGUE.skyh5", "BEAM.beamfits"
HEAD = (
    "# A job for 'hydrabeam infer'. Keys in comments show their defaults; numbers may carry a unit, as in \"131 MHz\".",
    "# CHOOSE marks what the data cannot tell.",
    "",
)
# Of more channels than this, one is a quicker start.
FEW_CHANNELS = 4
# Antennas that were surveyed stand this close to where they were meant to.
SURVEYED = 0.1  # metres
EXACT = Data.model_fields["redundancy_tol"].default

Values = dict[str, Any]


def job_from_data(paths: Sequence[Path]) -> str:
    """Return the text of a job file for some data, and the gains, beam and sky that are named with them.

    What the files tell is filled in; every other key stands in a comment with its default. What remains to be
    chosen is marked with CHOOSE.

    Raises
    ------
    InputError
        If a file cannot be used, or the files do not fit together.
    """
    inputs = sort_inputs(paths)
    summary = summarise(inputs.data)
    observation = summary.observation
    channels = _first_channels(summary)
    freqs = observation.freqs[channels]
    data: Values = {"files": tuple(map(_pattern, inputs.data)), "polarization": summary.pol}
    if inputs.gains:
        data["gains"] = tuple(map(_pattern, inputs.gains))
    if len(channels) < observation.Nfreqs:
        data["freqs"] = tuple(freqs.tolist())
    if excluded := sorted({*summary.flagged_antennas, *summary.absurd_antennas}):
        data["exclude_antennas"] = tuple(excluded)
    lines = [
        *HEAD,
        *keys_text(Job, {"name": inputs.data[0].stem}),
        *table_text("data", Data, data, _about_data(summary, inputs, len(channels))),
        *table_text("noise", Noise, *_noise(summary, channels)),
        *table_text("holdout", Holdout, {"kind": "times" if observation.Ntimes > 1 else "none"}),
        *table_text("sky", Sky, *_sky(inputs)),
        *table_text("sky.columns", SkyColumns, {}, given=False),
        *table_text("beam", Beam, *_beam(inputs, summary.pol, freqs)),
    ]
    for name, section in _OTHERS.items():
        lines += table_text(name, section, {})
    return "\n".join(lines) + "\n"


def write_job(text: str, path: Path, overwrite: bool) -> None:
    """Write a job file, whole or not at all.

    Raises
    ------
    InputError
        If something is there that is not to be replaced, or it cannot be written.
    """
    if os.path.lexists(path) and not overwrite:
        raise InputError("is there already", file=path, field="-o", remedy="name another file, or add --overwrite")
    try:
        with replacing(path) as partial:
            partial.write_text(text, encoding="utf-8")
    except OSError as error:
        remedy = "name another place"
        raise InputError(f"cannot be written ({error.strerror})", file=path, field="-o", remedy=remedy) from error
    say(f"wrote {path}")


_OTHERS: dict[str, type[Section]] = {
    "basis": Basis,
    "prior": Prior,
    "prior.smooth": Smooth,
    "prior.frequency": OverFrequency,
    "solver": Solver,
    "output": Output,
    "loop": Loop,
    "sample": Sample,
}


def _pattern(path: Path) -> str:
    """Return a file's name as a job gives it where wildcards are allowed."""
    return glob.escape(_named(path))


def _named(path: Path) -> str:
    """Return a file's name as a job gives it.

    Raises
    ------
    InputError
        If it is not text in UTF-8, as all of a job file is.
    """
    name = os.path.realpath(path)
    if not name.isprintable():
        remedy = "rename it, or give a link to it"
        raise InputError("a job file cannot hold a name like this", file=path, remedy=remedy)
    return name


def _first_channels(summary: Summary) -> IntArray:
    """Return all channels where they are few, or else the unflagged one nearest to the built-in beam's."""
    freqs = summary.observation.freqs
    usable = np.flatnonzero(~summary.flagged_channels)
    if not usable.size:
        usable = np.arange(len(freqs))
    if usable.size <= FEW_CHANNELS:
        return usable
    return usable[[np.argmin(np.abs(freqs[usable] - embedded_beam().info.freq))]]


def _about_data(summary: Summary, inputs: Inputs, n_chosen: int) -> list[str]:
    """Say what the files hold."""
    observation = summary.observation
    length = np.linalg.norm(observation.bl_vectors, axis=1)
    said = [
        f"Telescope {observation.telescope_name}, antennas {_list(observation.antenna_numbers)}.",
        f"{observation.Nbls} baselines of {length.min():.1f} to {length.max():.1f} m; {_about_redundancy(observation)}",
        f"Times: {observation.Ntimes}, each {np.median(observation.integration_time):.4g} s, on JD"
        f" {_list(np.unique(np.floor(observation.times)))}, LST {_lst_range(observation.lsts)}.",
        _about_channels(observation),
        f"Polarisations: {', '.join(observation.pols)}.",
    ]
    flagged = observation.freqs[summary.flagged_channels]
    if flagged.size:
        said.append(f"Wholly flagged channels: {_channel_ranges(observation.freqs, summary.flagged_channels)}.")
    if summary.flagged_antennas:
        said.append(f"Wholly flagged antennas: {_list(summary.flagged_antennas)}.")
    for ant, why in summary.absurd_antennas.items():
        said.append(f"Dead or absurd antenna {ant}: {why}.")
    if n_chosen < observation.Nfreqs - flagged.size:
        said.append(
            "CHOOSE the channels in 'freqs': one is a quick start; without it every one gets a beam of its own."
        )
    if summary.units != ("Jy",):
        stated = " and ".join(summary.units) or "none"
        once = "with these gains applied" if inputs.gains else "once 'gains' are applied"
        said.append(f"Unit of the visibilities: {stated}. They are taken to be in Jy {once}.")
    if summary.pol_conventions:
        said.append(f"The files state the pol_convention {' and '.join(summary.pol_conventions)}.")
    else:
        said.append(
            "CHOOSE pol_convention, which the files do not state; unless it is set, it is taken as 'sum', as most "
            "simulators (matvis, fftvis, pyuvsim) write it."
        )
    return said


def _about_redundancy(observation: Observation) -> str:
    """Say how many baselines differ, and by which tolerance those that surveyed positions split are one again."""
    exact, *counts = (
        find_redundant_groups(observation.bl_vectors, tol).Ngroups for tol in (EXACT, *10.0 ** np.arange(-6, 0))
    )
    said = f"different ones: {exact} within redundancy_tol = {EXACT:g} m, {counts[-1]} within {SURVEYED:g} m."
    if exact == counts[-1]:
        return said
    least = 10.0 ** (counts.index(counts[-1]) - 6)
    return f'{said} CHOOSE redundancy_tol = "{least:g} m" to take these as redundant, which is faster.'


def _channel_ranges(freqs: FloatArray, chosen: BoolArray) -> str:
    """Write the frequencies of channels with runs shortened, such as 117.5 to 118.2 (8 channels), 122 MHz."""
    said = [
        f"{freqs[run[0]] / 1e6:.6g}" + (f" to {freqs[run[-1]] / 1e6:.6g} ({run.size} channels)" if run.size > 1 else "")
        for run in runs_of(np.flatnonzero(chosen))
    ]
    return f"{', '.join(said)} MHz"


def _about_channels(observation: Observation) -> str:
    freqs, width = observation.freqs, float(np.median(observation.channel_width))
    if len(freqs) == 1:
        return f"Channels: 1, at {frequency_text(freqs[0])}, {frequency_text(width)} wide."
    spacing = float(np.median(np.diff(freqs)))
    return (
        f"Channels: {len(freqs)}, from {frequency_text(freqs[0])} to {frequency_text(freqs[-1])},"
        f" {frequency_text(spacing)} apart and {frequency_text(width)} wide."
    )


def _noise(summary: Summary, channels: IntArray) -> tuple[Values, list[str]]:
    """Choose where the noise of some channels is taken from."""
    if summary.has_autos:
        return {"kind": "autocorrelations"}, _about_noise(summary)
    observation = summary.observation
    chosen = replace(observation, freqs=observation.freqs[channels], channel_width=observation.channel_width[channels])
    hows: tuple[Literal["time", "frequency"], ...] = ("time", "frequency")
    for how in hows:
        try:
            amid(chosen, how)
        except InputError:
            continue
        return {"kind": f"{how}-differences"}, _about_noise(summary)
    asked = (
        "CHOOSE sigma, of a visibility's noise at nsamples = 1: neither times nor channels are near enough to tell it."
    )
    return {"kind": "constant"}, [*_about_noise(summary), asked]


def _about_noise(summary: Summary) -> list[str]:
    """Say what the files hold that the noise may be taken from."""
    said = ["Every antenna has autocorrelations." if summary.has_autos else "Not every antenna has autocorrelations."]
    match summary.nsamples:
        case (least, most) if least == most:
            said.append(f"nsamples is {least:g} throughout.")
        case (least, most):
            said.append(f"nsamples is {least:g} to {most:g}.")
        case _:
            said.append("All cross-correlations are flagged.")
    return said


def _sky(inputs: Inputs) -> tuple[Values, list[str]]:
    """Take the sky that is named, or that the data were simulated with."""
    if inputs.sky is None:
        return {"kind": "catalogue", "file": CATALOGUE}, ["CHOOSE the catalogue in 'file'."]
    model = read_model(inputs.sky)
    values: Values = {"kind": "catalogue", "file": _named(inputs.sky)}
    said = [f"{model.Ncomponents} sources of {inputs.sky.name}."]
    if is_of_date(model):
        values["positions"] = "lst"
        said.append("Their places are of date, so sidereal time alone turns them.")
    return values, said


def _beam(inputs: Inputs, pol: str, freqs: FloatArray) -> tuple[Values, list[str]]:
    """Take the beam that is named or that a simulation began with, or choose one; and say how well it suits."""
    if inputs.beam is not None:
        return _beam_of(inputs.beam, freqs), []
    if inputs.simulation is not None:
        given = inputs.simulation.beam.model_dump(exclude_defaults=True)
        source = {"source": inputs.simulation.beam.source}
        return {**source, **given}, [f"The model that the simulation began with; {TRUE_BEAM} is the true one."]
    built_in = embedded_beam().info
    if pol not in ("ee", "xx"):
        return {"source": BEAM}, ["CHOOSE the beam in 'source'."]
    remark = f"CHOOSE the beam; the built-in one is HERA's Vivaldi feed, East-West, at {frequency_text(built_in.freq)}."
    return {"source": Beam.model_fields["source"].default, **_rule_for(np.array([built_in.freq]), freqs)}, [remark]


def _beam_of(path: Path, freqs: FloatArray) -> Values:
    with quiet():
        return {"source": _named(path), **_rule_for(BeamFile(path).freqs, freqs)}


def _rule_for(known: FloatArray, freqs: FloatArray) -> Values:
    """Choose what is done where a beam lacks a channel: nothing where it has all of them."""
    if np.all(np.abs(known[:, np.newaxis] - freqs).min(axis=0) <= SAME_FREQ * freqs):
        return {}
    within = np.all((known.min() <= freqs) & (freqs <= known.max()))
    return {"frequency": "interpolate" if within else "scale"}


def _lst_range(lsts: FloatArray) -> str:
    """Return the shortest range of sidereal times that holds all of them."""
    hours = np.unique(np.mod(lsts, 2 * np.pi)) * 12 / np.pi
    first = (np.argmax(np.diff(hours, append=hours[0] + 24)) + 1) % len(hours)
    return f"{hours[first]:.3f} to {hours[first - 1]:.3f} h"


def _list(numbers: Sequence[int] | Array) -> str:
    """Write integers with runs shortened, such as 0-3, 7."""
    runs: list[list[int]] = []
    for number in map(int, numbers):
        if runs and number == runs[-1][-1] + 1:
            runs[-1] = [runs[-1][0], number]
        else:
            runs.append([number])
    return ", ".join("-".join(map(str, run)) for run in runs)
