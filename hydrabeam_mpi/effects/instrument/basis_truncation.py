"""A basis that is too small: the beam has more structure than its functions can follow."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.displaced import need_real_beam
from hydrabeam_mpi.model.bases.base import LinearBasis, NextModes

MOST_MODES = 128


class BasisTruncation(Effect):
    """The beam has modes that the basis lacks: the next ones, each channel its own.

    The basis says which these are. As redundant baselines share the beam, they share these.
    The modes do not depend on the beam, so they are integrated where they are first needed, by `columns`, and kept with
    the block.

    Parameters
    ----------
    n_before : int
        How many of the next modes others have taken.
    """

    kind = "basis_truncation"
    title = "a basis that is too small"
    linear = True
    is_about_the_beam = True

    def __init__(self, n_before: Annotated[int, Field(ge=0)] = 0) -> None:
        self.n_before = n_before

    def describe(self) -> dict[str, Any]:
        """Return how many of the next modes others have taken."""
        return {"n_before": self.n_before}

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Refuse complex beams, and bases that do not know their next modes."""
        if self._next(setup) is None:
            return "it is not known which functions come next; a Fourier-Bessel or Zernike basis would tell"
        if not self.next_modes(setup).modes:
            return f"no modes come after the next {self.n_before}; fewer before them would leave some"
        return need_real_beam(setup)

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the coefficients of the next modes, in units of how large the model beam leads one to expect them."""
        lacking = self.next_modes(setup)
        return Parameters.of([f"coefficient of mode {mode}" for mode in lacking.modes], "", lacking.expected)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the visibilities of the modes; ``x`` is (n_params,)."""
        key = f"{self.kind} {self.n_before}"
        if key not in block.integrals:
            modes = self.beam_functions(block.setup)
            known = block.fixed_integral(key, lambda sources: modes.evaluate(sources.za, sources.az))
            block.integrals[key] = known + block.further_integral(modes)
        values = block.integrals[key]
        return Columns(values, values.shape[-1], by_group=True)

    def next_after(self, setup: ObservingSetup, newest: Effect) -> Effect:
        """Return the modes after those that the model got last."""
        if not isinstance(newest, BasisTruncation):
            return self
        return BasisTruncation(newest.n_before + len(newest.parameters(setup)))

    def beam_functions(self, setup: ObservingSetup) -> LinearBasis:
        """Return the modes."""
        return self.next_modes(setup).basis

    def next_modes(self, setup: ObservingSetup) -> NextModes:
        """Return the modes, at most 128 and not more than the basis has; it must know which come next."""
        modes = self._next(setup)
        assert modes is not None
        return modes

    def _next(self, setup: ObservingSetup) -> NextModes | None:
        key, basis = (self.kind, self.n_before), setup.basis
        if key not in setup.kept:
            setup.kept[key] = basis.next_modes(_amplitudes(setup), self.n_before, min(MOST_MODES, basis.n_modes))
        modes: NextModes | None = setup.kept[key]
        return modes


def _amplitudes(setup: ObservingSetup) -> FloatArray:
    """Return how large the model beam's coefficients are over all channels, root mean square, (n_modes,)."""
    amplitudes = [setup.basis.amplitudes(coeffs) for coeffs in setup.prior_mean]
    return np.sqrt(np.mean(np.square(amplitudes), axis=0))
