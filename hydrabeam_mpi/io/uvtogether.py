"""Whether files of visibilities fit together as one data set, by their metadata alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray, Observation
from hydrabeam_mpi.data.selection import distinct, match
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvcheck import SAME_DATA
from hydrabeam_mpi.io.uvfile import FREQ_TOLERANCE, TIME_TOLERANCE, UVHeader
from hydrabeam_mpi.io.uvsurvey import Survey, pair_keys

# Positions of one antenna in several files.
POSITION_TOLERANCE = 1e-3  # metres
# More than one step of an axis and less than two, so that rounding decides nothing.
ONE_IS_MISSING = 1.5
_X_EAST = str.maketrans("en", "xy")


def merge_antennas(surveys: Sequence[Survey]) -> tuple[dict[int, str], dict[int, FloatArray]]:
    """Collect the antennas of all files, by number: their names, and their positions (metres ENU).

    Raises
    ------
    InputError
        If they are not those of one array.
    """
    names: dict[int, str] = {}
    positions: dict[int, FloatArray] = {}
    first = surveys[0].header
    origin = _geocentric(first)
    for header in (survey.header for survey in surveys):
        moved = np.linalg.norm(_geocentric(header) - origin)
        if moved > POSITION_TOLERANCE:
            message = f"a telescope {moved:.3g} m away from that of {first.path.name}"
            raise _of_another_array(header, "telescope_location", message)
        for number, name, position in zip(
            header.antenna_numbers.tolist(), header.antenna_names, header.antpos, strict=True
        ):
            shift = np.linalg.norm(position - positions.setdefault(number, position))
            if shift > POSITION_TOLERANCE:
                message = f"antenna {number} stands {shift:.3g} m away from where earlier files have it"
                raise _of_another_array(header, "antenna_positions", message)
            names.setdefault(number, name)
    _check_numbers(surveys, positions)
    return names, positions


def _geocentric(header: UVHeader) -> FloatArray:
    return np.array([axis.to_value("m") for axis in header.location.to_geocentric()])


def _of_another_array(header: UVHeader, field: str, message: str) -> InputError:
    return InputError(message, file=header.path, field=field, remedy="give files of one array")


def _check_numbers(surveys: Sequence[Survey], positions: dict[int, FloatArray]) -> None:
    """Make sure that no antenna with data has one number in one file and another in the next."""
    owner: dict[int, Survey] = {}
    for survey in surveys:
        known = np.array(list(owner), dtype=int)
        new = [ant for ant in np.unique(survey.antpairs).tolist() if ant not in owner and ant in positions]
        places = np.array([positions[ant] for ant in known.tolist()]).reshape(-1, 3)
        for ant in new:
            same = known[np.linalg.norm(places - positions[ant], axis=1) <= POSITION_TOLERANCE]
            if same.size:
                message = f"antenna {ant} stands where {owner[int(same[0])].header.path.name} has antenna {same[0]}"
                raise _of_another_array(survey.header, "antenna_numbers", message)
        owner |= dict.fromkeys(new, survey)


def check_covered(observation: Observation, surveys: Sequence[Survey]) -> None:
    """Make sure that the files hold every channel and polarisation at every time.

    Raises
    ------
    InputError
        If they do not.
    """
    covered = np.zeros((observation.Ntimes, observation.Nfreqs, observation.Npols), dtype=bool)
    for survey in surveys:
        at_time = match(observation.times, survey.times, TIME_TOLERANCE) >= 0
        at_freq = match(observation.freqs, survey.header.freqs, FREQ_TOLERANCE) >= 0
        with_pol = np.array([survey.header.pol_index(pol) >= 0 for pol in observation.pols])
        covered[np.ix_(at_time, at_freq, with_pol)] = True
    if not covered.all():
        time, freq, pol = np.argwhere(~covered)[0]
        _check_directions_stated(observation.pols[pol], observation.times[time], surveys)
        raise InputError(
            f'no file holds "{observation.pols[pol]}" at {observation.freqs[freq] / 1e6:.6f} MHz'
            f" and JD {observation.times[time]:.6f}",
            field="[data] files",
            remedy="give files with the same channels and polarisations at all times",
        )


def _check_directions_stated(pol: str, time: float, surveys: Sequence[Survey]) -> None:
    """Refuse a file that does not tell where its feeds point beside others that do."""
    if not set(pol) <= {"e", "n"}:
        return
    named = next(survey.header for survey in surveys if pol in survey.header.pols)
    x_points = "east" if named.feed_pols[named.pol_index(pol)] == pol.translate(_X_EAST) else "north"
    at_time = (one.header for one in surveys if np.any(np.abs(one.times - time) <= TIME_TOLERANCE))
    for header in at_time:
        if header.pols == header.feed_pols:
            raise InputError(
                f"does not tell where its feeds point, and {named.path.name} does: x {x_points}",
                file=header.path,
                field="feed_angle",
                remedy=f"if it is the same here, UVData.telescope.set_feeds_from_x_orientation('{x_points}') states it",
            )


def _named_alike(one: Survey, other: Survey) -> bool:
    """Tell whether two files have a polarisation in common, by direction where both tell it."""
    headers = one.header, other.header
    names = "feed_pols" if any(header.pols == header.feed_pols for header in headers) else "pols"
    return bool(set(getattr(headers[0], names)) & set(getattr(headers[1], names)))


def check_disjoint(surveys: Sequence[Survey]) -> None:
    """Make sure that no two files hold the same data, be it averaged in another way.

    Raises
    ------
    InputError
        That names two files that do.
    """
    for one, other in _concurrent(surveys):
        if not _named_alike(one, other):
            continue
        freqs = _in_common(_channels(one), _channels(other), FREQ_TOLERANCE)
        times = _in_common(_integrations(one), _integrations(other), TIME_TOLERANCE) if freqs.size else freqs
        if times.size and _share_rows(one, other):
            where = f"from JD {times[0]:.6f} and {freqs[0] / 1e6:.6f} MHz"
            raise InputError(
                f"holds data that {one.header.path.name} holds too, {where}",
                file=other.header.path,
                field="time_array",
                remedy="remove one of the two from [data] files",
            )


def _concurrent(surveys: Sequence[Survey]) -> Iterator[tuple[Survey, Survey]]:
    """Yield all pairs of files, as named, of which one begins before the other has ended."""
    number = {id(survey): k for k, survey in enumerate(surveys)}
    ordered = sorted(surveys, key=lambda survey: float(survey.times[0]))
    for k, one in enumerate(ordered):
        end = one.times[-1] + one.integration_time.max() / 86400
        for other in ordered[k + 1 :]:
            if other.times[0] > end:
                break
            first, second = sorted((one, other), key=lambda survey: number[id(survey)])
            yield first, second


Axis = tuple[FloatArray, FloatArray]
"""Centres, and widths in the same unit."""


def _channels(survey: Survey) -> Axis:
    return survey.header.freqs, survey.header.channel_width


def _integrations(survey: Survey) -> Axis:
    return survey.times, survey.integration_time / 86400


def _in_common(one: Axis, other: Axis, tolerance: float) -> FloatArray:
    """Return which of the ``other`` file's centres are of data that the one has too."""
    widths = sorted((_extent(*one), _extent(*other)))
    near = 0.5 * sum(widths) - SAME_DATA * widths[0]
    return other[0][match(other[0], one[0], max(tolerance, near)) >= 0]


