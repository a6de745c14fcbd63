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
    block = Block(BEAM, basis.n_modes, basis.is_complex)
    if grams is None:
        normals = [NormalEquations([block]) for _ in rows.data]
    else:
        normals = [NormalEquations([block], known={(BEAM, BEAM): gram}) for gram in grams]
    buffers = [RowBuffer(normal, BEAM) for normal in normals]
    weighted, weights = rows.compressed()
    for f, normal in enumerate(normals):
        normal.add_data(rows.data[f], rows.inv_noise_var[f], None if rows.divisor is None else rows.divisor[f])
    for t, design in enumerate(by_time):
        for f, buffer in enumerate(buffers):
            buffer.add(design[f], weighted[f, t], weights[f, t])
    for buffer in buffers:
        buffer.flush()
    return normals


def check_heldout(
    rows: Rows,
    model: ForwardModel,
    basis: LinearBasis,
    posteriors: Sequence[Posterior],
    beams: Sequence[Beam],
    show: bool = False,
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
    show : bool
        Whether to report progress.
    posteriors : list of Posterior
        One a channel.
    beams : list of callable
        The model beam of each channel, before the inference.
    """
    before = model.visibilities(beams, rows.tile.times)
    return check_designs(rows, designs(rows, model, basis, "held-out rows", show), posteriors, before)[0]


def check_designs(
    rows: Rows,
    by_time: Iterable[Array],
    posteriors: Sequence[Posterior],
    before: ComplexArray,
    more_variance: FloatArray | None = None,
    as_read: Rows | None = None,
) -> tuple[list[HeldoutStatistics], ComplexArray]:
    """Do as `check_heldout` with each time's design and the model beam's visibilities, (Nfreqs, Ntimes, Nlocal).

    Returns the inferred beam's visibilities, too.

    ``more_variance``, (Nfreqs, 2, Ntimes, Nbls) in Jy^2, is added to the variance of real and imaginary parts that the
    beam's uncertainty gives. Where effects have been taken out of the ``rows``, those that were read are ``as_read``.
    """
    read = as_read or rows
    statistics, after = [HeldoutStatistics() for _ in rows.data], np.zeros_like(before)
    for t, design in enumerate(by_time):
        for f, posterior in enumerate(posteriors):
            after[f, t], of_groups = predict(posterior, design[f])
            variance = of_groups[:, rows.member]
            if more_variance is not None:
                variance = variance + more_variance[f, :, t]
            before_of_rows = before[f, t][rows.member]
            statistics[f].add(
                rows.data[f, t],
                rows.inv_noise_var[f, t],
                after[f, t][rows.member],
                variance,
                before_of_rows,
                (read.data[f, t], read.inv_noise_var[f, t]),
            )
    return statistics, after


def designs(rows: Rows, model: ForwardModel, basis: LinearBasis, label: str, show: bool) -> Iterator[Array]:
    """Yield each time's design, (Nfreqs, 2, Nlocal, n_modes) or complex (Nfreqs, Nlocal, n_modes)."""
    times = rows.tile.times
    for parts in track(model.design_columns(basis, times), len(times), label, show):
        yield basis.mix(parts[:, 0] + 1j * parts[:, 1] if basis.is_complex else parts)


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
