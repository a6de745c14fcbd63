"""The one set of sums over rows from which everything is inferred: the normal equations of blocks of unknowns.

Every row of the data is d = sum_i A_i x_i + n with E|n|^2 = 1/w, where the unknowns x_i of a block (the beam's
coefficients, the gains of antennas, the fluxes of sources ...) are real or complex and A_i are its columns. Of the rows

    G_ij = A_i^H N^-1 A_j,   p_i = A_i^H N^-1 d,   d^H N^-1 d,   ln|N^-1|   and the number of data

are all that inference needs; they add up over rows, hence over ranks (HDBI II, eqs 12 and 13). The likelihood is

    -ln L = sum_ij Re x_i^H G_ij x_j - 2 Re sum_i x_i^H p_i + d^H N^-1 d - ln|N^-1| + n ln pi,

the same for real unknowns and for complex ones; between real blocks only the real parts of G and p count and are kept.
That is the only convention of factors. What else follows, such as the Fisher information 2 G of real unknowns, is
derived where it is needed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy.linalg.blas import dsyrk, zherk
from scipy.sparse import issparse

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.columns import Columns
from hydrabeam_mpi.inference.gaussian import Block, Gaussian, spans_of
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.inference.matrices import complete_hermitian
from hydrabeam_mpi.inference.prior import Prior
from hydrabeam_mpi.mpi import Comm, allreduce_sum, allreduce_sum_triangle

BEAM = "beam"
"""Name of the block of the beam's coefficients."""


