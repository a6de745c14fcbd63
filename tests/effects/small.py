"""A small experiment to try effects on, and what every effect must satisfy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.config.simulation import Array, Simulate
from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.data.redundancy import find_redundant_groups
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.beam import analytic_beam
from hydrabeam_mpi.model.fit import fit_beam
from hydrabeam_mpi.model.positions import RotatedPositions
from hydrabeam_mpi.model.sky import Sky, concatenate, mock_sky
from hydrabeam_mpi.random import complex_normal, generator
from hydrabeam_mpi.simulation.mock import mock_observation


def small_setup(
    freqs: tuple[float, ...] = (131e6, 151e6), n_times: int = 6, n_sources: int = 60, pol: str = "ee", nights: int = 1
) -> ObservingSetup:
    """Seven antennas in a hexagon, sixty sources, six times over six hours, an Airy beam."""
    settings = Simulate(array=Array(hex=(2, 3)), n_times=n_times, nights=nights, freqs=freqs)
    observation = mock_observation(settings, pol)
    sky = mock_sky(3, observation.freqs, n_sources=n_sources)
    spec = FourierBessel.selection(
        n_modes=None, form="real", k_max=20, m_max=1, edge=np.deg2rad(92), boundary="neumann"
    )
    fits = [fit_beam(analytic_beam("airy", float(freq), pol, diameter=14.0), spec) for freq in freqs[:1]]
    fits += [fit_beam(analytic_beam("airy", float(freq), pol, diameter=14.0), fits[0].basis) for freq in freqs[1:]]
    return ObservingSetup(
        observation=observation,
        redundant=find_redundant_groups(observation.bl_vectors, 1e-7),
        sky=sky,
        basis=fits[0].basis,
        prior_mean=tuple(fit.coeffs for fit in fits),
        file_pols=(pol,),
        times=np.arange(observation.Ntimes),
    )


def small_block(setup: ObservingSetup, channel: int = 0, sky: Sky | None = None) -> RowBlock:
    """All rows of one channel, with the visibilities of the fitted beam, unit weights and no residual."""
    observation = setup.observation
    groups, member = np.unique(setup.redundant.group, return_inverse=True)
    positions = RotatedPositions(sky or setup.sky, observation)
    coeffs = setup.prior_mean[channel]

    def beam(za: FloatArray, az: FloatArray) -> FloatArray:
        return np.asarray(setup.basis.synthesize(coeffs, za, az))

    block = RowBlock(
        setup=setup if sky is None else replace(setup, sky=sky),
        channel=channel,
        times=np.arange(observation.Ntimes),
        bls=np.arange(observation.Nbls),
        groups=groups,
        member=member,
        positions=positions,
        beam=beam,
    )
    vis = block.spread(block.integrate(lambda sources: sources.beam[np.newaxis])[..., 0])
    return replace(block, vis=vis, weights=np.ones(block.shape), residual=np.zeros(block.shape, dtype=complex))


def check_adds_sources(effect: Effect, setup: ObservingSetup, x: FloatArray, extra: Sky) -> None:
    """What the effect adds in each channel is what a sky with these sources in it gives more."""
    for channel in range(setup.observation.Nfreqs):
        block = small_block(setup, channel)
        with_it = small_block(setup, channel, sky=concatenate([setup.sky, extra]))
        difference = with_it.vis - block.vis
        assert np.abs(difference).max() > 0.01
        np.testing.assert_allclose(effect.added(block, x), difference, rtol=0, atol=1e-9 * np.abs(with_it.vis).max())


def part_of(block: RowBlock, times: IntArray, bls: IntArray) -> RowBlock:
    """Some of a scene's times and baselines, numbered within it."""
    groups, member = np.unique(block.groups[block.member[bls]], return_inverse=True)
    rows = {name: getattr(block, name)[np.ix_(times, bls)] for name in ("weights", "residual", "vis")}
    own = {"times": block.times[times], "bls": block.bls[bls], "groups": groups, "member": member}
    return replace(block, **own, **rows, integrals={})


