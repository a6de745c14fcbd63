"""A rank's share of the work: its rows into normal equations, and its held-out rows into residual statistics."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.row_buffer import RowBuffer
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.inference.gaussian import Block
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.predictive_checks import HeldoutStatistics
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.rime import Beam, ForwardModel
from hydrabeam_mpi.terminal.progress import track


def accumulate(rows: Rows, model: ForwardModel, basis: LinearBasis) -> list[NormalEquations]:
    """Build the partial normal equations of ``rows`` as ``model`` sees them; see `accumulate_designs`."""
    return accumulate_designs(rows, designs(rows, model, basis, "design matrix", show=False), basis)


def accumulate_designs(
    rows: Rows, by_time: Iterable[Array], basis: LinearBasis, grams: Sequence[Array] | None = None
) -> list[NormalEquations]:
    """Build a rank's partial normal equations, one set a channel, streaming over its times.

    Parameters
    ----------
    rows : Rows
        The rank's training rows.
    by_time : iterable of ndarray, (Nfreqs, ..., Nlocal, n_modes)
        The design of each time, as `designs` gives it.
    basis : LinearBasis
        The beam basis.
    grams : sequence of ndarray, (n_modes, n_modes), optional
        A^H N^-1 A of all ranks' rows, one a channel, where it is known already.
    """
    sums = Accumulator(rows, basis, grams)
    for t, design in enumerate(by_time):
        sums.add(t, design)
    return sums.finish()


class Accumulator:
    """A rank's partial normal equations, one set a channel, which grow by one time after the other.

    Parameters
    ----------
    rows, basis, grams
        As of `accumulate_designs`.
    about : sequence of ndarray, (n_modes,), optional
        Coefficients of each channel from which the beam is counted; see `NormalEquations`.
    """

    def __init__(
        self,
        rows: Rows,
        basis: LinearBasis,
        grams: Sequence[Array] | None = None,
        about: Sequence[Array] | None = None,
    ) -> None:
        block = Block(BEAM, basis.n_modes, basis.is_complex)
        self._about = about
        self._normals = [
            NormalEquations(
                [block],
                known=None if grams is None else {(BEAM, BEAM): grams[f]},
                about=None if about is None else {BEAM: about[f]},
            )
            for f in range(len(rows.data))
        ]
        self._buffers = [RowBuffer(normal, BEAM) for normal in self._normals]
        self._weighted, self._weights = rows.compressed()
        for f, normal in enumerate(self._normals):
            normal.add_data(rows.data[f], rows.inv_noise_var[f], None if rows.divisor is None else rows.divisor[f])

    def add(self, t: int, design: Array) -> None:
        """Add the rank's time number ``t`` with its design, (Nfreqs, ..., Nlocal, n_modes)."""
        for f, buffer in enumerate(self._buffers):
            weighted, weights = self._weighted[f, t], self._weights[f, t]
            if self._about is not None:
                seen = seen_by(design[f], self._about[f])
                left = weighted - weights * seen
                self._normals[f].scalars[0] -= np.vdot(seen, weighted + left).real
                weighted = left
            buffer.add(design[f], weighted, weights)

    def finish(self) -> list[NormalEquations]:
        """Return what all times give."""
        for buffer in self._buffers:
            buffer.flush()
        return self._normals


def check_heldout(
    rows: Rows,
    model: ForwardModel,
    basis: LinearBasis,
    posteriors: Sequence[Posterior],
    beams: Sequence[Beam],
) -> list[HeldoutStatistics]:
    """Compare a rank's held-out rows with the posterior predictive (HDBI II, eq. 14) and with the model beam.

    Parameters
    ----------
    rows : Rows
        The rank's held-out rows; channels as in ``model``.
    model : ForwardModel
        Its engine holds the vectors of ``rows.groups``.
    basis : LinearBasis
        The beam basis.
    posteriors : list of Posterior
        One a channel.
    beams : list of callable
        The model beam of each channel, before the inference.
    """
    before = model.visibilities(beams, rows.tile.times)
    return check_designs(rows, designs(rows, model, basis, "held-out rows", show=False), posteriors, before)[0]


