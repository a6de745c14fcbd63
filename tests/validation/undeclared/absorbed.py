"""Effects so strong that they are seen although a beam can take up nine tenths of them, or all but a thousandth.

The array of seven antennas that they are drawn with tells little else of the beam.
"""

from __future__ import annotations

import numpy as np

from tests.validation.undeclared.answer import Drawn, Parameter
from tests.validation.undeclared.setting import Catalogue, altaz
from tests.validation.undeclared.skies import refracted
from tests.validation.undeclared.truth import Truth


def flux_at_transit(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """One of the three sources that get brightest as they pass over is wrong by the part ``strength``."""
    catalogue, peak = truth.catalogue, np.zeros(len(truth.catalogue.ra))
    for time in truth.setting.times[::3].tolist():
        za, az = altaz(catalogue.ra, catalogue.dec, time)
        power = truth.setting.model_shape.power(za, az, float(truth.setting.freqs.mean()))
        peak = np.maximum(peak, catalogue.flux * power * (za < np.pi / 2))
    source = int(rng.choice(np.argsort(-peak)[:3]))
    change = strength * float(rng.choice([-1, 1]))
    flux = catalogue.flux.copy()
    flux[source] *= 1 + change
    truth.catalogue = Catalogue(catalogue.ra, catalogue.dec, flux, catalogue.index)
    return Drawn([Parameter(f"source {source}", "relative change of flux", "", change)], n_params=1)


def walking_refraction(truth: Truth, rng: np.random.Generator, strength: float) -> Drawn:
    """The sky moves by ``strength`` arcmin to and fro during the night, slowly and along one direction, as lambda^2."""
    n_times = len(truth.setting.times)
    heading, phase = rng.uniform(0, 2 * np.pi, 2)
    along = strength * np.cos(phase + np.pi * np.arange(n_times) / n_times)
    return refracted(truth, along[:, np.newaxis] * np.array([np.cos(heading), np.sin(heading)]))