def with_effect(effect: Effect, block: RowBlock, x: FloatArray) -> np.ndarray:
    """Return the model of the data with the effect, C (A b + E), (Ntimes, Nbls); ``scene.vis`` is A b."""
    return effect.factor(block, x) * (block.vis + effect.added(block, x))


def matrix_at(effect: Effect, block: RowBlock, x: FloatArray) -> np.ndarray:
    """Return the columns as a dense matrix over baselines, (Ntimes, Nbls, n_params), of the data as measured."""
    at = replace(block, vis=block.vis + effect.added(block, x), integrals={})
    at.integrate_for([effect])
    columns = effect.columns(at, x)
    matrix = columns.matrix()
    dense = matrix if columns.index is None else matrix.toarray()
    dense = dense.reshape(*columns.values.shape[:2], -1)
    dense = block.spread(dense) if columns.by_group else dense
    return dense * effect.factor(block, x)[..., np.newaxis]


def check_derivative(effect: Effect, block: RowBlock, x: FloatArray, step: float = 1e-5, rtol: float = 1e-5) -> None:
    """Compare every column with the central difference of the exact model."""
    block.integrate_for([effect])
    parameters = effect.parameters(block.setup)
    assert len(parameters) == len(x)
    matrix = matrix_at(effect, block, x)
    assert matrix.shape[-1] == len(x)
    for p, scale in enumerate(parameters.scale):
        nudge = np.zeros(len(x))
        nudge[p] = step * scale
        numerical = (with_effect(effect, block, x + nudge) - with_effect(effect, block, x - nudge)) / (2 * step * scale)
        largest = max(np.abs(numerical).max(), np.abs(matrix[..., p]).max(), 1e-300)
        np.testing.assert_allclose(matrix[..., p], numerical, rtol=0, atol=rtol * largest, err_msg=parameters.names[p])


def check_adjoint(effect: Effect, block: RowBlock, x: FloatArray) -> None:
    """<y, S p> = <S^T y, p> for the matrix of the columns and for `Columns.apply`."""
    rng = generator(5, "adjoint", effect.kind)
    at = replace(block, vis=block.vis + effect.added(block, x), integrals={})
    at.integrate_for([effect])
    columns = effect.columns(at, x)
    p = rng.standard_normal(len(x))
    y = complex_normal(rng, columns.values.shape[:2])
    forward = columns.apply(p)
    back = (columns.matrix().conj().T @ y.reshape(-1)).real
    np.testing.assert_allclose(np.vdot(forward, y).real, back @ p, rtol=1e-10)


def check_recovery(
    effect: Effect, block: RowBlock, truth: FloatArray, sigma: float, start: FloatArray | None = None
) -> None:
    """Recover an injected truth within its error by Gauss-Newton steps, with the beam known.

    Combinations of parameters that the data do not tell are left out by a pseudo-inverse, and not compared.
    """
    block.integrate_for([effect])
    rng = generator(7, "recovery", effect.kind)
    data = with_effect(effect, block, truth) + sigma * complex_normal(rng, block.shape)
    x = np.zeros(len(truth)) if start is None else start.copy()
    scale = effect.parameters(block.setup).scale
    for _ in range(12):
        matrix = matrix_at(effect, block, x).reshape(-1, len(truth)) * scale / sigma
        residual = (data - with_effect(effect, block, x)).reshape(-1) / sigma
        fisher = 2 * (matrix.conj().T @ matrix).real
        values, vectors = np.linalg.eigh(fisher)
        told = values > 1e-9 * values.max()
        step = (vectors[:, told] / values[told]) @ (vectors[:, told].T @ (2 * (matrix.conj().T @ residual).real))
        x += scale * step
    assert np.abs(step).max() < 1e-4 * max(np.abs(x / scale).max(), 1e-12), "Gauss-Newton does not converge"
    error = vectors[:, told].T @ ((x - truth) / scale) * np.sqrt(values[told])
    assert np.mean(error**2) < 1 + 5 * np.sqrt(2 / len(error)), f"errors of {np.abs(error).max():.1f} sigma"
