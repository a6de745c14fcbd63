"""Means over an integration and a channel, against means of the fringes of many instants and frequencies."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from astropy.constants import c
from scipy.spatial.transform import Rotation

from hydrabeam_mpi.config.data import Simulate
from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.engines import make_engine
from hydrabeam_mpi.model.engines.auto import AutoEngine
from hydrabeam_mpi.model.engines.fringes import enu
from hydrabeam_mpi.model.engines.gemm import GemmEngine
from hydrabeam_mpi.model.engines.smearing import smearing_of
from hydrabeam_mpi.simulation.arrays import hexagon
from hydrabeam_mpi.simulation.mock import mock_observation

FREQ = 131e6
RNG = np.random.default_rng(7)
ANTENNAS = RNG.uniform(-150.0, 150.0, (9, 3)) * [1, 1, 0.02]
ONE, TWO = np.triu_indices(9, 1)
HEX = hexagon(2, 3, 60.0).antpos
VECTORS = {
    "lattice": HEX[1:] - HEX[0],
    "antennas' phases": ANTENNAS[TWO] - ANTENNAS[ONE],
    "exponentials": RNG.uniform(-150.0, 150.0, (5, 3)),
}


class One:
    """A beam of one everywhere."""

    n_columns = 1

    def columns(self, za: Any, az: Any, out: Any = None) -> Any:
        ones = np.ones((1, len(za)))
        return ones if out is None else np.copyto(out, ones) or out


def observed(seconds: float, hertz: float) -> Observation:
    settings: dict[str, Any] = {"array": {"hex": (2, 3)}, "n_times": 3, "freqs": (FREQ,)}
    observation = mock_observation(Simulate.model_validate(settings), "ee")
    return replace(observation, integration_time=np.full(3, seconds), channel_width=np.full(1, hertz), is_smeared=True)


def means(vectors: Any, directions: Any, latitude: float, seconds: float, hertz: float) -> Any:
    """Mean of the fringes, (Nvectors, Nsrc), as the sky turns from East to West and over the channel."""
    steps = (np.arange(400) + 0.5) / 400 - 0.5
    pole = np.array([0.0, np.cos(latitude), np.sin(latitude)])
    in_time = 0.0
    for step in steps:
        turned = Rotation.from_rotvec(-2 * np.pi / 86164.1 * step * seconds * pole).as_matrix() @ directions
        in_time = in_time + np.exp(2j * np.pi * FREQ / c.value * vectors @ turned) / len(steps)
    delays = vectors @ directions / c.value
    return in_time * np.mean([np.exp(2j * np.pi * hertz * step * delays) for step in steps], axis=0)


@pytest.mark.parametrize("kind", VECTORS)
@pytest.mark.parametrize(("seconds", "hertz"), [(60.0, 0.0), (0.0, 1e6), (60.0, 1e6)])
def test_what_is_left_is_the_mean(kind: str, seconds: float, hertz: float) -> None:
    vectors, observation = VECTORS[kind], observed(seconds, hertz)
    za, az = RNG.uniform(0, np.pi / 2, 30), RNG.uniform(0, 2 * np.pi, 30)
    directions, flux = enu(za, az), RNG.uniform(1, 2, 30)
    wanted = 0.5 * flux * means(vectors, directions, observation.latitude, seconds, hertz)
    engine = make_engine("gemm", vectors, ANTENNAS, smearing_of(observation))
    sharp = make_engine("gemm", vectors, ANTENNAS).responses(directions, flux, FREQ)
    most = np.abs(sharp - wanted).max()
    assert most > 0.02
    # What is left is that the fringes' rates change within the integration.
    tolerance = 0.01 * most
    terms = engine.responses(directions, flux, FREQ)
    np.testing.assert_allclose(terms, wanted, rtol=0, atol=tolerance)
    for precision, rounding in ((np.float64, 1e-12), (np.float32, 1e-4)):
        real, imag = engine.design(One(), za, az, flux[np.newaxis], np.array([FREQ]), precision)[0, :, :, 0]
        np.testing.assert_allclose(real + 1j * imag, terms.sum(axis=1), rtol=0, atol=rounding)
    data = RNG.normal(size=len(vectors)) + 0.5j
    told = engine.adjoint(data, directions, flux, FREQ)
    np.testing.assert_allclose(told, (terms.conj().T @ data).real, rtol=0, atol=1e-11)


def test_transforms_have_no_means() -> None:
    smearing = smearing_of(observed(10.0, 1e5))
    with pytest.raises(InputError, match="smearing asks for means"):
        make_engine("nufft", HEX, smearing=smearing)
    many = np.stack([*np.meshgrid(14.6 * np.arange(60), 14.6 * np.arange(60)), np.zeros((60, 60))], axis=-1)
    engine = make_engine("auto", many.reshape(-1, 3), smearing=smearing)
    assert isinstance(engine, AutoEngine)
    assert isinstance(engine.choose(5000, 1000), GemmEngine)
    assert engine.choose(5000, 1000).smearing is smearing


@pytest.mark.parametrize("name", ["integrations", "channels"])
def test_lengths_must_be_alike(name: str) -> None:
    observation = observed(10.0, 1e5)
    if name == "integrations":
        observation = replace(observation, integration_time=np.array([10.0, 10.0, 10.2]))
    else:
        observation = replace(observation, freqs=np.array([1e8, 1.1e8]), channel_width=np.array([1e5, 2e5]))
    with pytest.raises(InputError, match=f"{name} differ in length") as error:
        smearing_of(observation)
    assert error.value.field == "[data] smearing"
    assert smearing_of(replace(observation, is_smeared=False)) is None
