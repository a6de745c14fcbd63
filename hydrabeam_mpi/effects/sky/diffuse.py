"""Diffuse emission on large scales: a sky T(s) = sum_lm a_lm Y_lm(s) with real spherical harmonics.

It adds 1/2 int dOmega T(s) B(s) exp(2 pi i nu b.s/c), the integral over the visible hemisphere. The hemisphere with its
beam and fringes stays what it is while the sky turns, and a turned harmonic is a combination of those of its degree:
so the integrals over harmonics of the horizontal frame are made once, by a quadrature that converges exponentially up
to the horizon, and every time takes its own combinations of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from scipy.special import sph_legendre_p_all

from hydrabeam_mpi.data.observation import C_M_PER_S, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.skies_on_rings import SkiesOnRings
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.engines.fringes import enu
from hydrabeam_mpi.model.rime import Beam
from hydrabeam_mpi.model.sky import Sky
from hydrabeam_mpi.model.tabulated import power_of

MAX_LENGTH = 100.0  # wavelengths
BEAM_NODES, BEAM_ORDERS = 60, 110  # what a beam's own structure adds to the quadrature in cos za and az
MOST_DEGREES = 85  # 7,396 harmonics, whose information matrix takes half a gigabyte
MOST_HARMONICS = 500
"""At once: of so many it can still be asked whether two halves of the data agree on them."""
BETWEEN = 12
"""Highest degree of what is weighed beside as many as may come at once, where the first ones are wanted."""
GALACTIC_SLOPE = -1.25  # of a_lm with l: the power of the Galaxy's emission falls as l^-2.5
MONOPOLE = 4.5  # relative to l = 1: no emission is negative, so that the mean is twice the rms about it, or more


class Diffuse(Effect):
    """Spherical harmonics of low degrees, in the frame of the sources; each channel its own coefficients.

    Baselines of b wavelengths see the scales of degree 2 pi b and more directly, and larger ones through the sidelobes
    of their beam and its edge at the horizon, ever less; those beyond 100 wavelengths are taken to see nothing. Where
    the first degrees are wanted, more are looked for at once, and when the model has these the next ones. All from
    ``l_min`` to ``l_max`` are kept: the prior, which falls with l as the Galaxy's emission does, keeps those down that
    an array hardly sees. The Y_lm are orthonormal; m < 0 goes with sin(|m| ra), m > 0 with cos(m ra). Aberration, 20
    arcseconds, is left out.

    Parameters
    ----------
    l_max : int
        Highest degree.
    l_min : int
        Lowest degree, where others have those below.
    """

    kind = "diffuse"
    title = "diffuse emission"
    changes_sky = True
    comes_in_parts = True
    of_the_sky = True

    def __init__(
        self,
        l_max: Annotated[int, Field(ge=0, le=MOST_DEGREES)] = 6,
        l_min: Annotated[int, Field(ge=0, le=MOST_DEGREES)] = 0,
    ) -> None:
        if l_min > l_max:
            raise InputError("is less than l_min", field="l_max", remedy=f"give {l_min} or more")
        self.l_max, self.l_min = l_max, l_min

    @property
    def _first(self) -> int:
        """The number of harmonics of the degrees below."""
        return self.l_min**2

    def describe(self) -> dict[str, Any]:
        """Return the highest degree, and the lowest if it is not the first."""
        return {"l_max": self.l_max} | ({"l_min": self.l_min} if self.l_min else {})

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Refuse where every baseline is too long."""
        shortest = np.linalg.norm(setup.redundant.vectors, axis=1).min(initial=np.inf)
        wavelength = C_M_PER_S / float(setup.observation.freqs.min())
        if shortest <= MAX_LENGTH * wavelength:
            return None
        return (
            f"no baseline is shorter than {MAX_LENGTH:g} wavelengths, which see no large scales; "
            f"baselines below {MAX_LENGTH * wavelength:.0f} m would"
        )

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the coefficients a_lm."""
        orders = _degrees(self.l_max)[self._first :]
        names = [f"harmonic l={l} m={m}" for l, m in orders]
        degree = np.array([l for l, _ in orders])
        sizes = np.where(degree > 0, np.maximum(degree, 1) ** GALACTIC_SLOPE, MONOPOLE)
        # A sky may well have nothing beyond some degree, whatever the others have.
        return replace(Parameters.of(names, "Jy/sr", 1e4 * sizes, degree - self.l_min), nested=True)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the visibilities of every harmonic; ``x`` is (n_params,)."""
        n = (self.l_max + 1) ** 2 - self._first
        values = np.zeros((len(block.times), len(block.groups), n), dtype=complex)
        short = np.flatnonzero(_wavenumber(block) * np.linalg.norm(block.vectors, axis=1) <= 2 * np.pi * MAX_LENGTH)
        if len(short) and len(block.times):
            horizontal = self._horizontal(block, short)
            for t, frame in enumerate(_frames(block)):
                for degree, turn in self._turned(frame):
                    values[t, short, degree] = horizontal[:, degree] @ turn.T
        return Columns(values, n, by_group=True)

    def larger(self, setup: ObservingSetup) -> list[Diffuse]:
        """Return it with more degrees."""
        larger = [] if self.l_min else [BETWEEN, _last_at_once(0)]
        return [Diffuse(l_max) for l_max in larger if l_max > self.l_max]

    def next_after(self, setup: ObservingSetup, newest: Effect) -> Effect:
        """Return the degrees after those that the model got last, as far as there are any."""
        if not isinstance(newest, Diffuse) or newest.l_max == MOST_DEGREES:
            return self
        l_min = newest.l_max + 1
        return Diffuse(_last_at_once(l_min), l_min)

    def extra_sky(self, block: RowBlock, itime: int, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the points of the quadrature with the flux that each stands for, each (Nsrc,)."""
        up, az, area = _hemisphere(block, block.vectors, self.l_max)
        numbers = np.concatenate([np.zeros(self._first), self.standing_numbers(block, itime, x)])
        flux = area * on_rings(self.l_max, numbers, up[:, 0], az[0])
        za, azimuth = np.broadcast_arrays(np.arccos(up), az)
        return za.ravel(), azimuth.ravel(), flux.ravel()

    def standing_numbers(self, block: RowBlock, itime: int, x: FloatArray) -> FloatArray:
        """Return the coefficients of the horizontal harmonics, (n,)."""
        (frame,) = _frames(replace(block, times=np.array([itime])))
        return np.concatenate([turn.T @ x[degree] for degree, turn in self._turned(frame)])

    def _turned(self, frame: FloatArray) -> Iterator[tuple[slice, FloatArray]]:
        """Yield where each degree's parameters are, and what turns them; see `_turns`."""
        for l, turn in enumerate(_turns(self.l_max, frame.tobytes())[self.l_min :], self.l_min):
            yield slice(l**2 - self._first, (l + 1) ** 2 - self._first), turn

    def standing_skies(self, block: RowBlock) -> SkiesOnRings:
        """Return the harmonics on the rings of the quadrature."""
        return self._on_rings(block, block.vectors)

    def _on_rings(self, block: RowBlock, vectors: FloatArray) -> SkiesOnRings:
        """Return the harmonics on the rings of the quadrature for these baseline vectors, (N, 3)."""
        up, az, area = (one.ravel() for one in _hemisphere(block, vectors, self.l_max))
        of_z, degrees = _legendre(self.l_max, up), _degrees(self.l_max)[self._first :]
        along = _trigonometric(self.l_max, az)
        order = np.array([m for _, m in degrees]) % len(along)
        return SkiesOnRings(np.arccos(up), az, along, order, area * np.array([of_z[l, abs(m)] for l, m in degrees]))

    def _horizontal(self, block: RowBlock, groups: IntArray) -> ComplexArray:
        """Return the visibilities of harmonics of (90 deg - za, az), (len(groups), n)."""
        vectors = block.vectors[groups]
        seen = self._on_rings(block, vectors).design(block.engine_on(vectors), _Alone(block.beam), block.freq)[..., 0]
        return np.asarray((seen[:, 0] + 1j * seen[:, 1]).T)


class _Alone:
    """A beam as the only column of a basis."""

    n_columns = 1

    def __init__(self, beam: Beam) -> None:
        self._beam = beam

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Return the real part of the beam, (1, Npoints)."""
        return power_of(self._beam, za, az)[np.newaxis]


@lru_cache(maxsize=64)  # a megabyte each with 44 degrees
def _turns(l_max: int, frame: bytes) -> list[FloatArray]:
    """Return, by degree, equatorial harmonics as combinations of horizontal ones, (2 l + 1, 2 l + 1).

    ``frame`` is the rotation from equatorial to horizontal vectors, (3, 3). By projection over the sphere, with points
    and weights that are exact for products of two harmonics.
    """
    points, projection = _projection(l_max)
    turned = np.frombuffer(frame).reshape(3, 3).T @ points
    equatorial = harmonics(l_max, turned[2].clip(-1, 1), np.arctan2(turned[1], turned[0]))
    degrees = [slice(l**2, (l + 1) ** 2) for l in range(l_max + 1)]
    return [equatorial[degree] @ projection[degree].T for degree in degrees]


@lru_cache(maxsize=4)
def _projection(l_max: int) -> tuple[FloatArray, FloatArray]:
    """Return points on the sphere, (3, N), and what projects functions there on harmonics, (n, N)."""
    nodes, weights = np.polynomial.legendre.leggauss(l_max + 1)
    n_az = 2 * l_max + 3
    az = np.tile(2 * np.pi * np.arange(n_az) / n_az, len(nodes))
    z = np.repeat(nodes, n_az)
    return enu(np.arccos(z), az), harmonics(l_max, z, az) * np.repeat(weights, n_az) * (2 * np.pi / n_az)


def _hemisphere(block: RowBlock, vectors: FloatArray, l_max: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the quadrature's cos za, (N, 1), azimuths, (1, M), and solid angles, (N, 1); its points are all N x M.

    A fringe of largest phase k b has azimuthal orders up to about k b, and degrees as high on a sphere of which this is
    half; harmonics of degree ``l_max`` add theirs.
    """
    largest = _wavenumber(block) * float(np.linalg.norm(vectors, axis=1).max())
    nodes, weights = np.polynomial.legendre.leggauss(int(0.35 * largest) + BEAM_NODES + l_max // 2)
    n_az = int(largest) + BEAM_ORDERS + l_max
    az = np.linspace(0, 2 * np.pi, n_az, endpoint=False)[np.newaxis]
    return (nodes[:, np.newaxis] + 1) / 2, az, weights[:, np.newaxis] * np.pi / n_az


def harmonics(l_max: int, z: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Evaluate real orthonormal spherical harmonics, without the Condon-Shortley phase.

    Parameters
    ----------
    l_max : int
    z : ndarray, any shape
        Cosine of the polar angle.
    azimuth : ndarray
        Radians; broadcast with ``z``.

    Returns
    -------
    ndarray, ((l_max + 1)^2, ...)
        By l, then m = -l .. l.
    """
    out = np.empty(((l_max + 1) ** 2, *np.broadcast_shapes(z.shape, azimuth.shape)))
    of_z, of_azimuth = _legendre(l_max, z), _trigonometric(l_max, azimuth)
    for row, (l, m) in enumerate(_degrees(l_max)):
        np.multiply(of_z[l, abs(m)], of_azimuth[m], out=out[row])
    return out


def on_rings(l_max: int, numbers: FloatArray, z: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return a combination of harmonics, (Nz, Naz), where each ring of one z has the same azimuths.

    Parameters
    ----------
    l_max : int
    numbers : ndarray, ((l_max + 1)^2,)
    z : ndarray, (Nz,)
    azimuth : ndarray, (Naz,)
    """
    of_z = _legendre(l_max, z)
    along = np.zeros((2 * l_max + 1, len(z)))
    for number, (l, m) in zip(numbers, _degrees(l_max), strict=True):
        along[m] += number * of_z[l, abs(m)]
    return np.asarray(along.T @ _trigonometric(l_max, azimuth))


def _legendre(l_max: int, z: FloatArray) -> FloatArray:
    """Return normalised Legendre functions of z = cos(polar angle), (l_max + 1, 2 l_max + 1, ...), by l and m.

    Those of order m have the sign (-1)^m of Condon and Shortley.
    """
    return np.asarray(sph_legendre_p_all(l_max, l_max, np.arccos(z))[0])


def _trigonometric(l_max: int, azimuth: FloatArray) -> FloatArray:
    """Return what goes with these functions, (2 l_max + 1, ...), by m, of which negative ones count from the end."""
    orders = np.arange(1, l_max + 1).reshape(-1, *[1] * azimuth.ndim)
    factors = np.sqrt(2) * (-1.0) ** orders
    sines = factors * np.sin(orders * azimuth)
    return np.concatenate([np.ones((1, *azimuth.shape)), factors * np.cos(orders * azimuth), sines[::-1]])


def _last_at_once(l_min: int) -> int:
    """Return the highest degree of those that come at once after the ones below ``l_min``."""
    return min(int(np.sqrt(l_min**2 + MOST_HARMONICS)) - 1, MOST_DEGREES)


def _degrees(l_max: int) -> list[tuple[int, int]]:
    return [(l, m) for l in range(l_max + 1) for m in range(-l, l + 1)]


def _wavenumber(block: RowBlock) -> float:
    return 2 * np.pi * block.freq / C_M_PER_S


def _frames(block: RowBlock) -> FloatArray:
    """Return the rotations from equatorial to horizontal vectors (ENU), (Ntimes, 3, 3).

    The best fit to where the block's rule puts directions all over the sky.
    """
    n = 60
    z = 1 - (2 * np.arange(n) + 1) / n
    ra = np.arange(n) * np.pi * (3 - np.sqrt(5)) % (2 * np.pi)
    sky = Sky(ra, np.arcsin(z), np.ones((1, n)))
    vectors = enu(np.arccos(z), ra)
    positions = block.positions.follow(sky)
    frames = np.empty((len(block.times), 3, 3))
    for t, itime in enumerate(block.times.tolist()):
        index, za, az = positions.above_horizon(itime)
        left, _, right = np.linalg.svd(enu(za, az) @ vectors[:, index].T)
        left[:, 2] *= np.linalg.det(left @ right)
        frames[t] = left @ right
    return frames
