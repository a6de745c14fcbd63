"""Whether chains have converged, and how many independent draws they are worth, block by block.

R-hat compares the spread within each half of a chain with the spread of all together, of the ranks of the draws and of
their distance from the median; bulk and tail effective sample sizes (ESS) are the numbers of independent draws that
would give means, and 5% and 95% quantiles, as well (Vehtari et al. 2021, Bayesian Analysis 16, 667). They are computed
by arviz-stats, on some parameters at a time: only those draws are in memory.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from arviz_stats.base.array import array_stats

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.sampling.storage.store import ChainStore
from hydrabeam_mpi.sampling.storage.variable import Variable

LARGEST_R_HAT = 1.01
"""What Vehtari et al. (2021) ask for."""
TAIL = (0.05, 0.95)
"""Quantiles whose effective sample size is that of the tails, after them."""
FEWEST_DRAWS = 4
"""Halves of a chain with fewer than two draws have no spread."""
SLICE_BYTES = 32 << 20
"""Draws that are in memory at a time; ranks and quantiles take some times that."""


@dataclass(frozen=True)
class Mixing:
    """How the numbers of a variable mix.

    Attributes
    ----------
    variable : Variable
    r_hat, ess_bulk, ess_tail : ndarray, (n,)
        NaN where a number does not move, or there are too few draws. A complex variable has n = 2 size: real parts,
        then imaginary parts.
    """

    variable: Variable
    r_hat: FloatArray
    ess_bulk: FloatArray
    ess_tail: FloatArray

    def label(self, index: int) -> str:
        """Name a number."""
        part, at = divmod(index, self.variable.size)
        imaginary = "imaginary part of " if part else ""
        return imaginary + self.variable.label(at)


@dataclass(frozen=True)
class BlockMixing:
    """How a block mixes: its worst numbers.

    Attributes
    ----------
    block : str
    n_parameters, n_still : int
        How many numbers it has, and how many of them never move.
    r_hat : float
        The largest; NaN where it is not known.
    worst : str
        The number that has it.
    ess_bulk, ess_tail : float
        The smallest.
    ess_per_second : float
        The smallest of both, a second that the chains have taken together.
    """

    block: str
    n_parameters: int
    n_still: int
    r_hat: float
    worst: str
    ess_bulk: float
    ess_tail: float
    ess_per_second: float


@dataclass(frozen=True)
class Diagnosis:
    """How chains mix.

    Attributes
    ----------
    chains : tuple of int
        Those that are compared.
    n_draws : int
        Draws of each, after the warm-up.
    seconds : float
        What these draws have taken, of all chains together.
    variables : tuple of Mixing
    blocks : tuple of BlockMixing
    """

    chains: tuple[int, ...]
    n_draws: int
    seconds: float
    variables: tuple[Mixing, ...]
    blocks: tuple[BlockMixing, ...]

    def warnings(self) -> list[str]:
        """Say which blocks have not converged, or do not move; a line each."""
        said = []
        for block in self.blocks:
            if block.r_hat > LARGEST_R_HAT:
                said.append(
                    f"block {block.block} has not converged: R-hat of {block.worst} is {block.r_hat:.4g}, above "
                    f"{LARGEST_R_HAT}; draw more"
                )
            if block.n_still and self.n_draws >= _fewest(self.chains):
                said.append(f"block {block.block}: {block.n_still} of {block.n_parameters} parameters never move")
        return said


def diagnose(store: ChainStore) -> Diagnosis:
    """Compare the chains of a folder as far as they have come; those that are less than half as long are left out.

    Raises
    ------
    InputError
        If a file goes while it is read.
    """
    chains, draws = store.comparable()
    n = draws.stop - draws.start
    seconds = float(sum(store.info("seconds", chain, draws).sum() for chain in chains)) if n else 0.0
    variables = tuple(_mixing(store, variable, chains, draws) for variable in store.variables if variable.size)
    names = dict.fromkeys(one.variable.block for one in variables)
    blocks = tuple(_of_block(name, [one for one in variables if one.variable.block == name], seconds) for name in names)
    return Diagnosis(chains, n, seconds, variables, blocks)


def _mixing(store: ChainStore, variable: Variable, chains: tuple[int, ...], draws: slice) -> Mixing:
    parts = 2 if variable.dtype == "complex128" else 1
    numbers = np.full((3, parts, variable.size), np.nan)
    if draws.stop - draws.start >= _fewest(chains):
        for columns, values in _slices(store, variable, chains, draws):
            numbers[:, 0, columns] = _of_real(values.real)
            if parts == 2:
                numbers[:, 1, columns] = _of_real(values.imag)
    return Mixing(variable, *numbers.reshape(3, -1))


def _slices(
    store: ChainStore, variable: Variable, chains: tuple[int, ...], draws: slice
) -> Iterator[tuple[slice, FloatArray]]:
    """Yield some numbers of a variable at a time, (n_chains, n_draws, some)."""
    row = len(chains) * (draws.stop - draws.start) * np.dtype(variable.dtype).itemsize
    width = max(1, SLICE_BYTES // row)
    for begin in range(0, variable.size, width):
        columns = slice(begin, min(begin + width, variable.size))
        yield columns, np.stack([store.read(variable.name, chain, draws, columns) for chain in chains])


def _of_real(values: FloatArray) -> FloatArray:
    """Return R-hat, bulk and tail ESS, (3, n), of (n_chains, n_draws, n); NaN where a number never moves."""
    found = np.full((3, values.shape[-1]), np.nan)
    moves = np.ptp(values, axis=(0, 1)) > 0
    values = values[..., moves]
    axes = {"chain_axis": 0, "draw_axis": 1}
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # a chain that does not move has no spread: its R-hat is infinite
        compared = values if len(values) > 1 else _halves(values[0])
        found[0, moves] = np.nan_to_num(array_stats.rhat(compared, **axes), nan=np.inf, posinf=np.inf)
        found[1, moves] = array_stats.ess(values, method="bulk", **axes)
        found[2, moves] = array_stats.ess(values, method="tail", prob=TAIL, **axes)
    return found


def _fewest(chains: tuple[int, ...]) -> int:
    """Return how many draws of each chain there must be; of a single one both halves are compared."""
    return FEWEST_DRAWS * (2 if len(chains) == 1 else 1)


def _halves(chain: FloatArray) -> FloatArray:
    """Return a single chain, (n_draws, n), as two, between which R-hat can tell whether it still drifts."""
    half = len(chain) // 2
    return np.stack([chain[:half], chain[len(chain) - half :]])


def _of_block(name: str, variables: list[Mixing], seconds: float) -> BlockMixing:
    r_hat = np.concatenate([one.r_hat for one in variables])
    labels = [(one, index) for one in variables for index in range(len(one.r_hat))]
    still = np.isnan(r_hat)
    if still.all():
        nan = float("nan")
        return BlockMixing(name, len(r_hat), int(still.sum()), nan, "", nan, nan, nan)
    worst, index = labels[int(np.nanargmax(r_hat))]
    bulk, tail = (
        float(np.nanmin(np.concatenate([getattr(one, of) for one in variables]))) for of in ("ess_bulk", "ess_tail")
    )
    a_second = min(bulk, tail) / seconds if seconds else float("nan")
    return BlockMixing(
        name, len(r_hat), int(still.sum()), float(np.nanmax(r_hat)), worst.label(index), bulk, tail, a_second
    )
