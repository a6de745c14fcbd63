"""The noise of the visibilities, as inverse variances.

The variance is sigma^2 = E|n|^2 in Jy^2 of complex noise n, with visibilities V = 1/2 I B. The functions
named weights return 1/sigma^2 in the shape of the visibilities, and zero where the data are flagged, have no
samples, or their noise cannot be told.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.data.observation import Array, BoolArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.data.selection import match
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference.robust import known_median, outliers
from hydrabeam_mpi.io.gains import calibrate
from hydrabeam_mpi.io.noise_table import read_table, table_sigma
from hydrabeam_mpi.io.uvdata import Block, feeds_of, read_autos, read_block
from hydrabeam_mpi.io.uvfile import check_all_survive
from hydrabeam_mpi.io.uvsource import Data
from hydrabeam_mpi.words import megahertz_of

# Fewer differences than this do not make a variance: its own error is 1 / sqrt(number).
MIN_DIFFERENCES = 8
# Integrations further apart than this many integration times are not differenced: the sky moves between them.
MAX_GAP = 2.5


def radiometer_weights(
    files: Sequence[Data],
    observation: Observation,
    tile: Tile,
    flags: BoolArray,
    nsamples: FloatArray,
    gain_files: Sequence[Path] = (),
    autos: Block | None = None,
) -> FloatArray:
    """Noise from the autocorrelations: sigma_jk^2 = V_jj V_kk / (dt dnu nsamples).

    dt and dnu are ``observation.integration_time`` and ``observation.channel_width``.

    Parameters
    ----------
    flags, nsamples : ndarray, (Nfreqs, len(tile.times), len(tile.bls), Npols)
    gain_files : sequence of Path
        Those that are applied to the visibilities, to calibrate the autocorrelations too.
    autos : Block, optional
        What `read_autos` says of these times, where it has been read.

    Returns
    -------
    ndarray, shape of ``flags``
        1/Jy^2; zero also where an autocorrelation is flagged or not positive.

    Raises
    ------
    InputError
        If an unflagged visibility lacks an autocorrelation, or an integration time or channel width is zero.
    """
    other = "choose another [noise] kind"
    # Files of a single channel may not say how wide it is.
    for field, remedy in (
        ("integration_time", other),
        ("channel_width", f"state it as channel_width in [data], or {other}"),
    ):
        if not np.all(getattr(observation, field) > 0):
            raise InputError("not positive", file=files[0], field=field, remedy=remedy)
    autos = autos or read_autos(files, observation, tile.times)
    power = calibrated_autos(autos, observation, tile.times, gain_files).power
    feeds = feeds_of(observation.pols)
    ants = match(observation.antpairs[tile.bls], observation.antenna_numbers, 0)
    first, second = (
        np.stack([power[:, :, ants[:, end], feeds.index(pol[end])] for pol in observation.pols], axis=-1)
        for end in (0, 1)
    )
    _check_autos_stored(power, np.isnan(first + second) & ~flags, files, observation, tile)
    # What is no power is not squared: of less than that no double is left.
    usable = ~flags & (first >= 1 / LARGEST) & (second >= 1 / LARGEST)
    exposure = observation.channel_width[:, None] * observation.integration_time[tile.times]
    weights = exposure[:, :, None, None] * nsamples / np.where(usable, first * second, 1.0)
    return np.where(usable, weights, 0.0)


def calibrated_autos(autos: Block, observation: Observation, times: IntArray, gain_files: Sequence[Path]) -> Block:
    """Return autocorrelations, as of `read_autos`, with gains divided out; flagged where these are, too."""
    if not gain_files:
        return autos
    antpairs = np.repeat(observation.antenna_numbers[:, None], 2, axis=1)
    pols = tuple(2 * feed for feed in feeds_of(observation.pols))
    data, flags, _ = calibrate(autos.data, autos.flags, observation, times, antpairs, gain_files, pols)
    return autos._replace(data=data, flags=flags)


def _check_autos_stored(
    power: FloatArray, lacking: BoolArray, files: Sequence[Data], observation: Observation, tile: Tile
) -> None:
    if lacking.any():
        ant_1, ant_2 = observation.antpairs[tile.bls[np.argwhere(lacking)[0, 2]]]
        what, remedy = f"no autocorrelations of antenna {ant_1} or {ant_2}", "choose another [noise] kind"
        if np.isnan(power).all():
            what = "no autocorrelations of any antenna"
        else:
            remedy = f"leave the antenna out with exclude_antennas, or {remedy}"
        raise InputError(what, file=files[0], field="data_array", remedy=remedy)


def odd_autocorrelations(log_power: FloatArray, dead: BoolArray) -> dict[int, str]:
    """Say which antennas, by index, have autocorrelations that are no power or absurd beside the others'.

    Parameters
    ----------
    log_power : ndarray, (Nants,)
        ln of their power, in any unit; NaN where nothing is known.
    dead : ndarray of bool, (Nants,)
        Those without positive ones.
    """
    why = dict.fromkeys(
        np.flatnonzero(dead).tolist(), "its autocorrelations are not positive, so that it has no noise to be weighed by"
    )
    sigmas = np.where(dead, 0.0, outliers(log_power))
    for ant in np.flatnonzero(sigmas).tolist():
        ratio = np.exp(log_power[ant] - known_median(log_power))
        why[ant] = f"its autocorrelations are {ratio:.2g} of the others' ({abs(sigmas[ant]):.0f} sigma)"
    return why


def check_weights(n_unflagged: int, n_weighted: int, files: Sequence[Data]) -> None:
    """Refuse data without any unflagged or weighted visibility, given counts over all tiles.

    Parameters
    ----------
    n_unflagged : int
        Number of unflagged visibilities.
    n_weighted : int
        Number of them with a positive weight.

    Raises
    ------
    InputError
        If either is zero.
    """
    if n_unflagged == 0:
        remedy = "select other data, or correct flags and nsamples"
        what = "all selected data are flagged, or of no samples (nsample_array)"
        raise InputError(what, file=files[0], field="flag_array", remedy=remedy)
    if n_weighted == 0:
        remedy = "choose another [noise] kind"
        raise InputError("non-positive noise for all selected data", file=files[0], remedy=remedy)


def constant_weights(sigma: float, flags: BoolArray, nsamples: FloatArray) -> FloatArray:
    """Noise of one sigma (Jy) for every visibility V = 1/2 I B, whatever its nsamples.

    The result is (Nfreqs, Ntimes, Nbls, Npols).
    """
    if not sigma > 0:
        raise InputError(f"must be positive, not {sigma:g}", field="[noise] sigma", remedy="give it in Jy")
    return np.where(flags | ~(nsamples > 0), 0.0, sigma**-2.0)


def variance_weights(variance: FloatArray, flags: BoolArray, nsamples: FloatArray) -> FloatArray:
    """Noise from the variance of one sample (Jy^2), (Nfreqs, Nbls, Npols) as of `difference_variance`."""
    if not np.all(variance > 0):
        raise InputError("non-positive noise", field="[noise] kind", remedy="choose another kind")
    return np.where(flags, 0.0, nsamples / variance[:, None])


def file_weights(
    path: Data, observation: Observation, tile: Tile, flags: BoolArray, nsamples: FloatArray
) -> FloatArray:
    """Noise from a file: of every visibility, or of one sample by channel and perhaps antenna.

    Parameters
    ----------
    path : Path or Source
        Either visibilities (uvh5, uvfits, ...) whose ``data_array`` holds the sigma (Jy) of each, whatever
        its nsamples. Or a table (see `read_table`) of the sigma of one sample, so that the variance is
        sigma^2 / nsamples, at frequencies within half a channel width of the data's; where it is by antenna,
        sigma_jk^2 = sigma_j sigma_k.

    Raises
    ------
    InputError
        If the file lacks what is asked for, or a sigma is not positive.
    """
    if isinstance(path, Path) and (table := read_table(path)) is not None:
        sigma = np.broadcast_to(table_sigma(table, path, observation, tile.bls), flags.shape)
        usable, samples = ~flags, nsamples
    else:
        if isinstance(path, Path):
            check_all_survive([path])
        block = read_block([path], observation, tile.times, observation.antpairs[tile.bls], observation.pols)
        if np.any(~flags & ~block.stored):
            raise InputError("lacks a sigma of an unflagged visibility", file=path, remedy="add or flag it")
        sigma = block.data.real
        usable, samples = ~flags & ~block.flags, np.ones(flags.shape)
    if not np.all((sigma[usable] >= 1 / LARGEST) & (sigma[usable] <= LARGEST)):
        told = "a sigma that is not positive, or infinite"
        raise InputError(told, file=path, field="sigma", remedy="correct or flag it")
    return np.where(usable, samples / np.where(usable, sigma, 1.0) ** 2, 0.0)


def difference_variance(
    files: Sequence[Data],
    observation: Observation,
    bls: IntArray,
    how: Literal["time", "frequency"],
    gain_files: Sequence[Path] = (),
) -> FloatArray:
    """Estimate the noise of one sample from how the data change between neighbours.

    Second differences |d_1 - 2 d_2 + d_3|^2 / (1/n_1 + 4/n_2 + 1/n_3), with n the nsamples, are averaged over
    all selected times, so the result does not depend on how baselines are dealt out. They remove a linear
    drift of the sky. Of a fringe that turns by phi between neighbours they leave 16 sin^4(phi/2)/6 of its
    power, by which the variance is too large: fast fringes of strong sources need another kind of noise.
    In frequency, each channel takes the differences that it is part of.

    Parameters
    ----------
    bls : ndarray of int
        Indices into ``observation.antpairs``.
    how : {"time", "frequency"}
        Neighbours must be equally spaced, by no more than 2.5 integrations or channel widths.
    gain_files : sequence of Path

    Returns
    -------
    ndarray, (Nfreqs, len(bls), Npols)
        Jy^2 at nsamples = 1; infinite where fewer than 8 differences are unflagged.

    Raises
    ------
    InputError
        If the times or channels are too few or too far apart to be differenced.
    """
    times, antpairs = np.arange(observation.Ntimes), observation.antpairs[bls]
    middle = amid(observation, how)
    data, flags, nsamples, _ = read_block(files, observation, times, antpairs, observation.pols)
    if gain_files:
        data, flags, _ = calibrate(data, flags, observation, times, antpairs, gain_files)
    # A flag makes the expected power infinite: such a difference counts as nothing.
    expected = np.divide(1.0, nsamples, out=np.full(nsamples.shape, np.inf), where=~flags)
    if how == "time":
        data, expected = data.swapaxes(0, 1), expected.swapaxes(0, 1)
    expected = expected[middle - 1] + 4 * expected[middle] + expected[middle + 1]
    power = np.abs(data[middle - 1] - 2 * data[middle] + data[middle + 1]) ** 2 / expected
    known = np.isfinite(expected)
    if how == "time":
        total, count = power.sum(axis=0), known.sum(axis=0)
    else:
        total, count = (_by_channel(values.sum(axis=1), middle, observation.Nfreqs) for values in (power, known))
    return np.where(count >= MIN_DIFFERENCES, total / np.maximum(count, 1), np.inf)


def _by_channel(values: Array, middle: IntArray, n_freqs: int) -> FloatArray:
    """Give each channel the sum over the differences that it is part of."""
    total = np.zeros((n_freqs, *values.shape[1:]))
    for step in (-1, 0, 1):
        total[middle + step] += values
    return total


def amid_neighbours(centres: FloatArray, widths: FloatArray) -> IntArray:
    """Return the indices of the times (s) or channels (Hz) amid three that are close and equally spaced, ascending."""
    gaps = np.diff(centres)
    wider = np.maximum(gaps[1:], gaps[:-1])
    even = np.abs(gaps[1:] - gaps[:-1]) <= 0.1 * wider
    return 1 + np.flatnonzero(even & (wider <= MAX_GAP * widths[1:-1]))


def amid(observation: Observation, how: Literal["time", "frequency"]) -> IntArray:
    """Return the indices of the times or channels amid three that are close and equally spaced.

    Raises
    ------
    InputError
        If they are too few, or a channel is in none of the three.
    """
    if how == "time":
        centres, widths = observation.times * 86400, observation.integration_time
    else:
        centres, widths = observation.freqs, observation.channel_width
    middle = amid_neighbours(centres, widths)
    most = len(middle) if how == "time" else min(len(middle), 3) * observation.Ntimes
    if most < MIN_DIFFERENCES:
        what = "integrations" if how == "time" else "channels"
        raise InputError(
            f"too few adjacent {what} to take the noise from their differences",
            field="[noise] kind",
            remedy="select more of them, or choose another kind",
        )
    alone = centres[np.setdiff1d(np.arange(len(centres)), middle[:, np.newaxis] + [-1, 0, 1])]
    if how == "frequency" and alone.size:
        listed = megahertz_of(alone)
        message = f"channels without neighbours at equal distances to take the noise from differences to: {listed} MHz"
        remedy = "select their neighbours too, leave them out, or choose another kind"
        raise InputError(message, field="[noise] kind", remedy=remedy)
    return middle