def check_designs(
    rows: Rows,
    by_time: Iterable[Array],
    posteriors: Sequence[Posterior],
    before: ComplexArray,
    more_variance: FloatArray | None = None,
    as_read: Rows | None = None,
    models: Sequence[Array] | None = None,
) -> tuple[list[HeldoutStatistics], ComplexArray]:
    """Do as `check_heldout` with each time's design and the model beam's visibilities, (Nfreqs, Ntimes, Nlocal).

    Returns the inferred beam's visibilities, too.

    ``more_variance``, (Nfreqs, 2, Ntimes, Nbls) in Jy^2, is added to the variance of real and imaginary parts that the
    beam's uncertainty gives. Where effects have been taken out of the ``rows``, those that were read are ``as_read``.
    With the fit of each channel's model beam, ``models``, it is told what the basis leaves of this.
    """
    check = HeldoutCheck(rows, posteriors, before, more_variance, as_read, models)
    for t, design in enumerate(by_time):
        check.add(t, design)
    return check.statistics, check.after


class HeldoutCheck:
    """A rank's held-out rows against the posterior predictive and the model beam, one time after the other.

    Parameters
    ----------
    rows, posteriors, before, more_variance, as_read, models
        As of `check_designs`.

    Attributes
    ----------
    statistics : list of HeldoutStatistics
        One a channel, of the times so far.
    after : ndarray of complex, (Nfreqs, Ntimes, Nlocal)
        Visibilities of the inferred beam.
    """

    def __init__(
        self,
        rows: Rows,
        posteriors: Sequence[Posterior],
        before: ComplexArray,
        more_variance: FloatArray | None = None,
        as_read: Rows | None = None,
        models: Sequence[Array] | None = None,
    ) -> None:
        self._rows, self._read, self._posteriors = rows, as_read or rows, posteriors
        self._models = models
        self._before, self._more_variance = before, more_variance
        self.statistics, self.after = [HeldoutStatistics() for _ in rows.data], np.zeros_like(before)

    def add(self, t: int, design: Array) -> None:
        """Check the rank's time number ``t`` by its design, (Nfreqs, ..., Nlocal, n_modes)."""
        rows, read = self._rows, self._read
        for f, posterior in enumerate(self._posteriors):
            self.after[f, t], of_groups = predict(posterior, design[f])
            variance = of_groups[:, rows.member]
            if self._more_variance is not None:
                variance = variance + self._more_variance[f, :, t]
            self.statistics[f].add(
                rows.data[f, t],
                rows.inv_noise_var[f, t],
                self.after[f, t][rows.member],
                variance,
                self._before[f, t][rows.member],
                (read.data[f, t], read.inv_noise_var[f, t]),
                None if self._models is None else seen_by(design[f], self._models[f])[rows.member],
            )


def designs(rows: Rows, model: ForwardModel, basis: LinearBasis, label: str, show: bool) -> Iterator[Array]:
    """Yield each time's design, (Nfreqs, 2, Nlocal, n_modes) or complex (Nfreqs, Nlocal, n_modes)."""
    times = rows.tile.times
    for parts in track(model.design_columns(basis, times), len(times), label, show):
        yield mixed(basis, parts)


def mixed(basis: LinearBasis, parts: FloatArray) -> Array:
    """Return a time's design, as of `designs`, of that of the real columns, (Nfreqs, 2, Nlocal, n_columns)."""
    return basis.mix(parts[:, 0] + 1j * parts[:, 1] if basis.is_complex else parts)


def predict(posterior: Posterior, design: Array) -> tuple[ComplexArray, FloatArray]:
    """Return the posterior predictive mean (Nlocal,) and the model variance of its parts (2, Nlocal)."""
    if posterior.is_complex:
        half = 0.5 * posterior.predictive_variance(design)
        return seen_by(design, posterior.mean), np.stack([half, half])
    n_rows = design.shape[1]
    variance = posterior.predictive_variance(design.reshape(2 * n_rows, -1)).reshape(2, n_rows)
    return seen_by(design, posterior.mean), variance


def seen_by(design: Array, coeffs: Array) -> ComplexArray:
    """Return the visibilities A b, (..., Nlocal), of rows (..., 2, Nlocal, n_modes), or complex (..., Nlocal, n_modes).

    ``coeffs`` are (n_modes,).
    """
    parts = design @ coeffs
    return np.asarray(parts if np.iscomplexobj(design) else parts[..., 0, :] + 1j * parts[..., 1, :])
