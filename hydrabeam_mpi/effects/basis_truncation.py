"""A basis that is too small: the beam has more structure than its functions can follow."""

from __future__ import annotations

from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.base import Columns, Effect, Parameters
from hydrabeam_mpi.effects.displaced import need_real_beam
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.effects.sources import Sources
from hydrabeam_mpi.model.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.zernike import Zernike

MOST_MODES = 128
AT_EDGE = 0
"""Number k of the radial function that is constant, and so not zero at the edge."""
_NEGLIGIBLE = 1e-9  # of the largest coefficient: rounding errors
_MARGIN = 4  # orders beyond those of a basis that has all of its own; enough for as many modes again


class BasisTruncation(Effect):
    """The beam has modes that the basis lacks: the next ones, each channel its own.

    They are real functions whatever the form of the basis. As redundant baselines share the beam, they share these.
    Fourier-Bessel functions with the Dirichlet condition are all zero at the edge, so that those of constant radius,
    which are not, come first: it would take very many others to follow a beam that is not.
    The modes do not depend on the beam, so they are integrated where they are first needed, by `columns`, and kept with
    the scene.
    """

    kind = "basis_truncation"
    title = "a basis that is too small"
    linear = True

    def __init__(self, n_before: int = 0) -> None:
        self.n_before = n_before

    def describe(self) -> dict[str, Any]:
        """Return how many of the next modes others have taken."""
        return {"n_before": self.n_before}

    def refusal(self, experiment: Experiment) -> str | None:
        """Refuse complex beams, and bases of which it is not known what comes next."""
        if isinstance(experiment.basis, FourierBessel | Zernike):
            return need_real_beam(experiment)
        return "it is not known which functions come next; a Fourier-Bessel or Zernike basis would tell"

    def parameters(self, experiment: Experiment) -> Parameters:
        """Return the coefficients of the next modes, expected to be as large as the smallest that there are."""
        modes = next_modes(experiment, self.n_before)
        names = [f"coefficient of mode ({a}, {b})" for a, b in modes]
        amplitudes = _amplitudes(experiment)
        told = np.sort(amplitudes[amplitudes > _NEGLIGIBLE * amplitudes.max()])
        return Parameters.of(names, "", float(np.median(told[: len(modes)])))

    def columns(self, scene: Scene, x: FloatArray) -> Columns:
        """Return the visibilities of the modes."""
        key = f"{self.kind} {self.n_before}"
        if key not in scene.integrals:
            scene.integrals[key] = scene.fixed_integral(key, NextModes(scene.experiment, self.n_before))
        values = scene.integrals[key]
        return Columns(values, values.shape[-1], by_group=True)

    def amended_basis_settings(self, experiment: Experiment) -> dict[str, Any]:
        """Return the keys of the job's ``[basis]`` table for a basis with more modes; numbers may be larger.

        For a Fourier-Bessel basis the job then takes the largest modes of the model beam, so many as there are here. If
        it has to be free at the edge it has the Neumann condition there.
        """
        modes: list[tuple[int, int]] = []
        while len(modes) <= self.n_before:
            modes += next_modes(experiment, len(modes))
        if isinstance(experiment.basis, Zernike):
            return {"max_degree": modes[-1][0]}
        assert isinstance(experiment.basis, FourierBessel)
        every = list(dict.fromkeys([*experiment.basis.modes, *modes]))
        free = {"boundary": "neumann"} if any(k == AT_EDGE for k, _ in every) else {}
        return free | {
            "n_modes": len(every),
            "k_max": max(k for k, _ in every),
            "m_max": max(abs(m) for _, m in every),
        }


