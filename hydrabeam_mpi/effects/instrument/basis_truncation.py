"""A basis that is too small: the beam has more structure than its functions can follow."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.displaced import need_real_beam
from hydrabeam_mpi.model.bases.base import LinearBasis, NextModes
from hydrabeam_mpi.model.bases.joined import join

N_MODES = 128
"""Modes that are weighed together: many enough that what is lacking shows, and few beside the other effects."""
MOST_MODES = 512
"""Modes that are added at once at most: of so many it can still be asked whether two halves of the data agree."""
REST = (-1, 0)
"""Number by which what the basis leaves of the model beam is called among modes."""


class BasisTruncation(Effect):
    """The beam has modes that the basis lacks: the next ones, each channel its own.

    The basis says which these are. What it leaves of the model beam itself may come before them, as a single function.
    As redundant baselines share the beam, they share these.
    The modes do not depend on the beam, so they are integrated where they are first needed, by `columns`, and kept with
    the block.

    Parameters
    ----------
    n_before : int
        How many of the next modes others have taken.
    n_modes : int
        How many of those after them these are; not more than the basis has.
    rest : bool
        Whether what the basis leaves of the model beam is one more, the first.
    """

    kind = "basis_truncation"
    title = "a basis that is too small"
    is_seen_by_beam = False
    of_both_feeds = True
    linear = True
    is_about_the_beam = True

    def __init__(
        self,
        n_before: Annotated[int, Field(ge=0)] = 0,
        n_modes: Annotated[int, Field(ge=0, le=MOST_MODES)] = N_MODES,
        rest: bool = False,
    ) -> None:
        self.n_before, self.n_modes, self.rest = n_before, n_modes, rest

    def describe(self) -> dict[str, Any]:
        """Return how many of the next modes others have taken, how many these are, and whether the rest is one."""
        described: dict[str, Any] = {"n_before": self.n_before, "n_modes": self.n_modes}
        return described | ({"rest": True} if self.rest else {})

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Refuse complex beams, and bases that do not know their next modes."""
        if self.rest and setup.rest_of_model is None:
            return "the basis leaves nothing of the model beam, so that rest = true adds nothing"
        if not self.rest and not self.n_modes:
            return "n_modes = 0 are no functions; ask for some"
        if not self._next(setup):
            return "it is not known which functions come next; a Fourier-Bessel or Zernike basis would tell"
        if not self.next_modes(setup).modes:
            return f"no modes come after the next {self.n_before}; fewer before them would leave some"
        return need_real_beam(setup)

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the coefficients of the next modes, in units of how large the model beam leads one to expect them.

        Each so many of them may be as large again as they like, or all those of one azimuthal order: a model beam may
        be nearer to the true one in some than in others, as a round one is.
        """
        batches = [one.modes for one in self._next(setup)]
        names = [_name(mode) for modes in batches for mode in modes]
        element = np.repeat(np.arange(len(batches)), list(map(len, batches)))
        orders, across = np.unique([abs(m) for modes in batches for _, m in modes], return_inverse=True)
        parameters = Parameters.of(names, "", self.next_modes(setup).expected, element)
        return replace(parameters, nested=True, across=across, across_trials=len(orders))

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return the visibilities of the modes; ``x`` is (n_params,)."""
        parts = []
        for batch in self._next(block.setup):
            key = f"{self.kind} {batch.modes[0]} {len(batch.modes)}"
            if key not in block.integrals:
                block.integrals[key] = _integrated(block, key, batch.basis)
            parts.append(block.integrals[key])
        values = np.concatenate(parts, axis=-1)
        return Columns(values, values.shape[-1], by_group=True)

    def next_after(self, setup: ObservingSetup, newest: Effect) -> Effect:
        """Return the modes after those that the model got last."""
        if not isinstance(newest, BasisTruncation):
            return self
        return BasisTruncation(newest.n_before + len(newest.parameters(setup)) - newest.rest)

    def sought_in(self, setup: ObservingSetup) -> BasisTruncation:
        """Return the modes with what the basis leaves of the model beam, where it leaves anything."""
        return BasisTruncation(self.n_before, self.n_modes, rest=setup.rest_of_model is not None)

    def rest_of_model(self) -> BasisTruncation | None:
        """Return what the basis leaves of the model beam alone."""
        return BasisTruncation(self.n_before, 0, rest=True) if self.rest else None

    def larger(self, setup: ObservingSetup) -> list[BasisTruncation]:
        """Return more modes at once, batch after batch, until there are no more or they would be too many."""
        found = [self]
        for n_modes in range(self.n_modes + N_MODES, MOST_MODES + 1, N_MODES):
            more = BasisTruncation(self.n_before, n_modes, self.rest)
            if len(more.next_modes(setup).modes) == len(found[-1].next_modes(setup).modes):
                break
            found.append(more)
        return found[1:]

    def beyond_basis(self, setup: ObservingSetup) -> BasisTruncation | None:
        """Return the rest of the model beam, and what does not vanish at the edge, where the basis does."""
        n_beyond = sum(one.n_beyond for one in self._next(setup)) - self.rest
        return BasisTruncation(self.n_before, n_beyond, self.rest) if n_beyond or self.rest else None

    def beam_functions(self, setup: ObservingSetup) -> LinearBasis:
        """Return the modes."""
        return self.next_modes(setup).basis

    def next_modes(self, setup: ObservingSetup) -> NextModes:
        """Return the modes; the basis must know which come next."""
        batches = self._next(setup)
        modes = tuple(mode for one in batches for mode in one.modes)
        expected = np.concatenate([one.expected for one in batches])
        return NextModes(modes, expected, lambda: join([one.basis for one in batches]))

    def _next(self, setup: ObservingSetup) -> list[NextModes]:
        """Return the modes in batches, none of which is empty but the first; no batch where it is not known."""
        key, wanted = (self.kind, self.n_before, self.n_modes, self.rest), min(self.n_modes, setup.basis.n_modes)
        if key not in setup.kept:
            rest = setup.rest_of_model if self.rest else None
            found = [] if rest is None else [NextModes((REST,), np.ones(1), lambda: rest, n_beyond=1)]
            n_before = self.n_before
            for start in range(0, wanted, N_MODES):
                more = setup.basis.next_modes(setup.model_amplitudes, n_before, min(N_MODES, wanted - start))
                if more is None or (found and not more.modes):
                    break
                found.append(more)
                n_before += len(more.modes)
            setup.kept[key] = found
        batches: list[NextModes] = setup.kept[key]
        return batches


def _name(mode: tuple[int, int]) -> str:
    """Return what the coefficient of a mode is called."""
    return "part of what the basis leaves of the model beam" if mode == REST else f"coefficient of mode {mode}"


def _integrated(block: RowBlock, key: str, modes: LinearBasis) -> ComplexArray:
    """Return the visibilities of modes, (Ntimes, Ngroups, n_modes)."""
    known = block.fixed_integral(key, lambda sources: modes.evaluate(sources.za, sources.az))
    return known + block.diffuse_integral(key, modes)
