"""The sky: sources that no catalogue has, wrong fluxes, diffuse emission, refraction and a horizon that is not flat."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from astropy_healpix import HEALPix
from numpy.typing import NDArray
from scipy.special import sph_harm_y

from tests.validation.undeclared.answer import Drawn, Parameter
from tests.validation.undeclared.beams import REFERENCE_FREQ, FloatArray
from tests.validation.undeclared.setting import Catalogue, altaz, icrs
from tests.validation.undeclared.truth import Truth

LARGEST_DEGREE = 3
DIFFUSE_INDEX = -2.5
PIXELS = 128  # HEALPix nside: with 64 the strongest emission is off by a chi^2 of 23 over all data, with 128 by 2
POINTS = 100  # of a sky of white noise, with the most power, that tell a third of it where an antenna has 14 m
AXES = (("major axis (FWHM)", "arcmin"), ("minor axis (FWHM)", "arcmin"), ("position angle", "deg"))


def _overhead(truth: Truth, rng: np.random.Generator) -> tuple[float, float]:
    """Draw a direction that passes within 15 degrees of the zenith during the observation, (ra, dec)."""
    time = truth.setting.times[0] + rng.uniform(0.2, 0.8) * np.ptp(truth.setting.times)
    za, az = np.array([np.deg2rad(15) * np.sqrt(rng.random())]), np.array([rng.uniform(0, 2 * np.pi)])
    ra, dec = icrs(za, az, time)
    return float(ra[0]), float(dec[0])


def missing_sources(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """A source of ``strength`` Jy, or two, which the catalogue lacks."""
    parameters = []
    for number in range(int(rng.choice([1, 1, 2]))):
        parameters += missing_source(truth, rng, strength, number).parameters
    return Drawn(parameters, n_params=len(parameters))


def missing_source(truth: Truth, rng: np.random.Generator, strength: float, number: int = 0) -> Drawn:
    """A source of ``strength`` Jy that the catalogue lacks, or of at least half as much where it is not the first."""
    ra, dec = _overhead(truth, rng)
    flux = strength * (1 if number == 0 else rng.uniform(0.5, 1.0))
    new = Catalogue(np.array([ra]), np.array([dec]), np.array([flux]), np.array([-0.8]))
    truth.catalogue = truth.catalogue.joined(new)
    parameters = [
        Parameter(f"source {number}", "right ascension", "deg", float(np.rad2deg(ra))),
        Parameter(f"source {number}", "declination", "deg", float(np.rad2deg(dec))),
        Parameter(f"source {number}", "flux", "Jy", float(flux * _mean_scale(truth))),
    ]
    return Drawn(parameters, n_params=len(parameters))


def faint_sources(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The catalogue ends at ``strength`` Jy, with 1,500 sources below it, of counts N(> S) ~ S^-3/2 down to 1/20."""
    n = 1500
    flux = strength / 20 * (1 - rng.random(n) * (1 - 20**-1.5)) ** (-1 / 1.5)
    ra, dec = rng.uniform(0, 2 * np.pi, n), np.arcsin(rng.uniform(-1, 1, n))
    truth.catalogue = truth.catalogue.joined(Catalogue(ra, dec, flux, np.full(n, -0.8)))
    return Drawn(n_params=POINTS)


