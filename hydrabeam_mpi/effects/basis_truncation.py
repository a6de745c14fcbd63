"""A basis that is too small: the beam has more structure than its functions can follow."""

from __future__ import annotations

from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.base import Columns, Effect, Parameters
from hydrabeam_mpi.effects.displaced import need_real_beam
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.model.bases.base import NEGLIGIBLE, NextModes

MOST_MODES = 128


class BasisTruncation(Effect):
    """The beam has modes that the basis lacks: the next ones, each channel its own.

    The basis says which these are. As redundant baselines share the beam, they share these.
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
        if self._next(experiment) is None:
            return "it is not known which functions come next; a Fourier-Bessel or Zernike basis would tell"
        return need_real_beam(experiment)

    def parameters(self, experiment: Experiment) -> Parameters:
        """Return the coefficients of the next modes, expected to be as large as the smallest that there are."""
        modes = self.next_modes(experiment).modes
        amplitudes = _amplitudes(experiment)
        told = np.sort(amplitudes[amplitudes > NEGLIGIBLE * amplitudes.max()])
        return Parameters.of(
            [f"coefficient of mode {mode}" for mode in modes], "", float(np.median(told[: len(modes)]))
        )

    def columns(self, scene: Scene, x: FloatArray) -> Columns:
        """Return the visibilities of the modes."""
        key = f"{self.kind} {self.n_before}"
        if key not in scene.integrals:
            modes = self.next_modes(scene.experiment)
            scene.integrals[key] = scene.fixed_integral(key, lambda sources: modes.columns(sources.za, sources.az))
        values = scene.integrals[key]
        return Columns(values, values.shape[-1], by_group=True)

    def amended_basis_settings(self, experiment: Experiment) -> dict[str, Any]:
        """Return the keys of the job's ``[basis]`` table for a basis with more modes; numbers may be larger.

        For a Fourier-Bessel basis the job then takes the largest modes of the model beam, so many as there are here. If
        it has to be free at the edge it has the Neumann condition there.
        """
        return self.next_modes(experiment).settings

    def next_modes(self, experiment: Experiment) -> NextModes:
        """Return the modes, at most 128 and not more than the basis has; it must know which come next."""
        modes = self._next(experiment)
        assert modes is not None
        return modes

    def _next(self, experiment: Experiment) -> NextModes | None:
        basis = experiment.basis
        return basis.next_modes(_amplitudes(experiment), self.n_before, min(MOST_MODES, basis.n_modes))


def _amplitudes(experiment: Experiment) -> FloatArray:
    """Return how large the model beam's coefficients are over all channels, root mean square, (n_modes,)."""
    amplitudes = [experiment.basis.amplitudes(coeffs) for coeffs in experiment.prior_mean]
    return np.sqrt(np.mean(np.square(amplitudes), axis=0))