def _extent(centres: FloatArray, widths: FloatArray) -> float:
    """Return how much of an axis a centre stands for: its width, but no more than the distance to the next."""
    return float(min(np.median(widths), np.median(np.diff(np.sort(centres))) if len(centres) > 1 else np.inf))


def _share_rows(one: Survey, other: Survey) -> bool:
    """Tell whether there is a baseline with data at the same time in both."""
    if not np.isin(pair_keys(other.antpairs), pair_keys(one.antpairs)).any():
        return False
    if not np.any(match(other.times, one.times, TIME_TOLERANCE) >= 0):
        return True  # the times differ, and one averages over what the other has
    return np.intersect1d(_row_keys(one, one), _row_keys(other, one)).size > 0


def _row_keys(survey: Survey, among: Survey) -> IntArray:
    """Return a number for each row of a file at times and baselines of ``among``, the same in all files."""
    _, rows = survey.source.metadata()
    time = match(rows.times, among.times, TIME_TOLERANCE)
    baseline = match(pair_keys(rows.antpairs), pair_keys(among.antpairs), 0)
    return (time * len(among.antpairs) + baseline)[(time >= 0) & (baseline >= 0)]


def doubts_about(observation: Observation, surveys: Sequence[Survey]) -> tuple[str, ...]:
    """Say what is odd about the files together, though they can be used: order, gaps, antennas that some lack."""
    said = [_of_order(surveys), _of_times(observation, surveys), _of_channels(observation, surveys)]
    return tuple(one for one in (*said, _of_antennas(observation, surveys)) if one)


