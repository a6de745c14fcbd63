"""Where the antennas stand, and when the data were taken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from astropy.coordinates import TETE, SkyCoord
from astropy.time import Time
from scipy.spatial.transform import Rotation

from tests.validation.undeclared.answer import Drawn, Parameter, Where, antenna, numbers, some_antennas
from tests.validation.undeclared.truth import Truth

DIRECTIONS = ("East", "North", "Up")


def antenna_positions(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One, three or all antennas stand off by ``strength`` metres in each direction."""
    chosen = some_antennas(truth, rng)
    offsets = np.zeros((truth.setting.n_ants, 3))
    offsets[chosen] = strength * rng.standard_normal((len(chosen), 3))
    truth.antpos = truth.antpos + offsets
    parameters = [
        Parameter(antenna(truth, index), f"displaced {direction}", "m", float(offset))
        for index in range(truth.setting.n_ants)
        for direction, offset in zip(DIRECTIONS, offsets[index], strict=True)
    ]
    return Drawn(parameters, Where(antennas=numbers(truth, chosen)), 3 * len(chosen))


def smearing(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The data are means over ``strength`` seconds, in which the sky turns."""
    truth.integration = strength
    return Drawn([Parameter("integrations", "length", "s", strength)], n_params=1)


def timestamp(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The data were taken ``strength`` seconds later than they say, or earlier."""
    truth.clock = float(strength * rng.choice([-1, 1]))
    return Drawn([Parameter("clock", "later", "s", truth.clock)], n_params=1)


def orientation(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Coordinates of sources, or positions of antennas, are turned by ``strength`` arcmin about each of three axes."""
    vector, of_stars = strength * rng.standard_normal(3), bool(rng.integers(2))
    turn = Rotation.from_rotvec(np.deg2rad(vector / 60))
    thing, axes, told = "sky", DIRECTIONS, -vector  # as seen by antennas that are turned
    if of_stars:
        thing, told = "stars", vector
        axes = ("RA 0 h, Dec 0", "RA 6 h, Dec 0", "the North pole")
        # The axes are those of date, which is that of the sidereal times.
        date = TETE(obstime=Time(truth.setting.times[0], format="jd"))
        of_date = SkyCoord([0, 90, 0], [0, 0, 90], unit="deg", frame=date).icrs.cartesian.xyz.value
        turn = Rotation.from_rotvec(of_date @ turn.as_rotvec())
        catalogue = truth.catalogue
        places = SkyCoord(catalogue.ra, catalogue.dec, unit="rad").cartesian.xyz.value.T
        x, y, z = turn.apply(places).T
        truth.catalogue = replace(catalogue, ra=np.arctan2(y, x) % (2 * np.pi), dec=np.arcsin(z))
    else:
        truth.antpos = turn.apply(truth.antpos)
    parameters = [
        Parameter(thing, f"turned about {axis}", "arcmin", float(part)) for axis, part in zip(axes, told, strict=True)
    ]
    return Drawn(parameters, n_params=3)


def array_scale(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Positions are in units that are ``strength`` per cent longer, or shorter, than metres."""
    percent = float(strength * rng.choice([-1, 1]))
    truth.antpos = (1 + 0.01 * percent) * truth.antpos
    return Drawn([Parameter("array", "longer", "%", percent)], n_params=1)
