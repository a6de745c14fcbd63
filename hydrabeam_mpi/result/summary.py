"""What a posterior says of the beam: coefficients, correlations, eigenbeams, maps on the sky (HDBI II, section 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import Prior
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.rime import Beam
from hydrabeam_mpi.mpi import Comm

# The one-degree grid of HDBI II: zenith angle 0..90, azimuth 0..359.
GRID_ZA: FloatArray = np.deg2rad(np.arange(91.0))
GRID_AZ: FloatArray = np.deg2rad(np.arange(360.0))
N_EIGENBEAMS = 4
"""As many as a row of maps has room for."""
ROUNDING = 1e-8
"""Harmonics smaller than this fraction of the largest are rounding, of tables in single precision at most."""


@dataclass(frozen=True)
class SkyMaps:
    """A posterior beam on the one-degree grid; every map is (91, 360), zenith angle first.

    Attributes
    ----------
    mean : ndarray
        The maximum a posteriori beam, real or complex.
    std : ndarray
        Its posterior standard deviation.
    model : ndarray
        The model beam before the inference.
    truth : ndarray or None
        The beam that the data were simulated with.
    """

    mean: Array
    std: FloatArray
    model: Array
    truth: Array | None


def evaluate_on_grid(beam: Beam) -> Array:
    """Evaluate a beam on the one-degree grid, (91, 360)."""
    za, az = np.meshgrid(GRID_ZA, GRID_AZ, indexing="ij")
    return np.asarray(beam(za.ravel(), az.ravel())).reshape(za.shape)


def map_posterior(comm: Comm, posterior: Posterior, basis: LinearBasis) -> tuple[Array, FloatArray]:
    """Project mean and standard deviation onto the one-degree grid (HDBI II, eqs 27 and 28).

    Collective: all ranks of `comm`, which share out the rings of equal zenith angle.
    """
    mine = np.arange(comm.rank, len(GRID_ZA), comm.size)
    rings = {}
    for ring in mine.tolist():
        columns = basis.evaluate(np.full(len(GRID_AZ), GRID_ZA[ring]), GRID_AZ).T
        rings[ring] = columns @ posterior.mean, np.sqrt(_ring_variance(posterior, columns))
    merged: dict[int, tuple[Array, FloatArray]] = {}
    for part in comm.allgather(rings):
        merged |= part
    mean, std = zip(*(merged[ring] for ring in range(len(GRID_ZA))), strict=True)
    return np.array(mean), np.array(std)


def _ring_variance(posterior: Posterior, rows: Array) -> FloatArray:
    """Return E|a(x - mean)|^2 for the values ``a`` of the functions at each azimuth, rows of (Naz, n); (Naz,).

    The azimuths divide the turn evenly. Of functions that are smooth in azimuth few harmonics are not zero, and their
    covariance is quickly found.
    """
    harmonics = np.fft.fft(rows, axis=0, norm="forward")
    size = np.abs(harmonics).max(axis=1)
    orders = np.flatnonzero(size > ROUNDING * size.max())
    half = solve_triangular(posterior.factor, harmonics[orders].conj().T, lower=True, check_finite=False)
    waves = np.exp(-2j * np.pi / len(rows) * np.outer(orders, np.arange(len(rows))))
    return np.sum(waves.conj() * ((half.conj().T @ half) @ waves), axis=0).real


def departure_from_prior(posterior: Posterior, prior: Prior) -> tuple[float, float]:
    """Return how many times as far from its mean as a prior expects the posterior's lies, and what that is worth.

    With Sigma the covariance of the prior, C that of the posterior and m their means' difference,

        s^2 = m^H Sigma^-1 m / gamma,    gamma = n - tr(Sigma^-1 C),

    where gamma is how many coefficients the data decide (MacKay 1992, Neural Computation 4, 415). A prior of widths s
    times as large has more evidence, by gamma (s^2 - 1 - ln s^2) / 2 in ln for real coefficients and twice as much for
    complex ones, as far as the data decide these coefficients alone.

    Parameters
    ----------
    posterior : Posterior
    prior : Prior
        Flat, there is nothing to depart from: one, and zero.

    Returns
    -------
    s, gain : float
    """
    if prior.log_det_precision is None:
        return 1.0, 0.0
    moved, n = posterior.mean - prior.mean, len(posterior.mean)
    precision = np.zeros((n, n), dtype=posterior.covariance.dtype)
    prior.add_precision(precision)
    decided = max(n - float(np.sum(precision * posterior.covariance.T).real), 1e-9 * n)
    square = float(np.vdot(moved, prior.precision_times(moved)).real) / decided
    gain = decided * (square - 1 - np.log(max(square, 1e-300)))
    return float(np.sqrt(square)), float(gain if posterior.is_complex else gain / 2)


def summarise_coefficients(posterior: Posterior, prior: Prior) -> dict[str, float]:
    """Return the coefficient-space numbers of ``summary.json`` (HDBI II, section 4.1)."""
    departure, gain = departure_from_prior(posterior, prior)
    std = posterior.std
    correlation = posterior.covariance / np.outer(std, std)
    pairs = correlation[np.triu_indices_from(correlation, 1)]
    return {
        "posterior_std_median": float(np.median(std)),
        "condition_number": posterior.condition_number,
        "correlation_below_0.1": float(np.mean(np.abs(pairs) < 0.1)) if pairs.size else 1.0,
        "correlation_max_real": float(pairs.real.max()) if pairs.size else 0.0,
        "prior_departure": departure,
        "prior_departure_log_evidence": gain,
        "z_update_above_10": int(np.sum(np.abs(posterior.mean - prior.mean) > 10 * std)),
    }


BEYOND_ERRORS = 3.0
"""Standard deviations by which a beam is negative beyond its errors; by noise alone a thousandth of the sky is."""


def summarise_maps(maps: SkyMaps) -> dict[str, float]:
    """Return the image-space numbers of ``summary.json`` (HDBI II, section 4.2).

    The error is the real part's, as a power beam of equal feeds is real; the imaginary part is told apart. A
    cross-polarised one is complex, and has neither a sign nor a width.
    """
    numbers = {
        "beam_std_median": float(np.median(maps.std)),
        "beam_update_max": float(np.abs(maps.mean - maps.model).max()),
    }
    crossed = np.iscomplexobj(maps.model)
    if not crossed:
        numbers["imag_max"] = float(np.abs(maps.mean.imag).max())
        numbers["negative_fraction"] = float(np.mean(maps.mean.real < 0))
        numbers["negative_beyond_errors"] = float(np.mean(maps.mean.real < -BEYOND_ERRORS * maps.std))
    for name, values in {"": maps.mean, "_model": maps.model}.items():
        beam = np.abs(values) if crossed else values.real
        numbers[f"beam_peak{name}"] = float(beam.max())
        if not crossed:
            numbers[f"beam_fwhm_ew_deg{name}"] = full_width(beam[:, 0], beam[:, 180])
            numbers[f"beam_fwhm_ns_deg{name}"] = full_width(beam[:, 90], beam[:, 270])
    if maps.truth is not None:
        error = np.abs(maps.truth - maps.mean if crossed else maps.truth.real - maps.mean.real)
        # Where all basis functions vanish, as on a Dirichlet edge at the horizon, there is no score.
        scored = maps.std > 1e-9 * maps.std.max()
        z = np.abs(maps.truth - maps.mean)[scored] / maps.std[scored]
        numbers |= {
            "beam_error_below_1e-4": float(np.mean(error < 1e-4)),
            "beam_error_max": float(error.max()),
            "beam_error_max_za_deg": float(np.rad2deg(GRID_ZA[np.unravel_index(error.argmax(), error.shape)[0]])),
            "beam_error_rms": float(np.sqrt(np.mean(error**2))),
            "model_error_max": float(np.abs(maps.truth - maps.model).max()),
            "beam_z_median": float(np.median(z)),
            "beam_z_max": float(z.max()),
        }
    return numbers


def full_width(forward: FloatArray, backward: FloatArray) -> float:
    """Return the full width at half maximum of a cut through the zenith, degrees; at most from horizon to horizon.

    Parameters
    ----------
    forward, backward : ndarray, (91,)
        The beam at zenith angles 0..90 degrees on either side; between them it is taken as linear.
    """
    cut = np.concatenate([backward[:0:-1], forward])
    top = int(cut.argmax())
    width = 0.0
    for side in (cut[top:], cut[top::-1]):
        below = np.flatnonzero(side < cut[top] / 2)
        if below.size:
            end = below[0]
            width += end - (cut[top] / 2 - side[end]) / (side[end - 1] - side[end])
        else:
            width += len(side) - 1
    return float(width)


def eigenbeams(posterior: Posterior, basis: LinearBasis) -> tuple[FloatArray, Array]:
    """Return the best-constrained eigenvectors of the posterior covariance on the sky.

    Returns
    -------
    variances : ndarray, (n,)
        Smallest eigenvalues, ascending, `N_EIGENBEAMS` of them or all.
    beams : ndarray, (n, 91, 360)
    """
    n = min(N_EIGENBEAMS, len(posterior.mean))
    values, vectors = posterior.largest(n)
    variances = 1 / values
    beams = np.empty((n, len(GRID_ZA), len(GRID_AZ)), dtype=vectors.dtype)
    for ring, za in enumerate(GRID_ZA):
        beams[:, ring] = vectors.T @ basis.evaluate(np.full(len(GRID_AZ), za), GRID_AZ)
    return variances, beams