class NormalEquations:
    """Sums over rows of the products of blocks' columns.

    Parameters
    ----------
    blocks : sequence of Block
    pairs : iterable of (str, str), optional
        Pairs of blocks of which products are summed, the one that comes first in ``blocks`` named first; all by
        default but those that are known.
    known : mapping of (str, str) to ndarray, optional
        Products of pairs of blocks that are complete already, over the rows of all ranks.
    about : mapping of str to ndarray, (size,), optional
        Values from which the unknowns of some blocks are counted, zero by default: the data are d minus what is seen
        at these. Sums are the more exact the nearer these are to the solution.

    Attributes
    ----------
    gram : dict of (str, str) to ndarray
        G_ij of each pair. Those of a block with itself may have one triangle only until they are asked for by a method.
    projection : dict of str to ndarray
        p_i.
    scalars : ndarray, (3,)
        d^H N^-1 d, ln|N^-1| (of the data as read; see `add_data`) and the number of (complex) data.
    """

    def __init__(
        self,
        blocks: Sequence[Block],
        pairs: Iterable[tuple[str, str]] | None = None,
        known: Mapping[tuple[str, str], Array] | None = None,
        about: Mapping[str, Array] | None = None,
    ) -> None:
        self.blocks = {one.name: one for one in blocks}
        names = list(self.blocks)
        if len(names) < len(blocks):
            raise ValueError("blocks need names of their own")
        if pairs is None:
            pairs = [(one, two) for i, one in enumerate(names) for two in names[i:]]
        self._known = dict(known or {})
        self.about = dict(about or {})
        pairs = [pair for pair in pairs if pair not in self._known]
        self.gram = {(one, two): self._zeros(one, two) for one, two in pairs}
        self.projection = {name: self._zeros(name) for name in names}
        self.scalars: FloatArray = np.zeros(3)
        self._half_filled: set[str] = set()

    def _zeros(self, *names: str) -> Array:
        blocks = [self.blocks[name] for name in names]
        dtype = np.complex128 if any(one.is_complex for one in blocks) else np.float64
        return np.zeros([one.size for one in blocks], dtype=dtype, order="F")

    @property
    def data_norm(self) -> float:
        """d^H N^-1 d."""
        return float(self.scalars[0])

    @property
    def log_det_inv_noise(self) -> float:
        """ln|N^-1| over the data with non-zero weight, as they were read."""
        return float(self.scalars[1])

    @property
    def n_data(self) -> int:
        """Number of complex data with non-zero weight."""
        return round(float(self.scalars[2]))

    def add_data(self, data: ComplexArray, inv_noise_var: FloatArray, divisor: FloatArray | None = None) -> None:
        """Account for data, each by itself, in the scalar sums; their columns follow by `add_rows`, summed or not.

        Parameters
        ----------
        data : ndarray of complex, any shape
        inv_noise_var : ndarray, same shape
            Zero for data that do not count.
        divisor : ndarray, same shape, optional
            |d_read / d|^2 where ``data`` are those that were read divided by gains. The density of those read, which
            the evidence is, is that of ``data`` over this.
        """
        used = inv_noise_var > 0
        weights = inv_noise_var[used]
        of_read = weights if divisor is None else weights / divisor[used]
        self.scalars += (np.sum(weights * np.abs(data[used]) ** 2), np.sum(np.log(of_read)), weights.size)

    def add_rows(self, columns: Mapping[str, Columns], beside: Mapping[str, Columns] | None = None) -> None:
        """Add the products of blocks' columns with the data, with each other, and with those of other blocks.

        Parameters
        ----------
        columns : mapping of str to Columns
            By name of block, all of the same rows.
        beside : mapping of str to Columns, optional
            Blocks whose own products with these rows have been added before, or are summed elsewhere.
        """
        for name, one in columns.items():
            self.projection[name] += one.times_data(self.blocks[name].is_complex)
            self._add_own(name, one)
        everything = {**(beside or {}), **columns}
        for (first, second), total in self.gram.items():
            new = first in columns or second in columns
            if new and first != second and first in everything and second in everything:
                total += everything[first].times(everything[second], is_complex=np.iscomplexobj(total))

    def _add_own(self, name: str, columns: Columns) -> None:
        """Add the product of a block's columns with themselves; of dense columns only one triangle."""
        if (name, name) not in self.gram:
            return
        total, is_complex, values = self.gram[name, name], self.blocks[name].is_complex, columns.values
        if issparse(values) or (is_complex and not columns.by_group):
            total += columns.times(columns, is_complex)
            return
        self._half_filled.add(name)
        root = np.sqrt(columns.rows.group_weights if columns.by_group else columns.rows.weights)[:, np.newaxis]
        if is_complex:
            scaled = values.conj()
            scaled *= root
            zherk(1.0, scaled.T, beta=1.0, c=total, overwrite_c=1)
            return
        for part in values if columns.in_parts else (values.real, values.imag):
            dsyrk(1.0, (part * root).T, beta=1.0, c=total, overwrite_c=1)

    def reduce(self, comm: Comm) -> None:
        """Sum over ranks, in place. Collective: all ranks of `comm`."""
        for (first, second), total in self.gram.items():
            # The transpose of an F-ordered array is C-ordered memory, which messages need.
            if first == second:
                allreduce_sum_triangle(comm, total.T)
                complete_hermitian(total)
            else:
                allreduce_sum(comm, total.T)
        self._half_filled.clear()
        for projection in self.projection.values():
            allreduce_sum(comm, projection)
        allreduce_sum(comm, self.scalars)

    def own(self, name: str) -> Array:
        """Return A^H N^-1 A of a block with itself, (n, n); not to be changed."""
        if (name, name) in self._known:
            return self._known[name, name]
        if name in self._half_filled:
            complete_hermitian(self.gram[name, name])
            self._half_filled.remove(name)
        return self.gram[name, name]

    def misfit(self, name: str, x: Array) -> float:
        """Return chi^2 of the data with a block at ``x``, (n,), and all others at zero, |d - A x|^2 over the noise."""
        x = x - self.about.get(name, 0.0)
        quadratic = np.vdot(x, self.own(name) @ x).real - 2 * np.vdot(x, self.projection[name]).real
        return float(self.data_norm + quadratic)

    def with_noise(self, scale: float) -> NormalEquations:
        """Return the same sums with the noise's variance multiplied by ``scale``."""
        names = list(self.blocks)
        pairs = [(one, two) for i, one in enumerate(names) for two in names[i:]]
        known = {(one, two): self._pair(one, two) / scale for one, two in pairs}
        scaled = NormalEquations(list(self.blocks.values()), known=known, about=self.about)
        scaled.projection = {name: one / scale for name, one in self.projection.items()}
        scaled.scalars = np.array(
            [self.scalars[0] / scale, self.scalars[1] - self.scalars[2] * np.log(scale), self.scalars[2]]
        )
        return scaled

    def has(self, one: str, two: str) -> bool:
        """Whether there is the product of two blocks."""
        pairs = (one, two), (two, one)
        return any(pair in self.gram or pair in self._known for pair in pairs)

    def with_part(self, part: str, weights: Mapping[str, Array]) -> NormalEquations:
        """Return the sums where columns of some blocks have a part of a single other one, A_k + A_part w_k^H.

        Parameters
        ----------
        part : str
            A block with one unknown.
        weights : mapping of str to ndarray, (size,)
            w_k of those blocks.
        """
        names, known, of_part = list(self.blocks), dict[tuple[str, str], Array](), self.own(part)[0, 0].real
        w = {name: weights.get(name, np.zeros(one.size))[:, np.newaxis] for name, one in self.blocks.items()}

        def by_part(one: str, two: str) -> Array:
            """Return what a product gets by the part in the first block."""
            return w[one] * self.gather([part], [two]) if one in weights and self.has(part, two) else np.zeros((1, 1))

        for i, one in enumerate(names):
            for two in names[i:]:
                if not self.has(one, two):
                    continue
                if one not in weights and two not in weights:
                    known[one, two] = self._pair(one, two)
                    continue
                total = self._pair(one, two) + by_part(one, two) + by_part(two, one).conj().T
                total = total + of_part * (w[one] @ w[two].conj().T)
                is_complex = self.blocks[one].is_complex or self.blocks[two].is_complex
                known[one, two] = total if is_complex else total.real
        changed = NormalEquations(list(self.blocks.values()), pairs=(), known=known, about=self.about)
        for name, projection in self.projection.items():
            total = projection + w[name][:, 0] * self.projection[part]
            changed.projection[name] = total if self.blocks[name].is_complex else total.real
        changed.scalars = self.scalars
        return changed

    def gather(self, rows: Sequence[str], columns: Sequence[str]) -> Array:
        """Return G of some blocks with some, side by side, (n_rows, n_columns); not to be changed."""
        if len(rows) == len(columns) == 1:
            return self._pair(rows[0], columns[0])
        width = sum(self.blocks[name].size for name in columns)
        lines = [np.concatenate([self._pair(i, j) for j in columns], axis=1) for i in rows if columns]
        return np.concatenate(lines) if lines else np.zeros((sum(self.blocks[name].size for name in rows), width))

    def _pair(self, one: str, two: str) -> Array:
        if one == two:
            return self.own(one)
        if (one, two) in self._known:
            return self._known[one, two]
        if (two, one) in self._known:
            return self._known[two, one].conj().T
        return self.gram[one, two] if (one, two) in self.gram else self.gram[two, one].conj().T

    def likelihood_alone(self, names: Sequence[str]) -> Likelihood:
        """Return what the data say of some blocks with real unknowns, with all others known."""
        signal = 2 * self.gather(names, names)
        return Likelihood(signal, 2 * np.concatenate([np.zeros(0), *(self.projection[name] for name in names)]), signal)

    def gaussian(self, priors: Mapping[str, Prior]) -> Gaussian:
        """Return likelihood times prior of some blocks, those that ``priors`` names, with all others at zero.

        Unknowns are counted from where the sums have them (``about``), their priors are not.

        Raises
        ------
        InputError
            If there are fewer data than unknowns with a flat prior.
        """
        blocks = tuple(self.blocks[name] for name in priors)
        mixed = len({one.is_complex for one in blocks}) > 1
        kappa = 1.0 if blocks[0].is_complex and not mixed else 2.0
        spans = spans_of(blocks, in_parts=mixed)
        n, dtype = max(span.stop for span in spans.values()), np.float64 if kappa == 2.0 else np.complex128
        precision, source = np.zeros((n, n), dtype, order="F"), np.zeros(n, dtype)
        for one in blocks:
            prior, span, in_parts = priors[one.name], spans[one.name], mixed and one.is_complex
            self._check_determined(one.name, prior)
            for two in blocks:
                pair = self._pair(one.name, two.name)
                pair = _matrix_in_parts(pair, one.is_complex, two.is_complex) if mixed else pair
                np.multiply(kappa, pair, out=precision[span, spans[two.name]])
            # Densities of complex unknowns are exp(-q), those of real ones exp(-q/2).
            pull = kappa * self.projection[one.name] + (1 + in_parts) * prior.precision_times(
                self._mean(one.name, prior)
            )
            source[span] = np.concatenate([pull.real, pull.imag]) if in_parts else pull
            own = np.zeros(2 * [one.size], dtype=np.complex128) if in_parts else precision[span, span]
            prior.add_precision(own)
            if in_parts:
                precision[span, span] += 2 * _matrix_in_parts(own, rows=True, columns=True)
        return Gaussian(blocks, precision, source, self._log_scale(blocks, priors))

    def _log_scale(self, blocks: Sequence[Block], priors: Mapping[str, Prior]) -> float | None:
        """Return ln of likelihood times prior where unknowns are zero as they are counted; None with a flat prior."""
        log_scale = self.log_det_inv_noise - self.n_data * np.log(np.pi) - self.data_norm
        for one in blocks:
            prior = priors[one.name]
            if prior.log_det_precision is None:
                return None
            kappa = 1.0 if one.is_complex else 2.0
            mean = self._mean(one.name, prior)
            quadratic = float(np.vdot(mean, prior.precision_times(mean)).real)
            log_scale += (prior.log_det_precision - quadratic - one.size * np.log(kappa * np.pi)) / kappa
        return float(log_scale)

    def _mean(self, name: str, prior: Prior) -> Array:
        """Return a prior's mean as unknowns are counted, (size,)."""
        return np.asarray(prior.mean - self.about.get(name, 0.0))

    def _check_determined(self, name: str, prior: Prior) -> None:
        block = self.blocks[name]
        if prior.log_det_precision is None and block.size > self.n_data * (1 if block.is_complex else 2):
            raise InputError(
                f"{block.size} coefficients cannot be inferred from {self.n_data} visibilities with a flat prior",
                field="[prior] kind",
                remedy="use fewer modes ([basis] n_modes), more data, or a prior that is not flat",
            )


def _matrix_in_parts(matrix: Array, rows: bool, columns: bool) -> FloatArray:
    """Return the real matrix M with Re x^H G y = x'^T M y', where x', y' have complex vectors in parts."""
    lines = [[matrix.real, -matrix.imag], [matrix.imag, matrix.real]]
    return np.block([line[: 1 + columns] for line in lines[: 1 + rows]])