def _of_order(surveys: Sequence[Survey]) -> str | None:
    """Say that files of the same channels, polarisations and baselines are not named in the order of their times."""
    before: dict[tuple[object, ...], Survey] = {}
    for survey in surveys:
        header = survey.header
        kind = header.freqs.round().tobytes(), header.feed_pols, survey.antpairs.tobytes()
        earlier = before.setdefault(kind, survey)
        if survey.times[0] < earlier.times[0]:
            return (
                f"{header.path.name} begins before {earlier.header.path.name}, which is named ahead of it: "
                "files count in the order of their times, whatever that of their names."
            )
        before[kind] = survey
    return None


class Hole(NamedTuple):
    """Two files between which something is missing, and where on an axis that begins and ends."""

    before: str
    after: str
    begins: float
    ends: float

    def is_within(self, axis: FloatArray) -> bool:
        """Tell whether something that is selected comes before it, and something after."""
        return bool(axis.min() <= self.begins and self.ends <= axis.max())


def _of_times(observation: Observation, surveys: Sequence[Survey]) -> str | None:
    """Say that a file seems to be missing amid a night; from one to the next the telescope may rest."""
    # From local noon to noon, as Julian dates begin at noon in Greenwich.
    turn = observation.location.lon.deg / 360
    for hole in _holes(surveys, [survey.times for survey in surveys], TIME_TOLERANCE):
        if hole.is_within(observation.times) and np.floor(hole.begins + turn) == np.floor(hole.ends + turn):
            seconds = 86400 * (hole.ends - hole.begins)
            return _of_hole(hole, f"{seconds:.0f} s", f"JD {hole.begins:.5f} to {hole.ends:.5f}")
    return None


def _of_channels(observation: Observation, surveys: Sequence[Survey]) -> str | None:
    """Say that a file seems to be missing amid the band."""
    for hole in _holes(surveys, [np.sort(survey.header.freqs) for survey in surveys], FREQ_TOLERANCE):
        if hole.is_within(observation.freqs):
            return _of_hole(hole, "channels", f"{hole.begins / 1e6:.6g} to {hole.ends / 1e6:.6g} MHz")
    return None


def _of_hole(hole: Hole, what: str, where: str) -> str:
    return (
        f"No file holds the {what} between {hole.before} and {hole.after} ({where}), while other files follow upon "
        "each other: is one missing?"
    )


def _holes(surveys: Sequence[Survey], axes: Sequence[FloatArray], tolerance: float) -> list[Hole]:
    """Find where something is missing between files, half of which or more follow upon each other, given their axes."""
    values = np.concatenate(axes)
    steps = np.diff(values[distinct(values, tolerance)])
    files = distinct([axis[0] for axis in axes], tolerance)
    begins, ends = np.array([axes[k][-1] for k in files[:-1]]), np.array([axes[k][0] for k in files[1:]])
    wide = np.flatnonzero(ends - begins > ONE_IS_MISSING * np.median(steps)) if steps.size else files[:0]
    if 2 * len(wide) > len(begins):
        return []
    names = [surveys[k].header.path.name for k in files]
    return [Hole(names[k], names[k + 1], float(begins[k]), float(ends[k])) for k in wide.tolist()]


def _of_antennas(observation: Observation, surveys: Sequence[Survey]) -> str | None:
    """Say which antennas have no data at some times."""
    seen = np.zeros((observation.Ntimes, observation.Nants), dtype=bool)
    for survey in surveys:
        at_time = match(observation.times, survey.times, TIME_TOLERANCE) >= 0
        seen[np.ix_(at_time, np.isin(observation.antenna_numbers, survey.antpairs))] = True
    some = observation.antenna_numbers[~seen.all(axis=0)].tolist()
    if not some:
        return None
    which = f"Antenna {some[0]} has" if len(some) == 1 else f"Antennas {', '.join(map(str, some))} have"
    return f"{which} data in only some of the files: what the others lack counts as flagged."