class NextModes:
    """The next modes of an experiment's basis as columns on the sky."""

    def __init__(self, experiment: Experiment, n_before: int = 0) -> None:
        basis, modes = experiment.basis, next_modes(experiment, n_before)
        self._n_modes = len(modes)
        self._parts: list[Zernike | FourierBessel] = []
        if isinstance(basis, Zernike):
            self._parts = [Zernike(modes[-1][0], basis.edge)]
            return
        assert isinstance(basis, FourierBessel)
        if constant := [(1, m) for k, m in modes if k == AT_EDGE]:
            self._parts.append(FourierBessel(constant, "real", basis.edge, "neumann", basis.n_az))
        if others := [(k, m) for k, m in modes if k != AT_EDGE]:
            self._parts.append(basis.with_modes(others, form="real"))

    def __call__(self, sources: Sources) -> FloatArray:
        """Evaluate them, (n_modes, Nsrc)."""
        return np.concatenate([part.columns(sources.za, sources.az) for part in self._parts])[-self._n_modes :]


def next_modes(experiment: Experiment, n_before: int = 0) -> list[tuple[int, int]]:
    """Return the modes that a basis would have next: at most 128, and not more than it has.

    Parameters
    ----------
    experiment : Experiment
    n_before : int
        How many of them come before those that are wanted.

    Returns
    -------
    list of (int, int)
        (k, m) of Fourier-Bessel functions in real form, with k = 0 for those that are constant in radius; or (n, m) of
        whole degrees of Zernike polynomials, one or more.
    """
    basis = experiment.basis
    most = min(MOST_MODES, basis.n_modes)
    if isinstance(basis, Zernike):
        first = basis.degree + 1
        while sum(n + 1 for n in range(basis.degree + 1, first)) < n_before:
            first += 1
        degree = first
        while sum(n + 1 for n in range(first, degree + 2)) <= most:
            degree += 1
        return [(n, m) for n in range(first, degree + 1) for m in range(-n, n + 1, 2)]
    assert isinstance(basis, FourierBessel)
    at_edge: list[tuple[int, int]] = []
    if basis.boundary == "dirichlet":
        largest = max(abs(m) for _, m in basis.modes)
        at_edge = [(AT_EDGE, m) for order in range(largest + 1) for m in dict.fromkeys([order, -order])]
    others = max(n_before + most - len(at_edge), 0)
    return (at_edge + _next_fourier_bessel(basis, _amplitudes(experiment), others))[n_before : n_before + most]


def _next_fourier_bessel(basis: FourierBessel, amplitudes: FloatArray, most: int) -> list[tuple[int, int]]:
    """Return the modes that are expected to be largest by those of the basis that are near.

    A mode is expected to be as large as any other reduced by a factor e for each step in k and in |m|, and by e^3 more
    where one |m| is even and the other odd, as most feeds look alike when turned by half a turn. Of the modes that a
    selection by amplitude has left out of dipole and dish beams, this finds more than do smooth fits or order alone.
    """
    present = set(basis.modes)
    logs = np.log(np.maximum(amplitudes, _NEGLIGIBLE * amplitudes.max()))
    k, m = np.array(basis.modes).T
    expected = np.full((k.max() + _MARGIN, abs(m).max() + 1 + _MARGIN), -np.inf)
    np.maximum.at(expected, (k - 1, abs(m)), logs)
    steps_k, steps_m = (abs(np.subtract.outer(np.arange(n), np.arange(n))) for n in expected.shape)
    steps_m += 3 * (steps_m % 2)
    expected = (expected - steps_k[:, :, np.newaxis]).max(axis=1)
    expected = (expected[:, np.newaxis] - steps_m).max(axis=2)
    chosen: list[tuple[int, int]] = []
    for place in np.argsort(-expected, axis=None, kind="stable").tolist():
        row, order = divmod(place, expected.shape[1])
        pair = [mode for mode in dict.fromkeys([(row + 1, order), (row + 1, -order)]) if mode not in present]
        if len(chosen) + len(pair) <= most:
            chosen += pair
    return chosen


def _amplitudes(experiment: Experiment) -> FloatArray:
    """Return how large the model beam's coefficients are over all channels, root mean square, (n_modes,)."""
    amplitudes = [experiment.basis.amplitudes(coeffs) for coeffs in experiment.prior_mean]
    return np.sqrt(np.mean(np.square(amplitudes), axis=0))
