"""Which part of the data a job uses, and which part of that it holds out: pure integers and metadata."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.errors import InputError


@dataclass(frozen=True)
class Selection:
    """What to read. Everything left out is unrestricted; criteria that are given must all hold.

    Attributes
    ----------
    pols : tuple of str, optional
        Polarisations such as "ee", in the order wanted.
    antennas, exclude_antennas : tuple of int
        Keep baselines between these antennas, drop baselines with those.
    antpairs : tuple of (int, int), optional
        Keep these baselines, named in either order.
    min_bl_length, max_bl_length : float, optional
        Metres, inclusive.
    channels : tuple of int, optional
        Indices into the ascending channels of all files.
    freqs : tuple of float, optional
        Hz; for each, the nearest channel, which must lie within half a channel width.
    freq_range : (float, float), optional
        Hz, inclusive, on channel centres.
    time_range : (float, float), optional
        JD, inclusive, on integration centres.
    lst_range : (float, float), optional
        Radians, inclusive; (first, last) with first > last wraps through zero.
    every_time : int
        Keep every so many of the integrations that the other criteria leave.
    """

    pols: tuple[str, ...] | None = None
    antennas: tuple[int, ...] | None = None
    exclude_antennas: tuple[int, ...] = ()
    antpairs: tuple[tuple[int, int], ...] | None = None
    min_bl_length: float | None = None
    max_bl_length: float | None = None
    channels: tuple[int, ...] | None = None
    freqs: tuple[float, ...] | None = None
    freq_range: tuple[float, float] | None = None
    time_range: tuple[float, float] | None = None
    lst_range: tuple[float, float] | None = None
    every_time: int = 1


def match(values: ArrayLike, axis: ArrayLike, tolerance: ArrayLike) -> IntArray:
    """Find, for each value, the nearest entry of an axis in any order.

    Parameters
    ----------
    values, axis : array_like
    tolerance : array_like
        One for all, or one a value.

    Returns
    -------
    ndarray of int, shape of ``values``
        Index into ``axis``, or -1 where nothing lies within ``tolerance``.
    """
    values, axis = np.asarray(values, dtype=float), np.asarray(axis, dtype=float)
    if not axis.size:
        return np.full(values.shape, -1)
    order = np.argsort(axis, kind="stable")
    ordered = axis[order]
    right = np.searchsorted(ordered, values).clip(max=len(axis) - 1)
    left = (right - 1).clip(min=0)
    near = np.where(np.abs(ordered[left] - values) <= np.abs(ordered[right] - values), left, right)
    return np.where(np.abs(ordered[near] - values) <= tolerance, order[near], -1)


def distinct(values: ArrayLike, tolerance: float) -> IntArray:
    """Return the indices of the values that differ by more than ``tolerance``, ascending in value, (Ndistinct,)."""
    values = np.asarray(values, dtype=float)
    order = np.argsort(values, kind="stable")
    return order[np.diff(values[order], prepend=-np.inf) > tolerance]


def in_lst_range(lsts: FloatArray, lst_range: tuple[float, float]) -> BoolArray:
    """Tell which sidereal times lie in a range that may wrap through zero (radians, inclusive)."""
    first, last = lst_range
    if last - first >= 2 * np.pi:
        return np.ones(len(lsts), dtype=bool)
    return np.mod(lsts - first, 2 * np.pi) <= np.mod(last - first, 2 * np.pi)


def _has_pair(antpairs: IntArray, wanted: tuple[tuple[int, int], ...]) -> BoolArray:
    """Tell which baselines are among ``wanted``, in either order."""
    keys = {frozenset(pair) for pair in wanted}
    return np.array([frozenset(pair) in keys for pair in antpairs.tolist()], dtype=bool)


def _narrow(mask: BoolArray, keep: BoolArray, field: str, what: str) -> None:
    """Apply one criterion in place; the one that leaves nothing is the one to name."""
    mask &= keep
    if not mask.any():
        raise InputError(f"leaves no {what}", field=field, remedy="widen it")


def _check_known(wanted: set[int], known: set[int], field: str) -> None:
    if unknown := sorted(wanted - known):
        listed = ", ".join(map(str, unknown))
        raise InputError(f"antenna {listed} is not in the data", field=field, remedy="remove it from the list")


def select_baselines(
    antpairs: IntArray, bl_vectors: FloatArray, selection: Selection, idle: Iterable[int] = ()
) -> BoolArray:
    """Tell which baselines the selection keeps.

    Parameters
    ----------
    antpairs : ndarray of int, (Nbls, 2)
    bl_vectors : ndarray, (Nbls, 3)
        Metres; NaN where an antenna has no position, which no limit on the length removes.
    selection : Selection
    idle : iterable of int
        Antennas that the array has too, without data; to leave them out is no mistake.

    Returns
    -------
    ndarray of bool, (Nbls,)

    Raises
    ------
    InputError
        If an antenna to keep or to leave out does not exist, or nothing is left.
    """
    keep = np.ones(len(antpairs), dtype=bool)
    known = set(np.unique(antpairs).tolist())
    if selection.antennas is not None:
        _check_known(set(selection.antennas), known, "[data] antennas")
        among = np.isin(antpairs, selection.antennas)
        _narrow(keep, among[:, 0] & among[:, 1], "[data] antennas", "baselines")
    if selection.exclude_antennas:
        _check_known(set(selection.exclude_antennas), known.union(idle), "[data] exclude_antennas")
        among = np.isin(antpairs, selection.exclude_antennas)
        _narrow(keep, ~(among[:, 0] | among[:, 1]), "[data] exclude_antennas", "baselines")
    if selection.antpairs is not None:
        _check_known({ant for pair in selection.antpairs for ant in pair}, known, "[data] antpairs")
        _narrow(keep, _has_pair(antpairs, selection.antpairs), "[data] antpairs", "baselines")
    length = np.linalg.norm(bl_vectors, axis=1)
    if selection.min_bl_length is not None:
        _narrow(keep, ~(length < selection.min_bl_length), "[data] min_bl_length", "baselines")
    if selection.max_bl_length is not None:
        _narrow(keep, ~(length > selection.max_bl_length), "[data] max_bl_length", "baselines")
    return keep


def select_channels(freqs: FloatArray, channel_width: FloatArray, selection: Selection) -> BoolArray:
    """Tell which of the ascending channels (Hz) the selection keeps, (Nfreqs,).

    Raises
    ------
    InputError
        If a channel does not exist, no channel lies within half a channel of a frequency, or nothing is left.
    """
    keep = np.ones(len(freqs), dtype=bool)
    if selection.channels is not None:
        chosen = np.asarray(selection.channels, dtype=int)
        if np.any((chosen < 0) | (chosen >= len(freqs))):
            raise InputError(
                f"the data have channels 0 to {len(freqs) - 1}",
                field="[data] channels",
                remedy="choose among those",
            )
        _narrow(keep, np.isin(np.arange(len(freqs)), chosen), "[data] channels", "channels")
    if selection.freqs is not None:
        chosen = match(selection.freqs, freqs, np.inf)
        for freq, index in zip(selection.freqs, chosen, strict=True):
            # A part in 1e9 so that a frequency on the very edge of a channel belongs to it.
            if abs(freqs[index] - freq) > 0.5 * channel_width[index] + 1e-9 * freq:
                raise InputError(
                    f"no channel within half a channel of {freq / 1e6:.6f} MHz",
                    field="[data] freqs",
                    remedy=f"the nearest is {freqs[index] / 1e6:.6f} MHz",
                )
        _narrow(keep, np.isin(np.arange(len(freqs)), chosen), "[data] freqs", "channels")
    if selection.freq_range is not None:
        low, high = selection.freq_range
        span = f"channels (they span {freqs[0] / 1e6:g} to {freqs[-1] / 1e6:g} MHz)"
        _narrow(keep, (freqs >= low) & (freqs <= high), "[data] freq_range", span)
    return keep


def select_times(times: FloatArray, lsts: FloatArray, selection: Selection) -> BoolArray:
    """Tell which integrations (JD, and their LST in radians) the selection keeps.

    Raises
    ------
    InputError
        If nothing is left.
    """
    keep = np.ones(len(times), dtype=bool)
    if selection.time_range is not None:
        first, last = selection.time_range
        span = f"times (they span JD {times[0]:.5f} to {times[-1]:.5f})"
        _narrow(keep, (times >= first) & (times <= last), "[data] time_range", span)
    if selection.lst_range is not None:
        hours = lsts * 12 / np.pi
        span = f"times (the data's LSTs are between {hours.min():.3f} and {hours.max():.3f} h)"
        _narrow(keep, in_lst_range(lsts, selection.lst_range), "[data] lst_range", span)
    if selection.every_time < 1:
        raise InputError(f"must be at least 1, not {selection.every_time}", field="[data] every_time")
    return keep & ((np.cumsum(keep) - 1) % selection.every_time == 0)


@dataclass(frozen=True)
class HoldoutRule:
    """What to keep from the fit, to test its predictions on.

    Attributes
    ----------
    kind : {"times", "lst", "jd", "baselines", "none"}
    every : int
        For "times": the last of every so many integrations is held out, with the default of two every second one.
    lst_ranges : tuple of (float, float)
        For "lst": radians, each may wrap.
    jd_ranges : tuple of (float, float)
        For "jd", for instance whole nights.
    antpairs : tuple of (int, int)
        For "baselines": in either order.
    """

    kind: Literal["times", "lst", "jd", "baselines", "none"] = "times"
    every: int = 2
    lst_ranges: tuple[tuple[float, float], ...] = ()
    jd_ranges: tuple[tuple[float, float], ...] = ()
    antpairs: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class Holdout:
    """The fitted and the held-out rows, each a rectangle of times x baselines.

    Attributes
    ----------
    train_times, test_times : ndarray of bool, (Ntimes,)
    train_bls, test_bls : ndarray of bool, (Nbls,)
    """

    train_times: BoolArray
    test_times: BoolArray
    train_bls: BoolArray
    test_bls: BoolArray


def _held_times(observation: Observation, rule: HoldoutRule) -> BoolArray:
    held = np.zeros(observation.Ntimes, dtype=bool)
    if rule.kind == "times":
        if rule.every < 2:
            raise InputError(f"must be at least 2, not {rule.every}", field="[holdout] every")
        held[rule.every - 1 :: rule.every] = True
    elif rule.kind == "lst":
        for lst_range in rule.lst_ranges:
            held |= in_lst_range(observation.lsts, lst_range)
    elif rule.kind == "jd":
        for first, last in rule.jd_ranges:
            held |= (observation.times >= first) & (observation.times <= last)
    return held


def split_holdout(observation: Observation, rule: HoldoutRule) -> Holdout:
    """Divide the rows into those to fit and those to hold out.

    Raises
    ------
    InputError
        If the rule leaves nothing to fit, or holds out nothing although it should.
    """
    all_times, all_bls = np.ones(observation.Ntimes, dtype=bool), np.ones(observation.Nbls, dtype=bool)
    if rule.kind == "none":
        return Holdout(all_times, ~all_times, all_bls, ~all_bls)
    if rule.kind == "baselines":
        held = _has_pair(observation.antpairs, rule.antpairs)
        split = Holdout(all_times, all_times, ~held, held)
    else:
        held = _held_times(observation, rule)
        split = Holdout(~held, held, all_bls, all_bls)
    if held.all():
        raise InputError("leaves nothing to fit", field="[holdout] kind", remedy="hold out less")
    if not held.any():
        raise InputError("holds out nothing", field="[holdout] kind", remedy='change it, or use kind = "none"')
    return split
