"""What no list of effects has: it must not be taken for something else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.validation.undeclared.answer import Drawn, Where, pairs
from tests.validation.undeclared.beams import Shape
from tests.validation.undeclared.setting import Catalogue, altaz, icrs
from tests.validation.undeclared.truth import ComplexArray, Truth


def drifting_beam(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The main lobe grows wider by the part ``strength`` over the night, East-West or North-South."""
    axis = int(rng.integers(2))
    phase = np.linspace(-0.5, 0.5, len(truth.setting.times))

    def shape(channel: int, time: int, beam: Shape) -> Shape:
        width = list(beam.width)
        width[axis] *= 1 + strength * phase[time]
        return replace(beam, width=(width[0], width[1]))

    truth.shape_of = shape
    return Drawn(n_params=2)


def drifting_noise(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The noise grows over the night, by the part ``strength`` until its end."""
    n_times = len(truth.setting.times)
    growth = 1 + strength * np.linspace(0, 1, n_times) ** 2
    truth.noise.append(lambda noise, _: noise * growth[:, np.newaxis])
    return Drawn(where=Where(times=list(range(2 * n_times // 3, n_times))), n_params=1)


def moving_source(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """Something of ``strength`` Jy crosses the sky in a fifth of the times, and is neither of the sky nor fixed."""
    n_times = len(truth.setting.times)
    length = n_times // 5
    first = int(rng.integers(1, n_times - length - 1))
    heading, offset = rng.uniform(0, 2 * np.pi), rng.uniform(-0.15, 0.15)
    along = np.linspace(-0.4, 0.4, length)
    east = along * np.cos(heading) - offset * np.sin(heading)
    north = along * np.sin(heading) + offset * np.cos(heading)

    def sky(channel: int, time: int, catalogue: Catalogue) -> Catalogue:
        if not first <= time < first + length:
            return catalogue
        l, m = east[time - first], north[time - first]
        ra, dec = icrs(np.array([np.arcsin(np.hypot(l, m))]), np.array([np.arctan2(m, l)]), truth.time(time))
        return catalogue.joined(Catalogue(ra, dec, np.array([strength]), np.zeros(1)))

    truth.sky_of.append(sky)
    return Drawn(where=Where(times=list(range(first, first + length))), n_params=3)


def wandering_source(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The place of the brightest source depends on the frequency: it moves by ``strength`` arcmin over the band."""
    middle = float(truth.setting.times[len(truth.setting.times) // 2])
    catalogue = truth.catalogue
    za, az = altaz(catalogue.ra, catalogue.dec, middle)
    freqs = truth.setting.freqs
    seen = catalogue.flux * truth.setting.model_shape.power(za, az, freqs.mean()) * (za < np.pi / 2)
    brightest = int(np.argmax(seen))
    direction = rng.uniform(0, 2 * np.pi)
    shift = np.deg2rad(strength / 60) * np.array([np.cos(direction), np.sin(direction)])

    def sky(channel: int, time: int, now: Catalogue) -> Catalogue:
        step = (freqs[channel] - freqs.mean()) / np.ptp(freqs)
        ra, dec = now.ra.copy(), now.dec.copy()
        ra[brightest] += step * shift[0] / np.cos(dec[brightest])
        dec[brightest] += step * shift[1]
        return Catalogue(ra, dec, now.flux, now.index)

    truth.sky_of.append(sky)
    ends = [float(freqs[0]), float(freqs[-1])]
    return Drawn(where=Where(freqs=ends), n_params=2)


def correlated_noise(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One baseline has noise of its own of ``strength`` sigma, which remembers the time before by nine tenths."""
    bl = int(rng.integers(len(truth.setting.antpairs)))

    def more(noise: ComplexArray, draws: np.random.Generator) -> ComplexArray:
        steps = (draws.standard_normal(noise.shape[:2]) + 1j * draws.standard_normal(noise.shape[:2])) / np.sqrt(2)
        walk = np.empty_like(steps)
        walk[:, 0] = steps[:, 0]
        for t in range(1, noise.shape[1]):
            walk[:, t] = 0.9 * walk[:, t - 1] + np.sqrt(1 - 0.9**2) * steps[:, t]
        noise = noise.copy()
        noise[:, :, bl] += strength * walk
        return noise

    truth.noise.append(more)
    return Drawn(where=Where(antpairs=pairs(truth, [bl])), n_params=2)
