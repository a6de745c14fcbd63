"""The sky of a job: its sources, and where they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hydrabeam_mpi.config import Job, SkyColumns
from hydrabeam_mpi.config.sections import Sky as SkySettings
from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.data.observation import FloatArray, Observation
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.catalogue import VOTableColumns, read_catalogue, sky_of
from hydrabeam_mpi.io.gsm2016 import read_gsm2016
from hydrabeam_mpi.model.positions import ApparentPositions, RotatedPositions, SourcePositions, count_above_horizon
from hydrabeam_mpi.model.sky import REFERENCE_FREQ, Sky, concatenate, mock_sky


def source_positions(job: Job, sky: Sky, observation: Observation) -> SourcePositions:
    """Follow the sources as the job says: turned by sidereal time for mocks, apparent places for catalogues."""
    return positions_of(are_apparent(job), sky, observation)


def positions_of(apparent: bool, sky: Sky, observation: Observation) -> SourcePositions:
    """Follow the sources by their apparent places, or turned by sidereal time."""
    return ApparentPositions(sky, observation) if apparent else RotatedPositions(sky, observation)


def are_apparent(job: Job) -> bool:
    """Tell whether the job takes apparent places."""
    return (job.sky.positions or ("lst" if job.sky.kind == "mock" else "apparent")) == "apparent"


def load_sky(job: Job, observation: Observation, given: Any = None) -> Sky:
    """Read or draw the whole sky at the observed frequencies, before the model's flux cut.

    A SkyModel that is given stands for the job's file.
    """
    settings, freqs = job.sky, observation.freqs
    reference_freq = settings.reference_freq or REFERENCE_FREQ
    cut = settings.flux_min > 0 or settings.model_flux_min > 0
    options: dict[str, Any] = {
        "reference_freq": reference_freq if cut else None,
        "or_nearest": settings.reference_freq is None,
        "flux_min": settings.flux_min,
        "channel_width": observation.channel_width,
        "of_date": not are_apparent(job),
    }
    if given is not None:
        sky = sky_of(given, Path("sky"), freqs, **options)
    elif settings.file is not None:
        columns = _votable_columns(settings.columns) if settings.columns else None
        sky = read_catalogue(settings.file, freqs, columns=columns, **options)
    else:
        _check_spectrum(settings, freqs, reference_freq)
        sky = mock_sky(
            job.seed,
            freqs,
            n_sources=settings.n_sources,
            flux_range=settings.flux_range,
            reference_freq=reference_freq,
            spectral_index=settings.spectral_index,
        ).brighter_than(settings.flux_min)
    return concatenate([sky, read_gsm2016(settings.diffuse, freqs)]) if settings.diffuse else sky


def _check_spectrum(settings: SkySettings, freqs: FloatArray, reference_freq: float) -> None:
    """Make sure that a mock's power law gives fluxes that are numbers.

    Raises
    ------
    InputError
        If it changes fluxes by more than `LARGEST`, as no source's spectral index does.
    """
    decades = settings.spectral_index * np.log10(freqs / reference_freq)
    steepest = np.abs(decades).argmax()
    if abs(decades[steepest]) > np.log10(LARGEST):
        raise InputError(
            f"is {settings.spectral_index:g}, by which fluxes change {abs(decades[steepest]):.3g} orders of magnitude"
            f" from {reference_freq / 1e6:g} to {freqs[steepest] / 1e6:g} MHz",
            field="[sky] spectral_index",
            remedy="give one as sources have, such as -0.8",
        )


def _votable_columns(columns: SkyColumns) -> VOTableColumns:
    """Pass on which columns hold what; a job has no other way to say "none" than an empty text."""
    return VOTableColumns(**(columns.model_dump() | {"spectral_index": columns.spectral_index or None}))


def count_sources(sky: Sky, observation: Observation) -> FloatArray:
    """Estimate how many sources are up at each time, (Ntimes,).

    Raises
    ------
    InputError
        If there is none at any time.
    """
    counts = count_above_horizon(sky, observation)
    if not counts.any() and not count_above_horizon(sky, observation, max_sample=sky.Nsrc).any():
        raise InputError(
            f"none of {sky.Nsrc} sources is above the horizon at any time",
            field="[sky]",
            remedy="use another catalogue or lower flux_min and model_flux_min",
        )
    return counts