def moving_sources(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """A source of ``strength`` Jy that the catalogue lacks moves along a great circle by up to four degrees."""
    ra, dec = _overhead(truth, rng)
    times, heading = truth.setting.times, rng.uniform(0, 2 * np.pi)
    middle, length = 0.5 * (times[0] + times[-1]), np.deg2rad(rng.uniform(1.0, 4.0))
    start = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    east, north = np.array([-np.sin(ra), np.cos(ra), 0.0]), np.array([0.0, 0.0, 1.0])
    north = (north - start * start[2]) / np.cos(dec)
    ahead = np.sin(heading) * east + np.cos(heading) * north

    def sky(channel: int, time: int, catalogue: Catalogue) -> Catalogue:
        angle = length * (times[time] - middle) / (times[-1] - times[0])
        now = start * np.cos(angle) + ahead * np.sin(angle)
        place = np.arctan2(now[1], now[0]), np.arcsin(now[2])
        one = Catalogue(*map(np.atleast_1d, place), np.array([strength]), np.array([-0.8]))
        return catalogue.joined(one)

    truth.sky_of.append(sky)
    rate = np.rad2deg(length) / (24 * (times[-1] - times[0]))
    known = {
        ("right ascension", "deg"): np.rad2deg(ra),
        ("declination", "deg"): np.rad2deg(dec),
        ("flux", "Jy"): strength * _mean_scale(truth),
        ("motion east", "deg/h"): rate * np.sin(heading),
        ("motion north", "deg/h"): rate * np.cos(heading),
    }
    return Drawn([Parameter("source 0", *what, float(value)) for what, value in known.items()], n_params=5)


def _mean_scale(truth: Truth) -> float:
    """Return the flux at the mean channel over that at 150 MHz."""
    return float((truth.setting.freqs.mean() / REFERENCE_FREQ) ** -0.8)


def catalogue_flux(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Fluxes of one or three of the strongest sources overhead are wrong by the part ``strength``."""
    catalogue, chosen = truth.catalogue, _some_bright(truth, rng)
    change = strength * rng.choice([-1, 1], len(chosen)) * rng.uniform(0.7, 1.0, len(chosen))
    flux = catalogue.flux.copy()
    flux[chosen] *= np.exp(change)
    truth.catalogue = Catalogue(catalogue.ra, catalogue.dec, flux, catalogue.index)
    parameters = [
        Parameter(f"source {source}", "relative change of flux", "", float(np.expm1(value)))
        for source, value in zip(chosen, change, strict=True)
    ]
    return Drawn(parameters, n_params=len(chosen))


def _some_bright(truth: Truth, rng: np.random.Generator) -> NDArray[np.int_]:
    """Draw one or three of the strongest sources overhead."""
    catalogue = truth.catalogue
    middle = truth.setting.times[len(truth.setting.times) // 2]
    za, az = altaz(catalogue.ra, catalogue.dec, float(middle))
    seen = catalogue.flux * truth.setting.model_shape.power(za, az, REFERENCE_FREQ) * (za < np.pi / 2)
    return np.asarray(rng.choice(np.argsort(-seen)[:8], int(rng.choice([1, 3])), replace=False))


def polarised_sources(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One or three of the strongest sources overhead are polarised by about ``strength``, at angles of their own."""
    chosen = _some_bright(truth, rng)
    share, angle = strength * rng.uniform(0.7, 1.0, len(chosen)), rng.uniform(0, np.pi, len(chosen))

    def sky(channel: int, time: int, now: Catalogue) -> Catalogue:
        north, east = _along_east(now.ra[chosen], now.dec[chosen], truth.time(time))
        along = (north * np.cos(angle) + east * np.sin(angle)) ** 2 / (north**2 + east**2)
        flux = now.flux.copy()
        flux[chosen] *= 1 + share * (2 * along - 1)
        return Catalogue(now.ra, now.dec, flux, now.index)

    truth.sky_of.append(sky)
    parameters = [
        Parameter(f"source {source}", name, "", float(part * turned))
        for source, part, twice in zip(chosen, share, 2 * angle, strict=True)
        for name, turned in (("Q/I", np.cos(twice)), ("U/I", np.sin(twice)))
    ]
    return Drawn(parameters, n_params=len(parameters))


def _along_east(ra: FloatArray, dec: FloatArray, time: float) -> tuple[FloatArray, FloatArray]:
    """Return how far sources go East on the ground if they go north and east on the sky, by differences, (N,) each."""
    step, seen = 1e-5, {}
    for name, north, east in (("here", 0, 0), ("north", step, 0), ("east", 0, step)):
        za, az = altaz(ra + east / np.cos(dec), dec + north, time)
        seen[name] = np.sin(za) * np.cos(az)
    return seen["north"] - seen["here"], seen["east"] - seen["here"]


def source_positions(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One or three of the strongest sources overhead lie about ``strength`` arcmin beside their places."""
    catalogue, chosen = truth.catalogue, _some_bright(truth, rng)
    far, angle = strength * rng.uniform(0.7, 1.0, len(chosen)), rng.uniform(0, 2 * np.pi, len(chosen))
    east, north = far * np.sin(angle), far * np.cos(angle)
    ra, dec = catalogue.ra.copy(), catalogue.dec.copy()
    dec[chosen] += np.deg2rad(north / 60)
    ra[chosen] += np.deg2rad(east / 60) / np.cos(dec[chosen])
    truth.catalogue = Catalogue(ra, dec, catalogue.flux, catalogue.index)
    parameters = [
        Parameter(f"source {source}", name, "arcmin", float(value[i]))
        for i, source in enumerate(chosen)
        for name, value in (("east of its place", east), ("north of its place", north))
    ]
    return Drawn(parameters, n_params=len(parameters))


def spectral_index(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Spectra of one or three of the strongest sources overhead are steeper or flatter, by about ``strength``.

    Their fluxes are right at 150 MHz. Signs alternate: beams that follow all bright ones make the others wrong.
    """
    catalogue, chosen = truth.catalogue, _some_bright(truth, rng)
    signs = rng.choice([-1, 1]) * (-1.0) ** np.arange(len(chosen))
    change = strength * signs * rng.uniform(0.7, 1.0, len(chosen))
    index = catalogue.index.copy()
    index[chosen] += change
    truth.catalogue = Catalogue(catalogue.ra, catalogue.dec, catalogue.flux, index)
    ratio = truth.setting.freqs.mean() / REFERENCE_FREQ
    parameters = [
        parameter
        for source, value in zip(chosen, change, strict=True)
        for parameter in (
            Parameter(f"source {source}", "relative change of flux", "", float(ratio**value - 1)),
            Parameter(f"source {source}", "change of index", "", float(value)),
        )
    ]
    return Drawn(parameters, n_params=2 * len(chosen))


def resolved_source(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One or three of the strongest sources overhead are round Gaussians of about ``strength`` arcmin (FWHM)."""
    chosen = _some_bright(truth, rng)
    widths = strength * rng.uniform(0.7, 1.0, len(chosen))
    truth.catalogue = _spread(truth.catalogue, chosen, widths, widths, np.zeros(len(chosen)))
    parameters = [
        Parameter(f"source {source}", "width (FWHM)", "arcmin", float(width))
        for source, width in zip(chosen, widths, strict=True)
    ]
    return Drawn(parameters, n_params=len(chosen))


def elongated_source(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One or three of the strongest sources overhead are Gaussians whose longer axis is about ``strength`` arcmin."""
    chosen = _some_bright(truth, rng)
    major = strength * rng.uniform(0.7, 1.0, len(chosen))
    minor = major * rng.uniform(0.2, 0.6, len(chosen))
    angle = rng.uniform(0, np.pi, len(chosen))
    truth.catalogue = _spread(truth.catalogue, chosen, major, minor, angle)
    parameters = [
        Parameter(f"source {source}", quantity, unit, float(value))
        for source, *values in zip(chosen, major, minor, np.rad2deg(angle), strict=True)
        for (quantity, unit), value in zip(AXES, values, strict=True)
    ]
    return Drawn(parameters, n_params=3 * len(chosen))


def _spread(
    catalogue: Catalogue, chosen: NDArray[np.int_], major: FloatArray, minor: FloatArray, angle: FloatArray
) -> Catalogue:
    """Make sources elliptical Gaussians: axes (FWHM) in arcmin, position angles, North through East, in radians.

    Each is as many points as it takes to integrate it over the fringes of short baselines.
    """
    nodes, weights = np.polynomial.hermite_e.hermegauss(9)
    share = (np.outer(weights, weights) / weights.sum() ** 2).ravel()
    wide = catalogue.select(np.setdiff1d(np.arange(len(catalogue.ra)), chosen))
    for source, *axes, turn in zip(chosen, major, minor, angle, strict=True):
        longer, shorter = (np.deg2rad(axis / 60) / np.sqrt(8 * np.log(2)) for axis in axes)
        along, across = (offset.ravel() for offset in np.meshgrid(longer * nodes, shorter * nodes))
        east = along * np.sin(turn) + across * np.cos(turn)
        north = along * np.cos(turn) - across * np.sin(turn)
        ra, dec = catalogue.ra[source], catalogue.dec[source]
        away = np.cos(dec) - north * np.sin(dec)
        placed = np.arctan2(np.sin(dec) + north * np.cos(dec), np.hypot(east, away))
        flux, index = catalogue.flux[source] * share, np.full(len(share), catalogue.index[source])
        wide = wide.joined(Catalogue((ra + np.arctan2(east, away)) % (2 * np.pi), placed, flux, index))
    return wide


def diffuse(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Emission of low order in right ascension and declination, ``strength`` kJy/sr, nowhere negative."""
    pixels = HEALPix(PIXELS, order="nested")
    ra, dec = (np.asarray(angle) for angle in pixels.healpix_to_lonlat(np.arange(pixels.npix)))
    colatitude = np.pi / 2 - dec
    amplitudes = {(l, m): float(rng.standard_normal()) for l in range(1, LARGEST_DEGREE + 1) for m in range(-l, l + 1)}
    values = np.sum([amplitude * real_harmonic(*lm, colatitude, ra) for lm, amplitude in amplitudes.items()], axis=0)
    # As much of the monopole as it takes for nothing to be negative.
    amplitudes[0, 0] = float(-values.min() * np.sqrt(4 * np.pi))
    values = strength * 1e3 * (values - values.min())
    flux = values * pixels.pixel_area.to_value("sr")
    truth.catalogue = truth.catalogue.joined(Catalogue(ra, dec, flux, np.full(len(ra), DIFFUSE_INDEX)))
    scale = strength * 1e3 * (truth.setting.freqs.mean() / REFERENCE_FREQ) ** DIFFUSE_INDEX
    parameters = [
        Parameter("sky", f"harmonic l={l} m={m}", "Jy/sr", float(scale * value))
        for (l, m), value in sorted(amplitudes.items())
    ]
    return Drawn(parameters, n_params=(LARGEST_DEGREE + 1) ** 2)


def real_harmonic(degree: int, order: int, colatitude: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Evaluate the orthonormal real spherical harmonic that goes as cos(m azimuth), or sin(|m| azimuth) if m < 0."""
    # scipy's have the sign (-1)^m.
    values = (-1.0) ** order * sph_harm_y(degree, abs(order), colatitude, azimuth)
    if order == 0:
        return np.asarray(values.real)
    return np.asarray(np.sqrt(2) * (values.real if order > 0 else values.imag))


def turned(catalogue: Catalogue, time: float, east: float, north: float) -> Catalogue:
    """Turn the sky about a horizontal axis, so that the zenith moves by ``east``, ``north`` radians, at one time."""
    za, az = altaz(catalogue.ra, catalogue.dec, time)
    vectors = np.stack([np.sin(za) * np.cos(az), np.sin(za) * np.sin(az), np.cos(za)], axis=-1)
    angle = float(np.hypot(east, north))
    if angle == 0:
        return catalogue
    axis = np.array([-north, east, 0.0]) / angle
    along = (vectors @ axis)[:, np.newaxis] * axis
    vectors = along + np.cos(angle) * (vectors - along) + np.sin(angle) * np.cross(axis, vectors)
    za, az = np.arctan2(np.hypot(*vectors.T[:2]), vectors[:, 2]), np.arctan2(vectors[:, 1], vectors[:, 0])
    ra, dec = icrs(za, az, time)
    return Catalogue(ra, dec, catalogue.flux, catalogue.index)


def shifted(catalogue: Catalogue, time: float, east: float, north: float) -> Catalogue:
    """Shift all direction cosines alike, by ``east`` and ``north``, at one time; what leaves the sky is not seen."""
    za, az = altaz(catalogue.ra, catalogue.dec, time)
    cosines = np.stack([np.sin(za) * np.cos(az) + east, np.sin(za) * np.sin(az) + north])
    seen = (za < np.pi / 2) & (np.hypot(*cosines) < 1)
    ra, dec = icrs(np.arcsin(np.hypot(*cosines[:, seen])), np.arctan2(*cosines[::-1, seen]), time)
    up = catalogue.select(np.flatnonzero(seen))
    return Catalogue(ra, dec, up.flux, up.index)


def ionosphere(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The whole sky is turned by ``strength`` arcmin at the mean frequency, as lambda^2, anew at each time."""
    return refracted(truth, strength * rng.standard_normal((len(truth.setting.times), 2)) / np.sqrt(2))


def phase_gradient(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """A gradient of phase over the array shifts all direction cosines by ``strength`` arcmin, anew at each time."""
    return refracted(truth, strength * rng.standard_normal((len(truth.setting.times), 2)) / np.sqrt(2), shifted)


def refracted(
    truth: Truth, arcmin: FloatArray, move: Callable[[Catalogue, float, float, float], Catalogue] = turned
) -> Drawn:
    """Move the sky of each time towards East and North, (Ntimes, 2) at the mean frequency, as lambda^2."""
    shifts = np.deg2rad(arcmin / 60)

    def sky(channel: int, time: int, catalogue: Catalogue) -> Catalogue:
        scale = (truth.setting.freqs.mean() / truth.setting.freqs[channel]) ** 2
        return move(catalogue, truth.time(time), *(scale * shifts[time]))

    truth.sky_of.append(sky)
    parameters = [
        Parameter(f"time {time}", f"shift towards {direction}", "arcmin", float(np.rad2deg(shift) * 60))
        for time in range(len(shifts))
        for direction, shift in zip(("East", "North"), shifts[time], strict=True)
    ]
    return Drawn(parameters, n_params=shifts.size)


def horizon(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Hills hide the sky up to ``strength`` degrees in a sector of azimuth of 60 to 360 degrees."""
    width = np.deg2rad(rng.choice([60.0, 120.0, 360.0]))
    centre = rng.uniform(0, 2 * np.pi)

    def sky(channel: int, time: int, catalogue: Catalogue) -> Catalogue:
        za, az = altaz(catalogue.ra, catalogue.dec, truth.time(time))
        inside = np.abs((az - centre + np.pi) % (2 * np.pi) - np.pi) <= width / 2
        return catalogue.select(~(inside & (za > np.pi / 2 - np.deg2rad(strength))))

    truth.sky_of.append(sky)
    return Drawn(n_params=4, about={"azimuth of the centre, rad": float(centre), "width, rad": float(width)})
