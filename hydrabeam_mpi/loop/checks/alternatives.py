"""Conventions that data may follow instead of the one stated, and the model's visibilities under each.

Of wrong conventions with the same consequence only one is listed. ant1 and ant2 exchanged, fringes of
the other sign, and baselines taken as pos(ant1) - pos(ant2) all conjugate; so does a flat array turned by 180 degrees.
An azimuth that a beam file counts from North through East mirrors the beam at the diagonal, which turns a beam with two
mirror axes by 90 degrees, as exchanged polarisations do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from astropy.coordinates import FK4, ICRS, SkyCoord
from astropy.time import Time
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.data.redundancy import find_redundant_groups
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.model.engines import make_engine
from hydrabeam_mpi.model.engines.smearing import smearing_of
from hydrabeam_mpi.model.rime import ForwardModel
from hydrabeam_mpi.model.sky import Sky
from hydrabeam_mpi.model.tabulated import from_table
from hydrabeam_mpi.setup.beams import TurnedBeam, other_feed
from hydrabeam_mpi.setup.problem import Problem
from hydrabeam_mpi.setup.skies import are_apparent, positions_of

TT_MINUS_TAI = 32.184  # s
HALF_DAY = 43200.0
CLOCK_TOLERANCE = 1.5  # s: UT1 - UTC, which a file's sidereal times may lack, is up to 0.9 s
HALF_TOLERANCE = 0.02  # of an integration
SIDEREAL_RATE = 2 * np.pi / 86164.0905  # rad/s

CONJUGATE = "conjugate the data, or write them with ant1 and ant2 exchanged"


@dataclass(frozen=True)
class Alternative:
    """A convention; without any of the optional fields the one stated.

    Attributes
    ----------
    name, remedy : str
        In words.
    antpos : ndarray, (Nants, 3), optional
        Other positions of the observation's antennas, metres ENU.
    conjugated : bool
        Whether the data are.
    turned : bool
        Whether the beam is, by 90 degrees.
    sky : Sky, optional
        The same sources in other places.
    apparent : bool, optional
        Whether places are apparent, or turned by sidereal time alone, in place of what the job says.
    shift : ndarray, (Ntimes,), optional
        What has to be added to the observation's times, seconds.
    tolerance : float, optional
        Seconds within which the times must be wrong by just this; where there is none, by roughly this.
    """

    name: str
    remedy: str = ""
    antpos: FloatArray | None = None
    conjugated: bool = False
    turned: bool = False
    sky: Sky | None = None
    apparent: bool | None = None
    shift: FloatArray | None = None
    tolerance: float | None = None


class AntennaTable(NamedTuple):
    """The antennas of a file in its own order: numbers, names and positions (metres ENU)."""

    numbers: IntArray
    names: tuple[str, ...]
    antpos: FloatArray


def basic_alternatives() -> list[Alternative]:
    """Return the stated convention and those of data and beam."""
    return [
        Alternative("as stated"),
        Alternative("conjugated", CONJUGATE, conjugated=True),
        Alternative(
            "polarisation swapped",
            "take the other co-polarisation ([data] polarization), or say which feed points East ([beam] east_feed)",
            turned=True,
        ),
    ]


def sky_alternatives(problem: Problem) -> list[Alternative]:
    """Return other meanings that the places of the sources may have.

    Each moves them nearly as a clock does that is off by a minute or more. So times have to be right with it.
    """
    met: dict[str, Any] = {"shift": np.zeros(problem.observation.Ntimes), "tolerance": CLOCK_TOLERANCE}
    if not are_apparent(problem.job):
        return [Alternative("apparent places", "set [sky] positions = 'apparent'", apparent=True, **met)]
    sky = problem.sky
    as_stated = SkyCoord(sky.ra, sky.dec, unit="rad")
    frames = {
        "places of B1950": (
            SkyCoord(sky.ra, sky.dec, unit="rad", frame=FK4()).transform_to(ICRS()),
            "say that the catalogue's places are of B1950: columns ra_b1950 and dec_b1950 of a text file, "
            "[sky.columns] frame = 'fk4' of a VOTable, or the frame of its SkyModel",
        ),
        "places of J2000, read as B1950": (
            as_stated.transform_to(FK4()),
            "say that the catalogue's places are of J2000: columns ra_j2000 and dec_j2000 of a text file, "
            "[sky.columns] frame = 'fk5' of a VOTable, or the frame of its SkyModel",
        ),
    }
    return [
        Alternative("sky turned by sidereal time alone", "set [sky] positions = 'lst'", apparent=False, **met),
        *(
            Alternative(name, remedy, sky=replace(sky, ra=places.ra.rad, dec=places.dec.rad), **met)
            for name, (places, remedy) in frames.items()
        ),
    ]


def time_alternatives(observation: Observation) -> list[Alternative]:
    """Return clocks that the times may have been read from."""
    ones = np.ones(observation.Ntimes)
    tai = _tai_minus_utc(observation.times)
    tt = tai + TT_MINUS_TAI
    half = 0.5 * observation.integration_time
    brief = HALF_TOLERANCE * float(observation.integration_time.mean())
    shifts = {
        "times in TAI": (-tai, CLOCK_TOLERANCE, "TAI - UTC"),
        "times early by TAI - UTC": (tai, CLOCK_TOLERANCE, "TAI - UTC, taken off twice"),
        "times in TT": (-tt, CLOCK_TOLERANCE, "TT - UTC"),
        "times early by TT - UTC": (tt, CLOCK_TOLERANCE, "TT - UTC, taken off twice"),
        "times of the integrations' starts": (half, brief, "half an integration"),
        "times of the integrations' ends": (-half, brief, "half an integration"),
        "times early by half a day": (HALF_DAY * ones, None, "JD = MJD + 2400000.5"),
        "times late by half a day": (-HALF_DAY * ones, None, "JD = MJD + 2400000.5"),
    }
    return [
        Alternative(name, _shifted(float(shift.mean()), why), shift=shift, tolerance=tolerance)
        for name, (shift, tolerance, why) in shifts.items()
    ]


def _tai_minus_utc(times: FloatArray) -> FloatArray:
    """Return the leap seconds so far (and before 1972 what stood for them) at Julian dates, (Ntimes,), in s."""
    utc = Time(times, format="jd", scale="utc")
    # In two parts each, as a single double of a Julian date is good to 4e-5 s only.
    return np.asarray(86400 * ((utc.tai.jd1 - utc.jd1) + (utc.tai.jd2 - utc.jd2)))


def _shifted(shift: float, why: str) -> str:
    action = f"add {shift:g} s to" if shift > 0 else f"subtract {-shift:g} s from"
    return f"{action} the files' times ({why}) and recompute their sidereal times"


def array_alternatives(observation: Observation, table: AntennaTable, tol: float) -> list[Alternative]:
    """Return layouts that the antennas may have instead, without those that cannot be told from others.

    Parameters
    ----------
    observation : Observation
    table : AntennaTable
        Of a file, with all of the observation's antennas.
    tol : float
        Distance in metres within which baselines are the same.
    """
    east, north, up = observation.antpos.T
    layouts = {
        "north and east swapped": (np.stack([north, east, up], axis=1), "exchange east and north of the positions"),
        "east mirrored": (np.stack([-east, north, up], axis=1), "change the sign of the positions' east"),
        "north mirrored": (np.stack([east, -north, up], axis=1), "change the sign of the positions' north"),
    }
    for name, antpos in _reordered(table).items():
        of_number = dict(zip(table.numbers.tolist(), antpos, strict=True))
        mine = np.array([of_number[number] for number in observation.antenna_numbers.tolist()])
        layouts[name] = mine, "list the antennas' positions in the order of their numbers"
    stated = observation.bl_vectors
    known = [stated, -stated] if observation.is_copolar else [stated]
    alternatives = []
    for name, (antpos, remedy) in layouts.items():
        vectors = replace(observation, antpos=antpos).bl_vectors
        if all(np.abs(vectors - other).max() > tol for other in known):
            known.append(vectors)
            alternatives.append(Alternative(name, remedy, antpos=antpos))
    return alternatives


def _reordered(table: AntennaTable) -> dict[str, FloatArray]:
    """Return what the positions are if they were listed in another order than the antennas, each (Nants, 3)."""
    by_number, by_name = np.argsort(table.numbers, kind="stable"), np.argsort(table.names, kind="stable")
    orders = {"sorted by number": by_number, "sorted by name": by_name}
    layouts = {"antenna order reversed": table.antpos[::-1]}
    for name, order in orders.items():
        back = np.empty_like(table.antpos)
        back[order] = table.antpos
        layouts[f"positions {name}, antennas not"] = back
        layouts[f"antennas {name}, positions not"] = table.antpos[order]
    return layouts


@dataclass(frozen=True)
class _View:
    """A forward model, and which of its vectors a baseline has, perhaps conjugated."""

    model: ForwardModel
    index: IntArray
    flipped: NDArray[np.bool_]


def predictions(
    problem: Problem, rows: Rows, alternatives: Sequence[Alternative], chosen: IntArray
) -> Iterator[tuple[int, int, ComplexArray]]:
    """Yield number of the alternative, number of the time among the rows', and visibilities (Nfreqs, Nbls), Jy.

    Parameters
    ----------
    problem : Problem
    rows : Rows
        In whose sense visibilities are given.
    alternatives : sequence of Alternative
    chosen : ndarray of int
        Numbers of times of ``rows.tile.times``.
    """
    times = rows.tile.times[chosen]
    turned = tuple(TurnedBeam(beam, other_feed(problem.observation.pols[0])) for beam in problem.beams)
    as_stated = tuple(map(from_table, problem.beams))
    for n, alternative in enumerate(alternatives):
        cached = _view(problem, rows, alternative, times)
        for k, t in enumerate(chosen.tolist()):
            beams = turned if alternative.turned else as_stated
            vis = cached.model.visibilities(beams, np.array([k]))[:, 0, cached.index]
            yield n, t, np.where(cached.flipped, vis.conj(), vis)


def _view(problem: Problem, rows: Rows, alternative: Alternative, times: IntArray) -> _View:
    """Set up the forward model of some times under an alternative."""
    job, observation = problem.job, problem.observation
    shift = np.zeros(len(times)) if alternative.shift is None else alternative.shift[times]
    moments = replace(
        observation,
        times=observation.times[times] + shift / 86400,
        lsts=observation.lsts[times] + shift * SIDEREAL_RATE,
        integration_time=observation.integration_time[times],
    )
    antpos = observation.antpos if alternative.antpos is None else alternative.antpos
    if alternative.antpos is None:
        vectors, index, flipped = problem.redundant.vectors[rows.groups], rows.member, np.zeros(len(rows.member), bool)
    else:
        sign = np.where(problem.redundant.flipped[rows.tile.bls], -1.0, 1.0)[:, np.newaxis]
        of_rows = sign * replace(observation, antpos=antpos).bl_vectors[rows.tile.bls]
        found = find_redundant_groups(of_rows, job.data.redundancy_tol, either_sign=observation.is_copolar)
        vectors, index, flipped = found.vectors, found.group, found.flipped
    engine = make_engine(job.solver.engine, vectors, antpos, smearing_of(observation))
    sky = alternative.sky or problem.sky
    positions = positions_of(are_apparent(job) if alternative.apparent is None else alternative.apparent, sky, moments)
    return _View(ForwardModel(positions, sky.flux, observation.freqs, engine), index, flipped)
