"""Fit a beam by a linear basis: least squares over the beam's own samples above the horizon.

Every sample with za <= 90 degrees has the same weight (as in Wilensky et al. 2024, Paper I), whatever solid
angle it stands for. Directions of coefficient space whose singular value is below ``RCOND`` times the largest
are left at zero: with an edge below the horizon, functions that live between the horizon and the edge are
hardly sampled. A basis whose functions separate on rings of samples fits these in its own way (`ring_fit`).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.eigen import eigen
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.base import NEGLIGIBLE, LinearBasis, Selection, has_part
from hydrabeam_mpi.model.bases.healpix_map import HealpixMap
from hydrabeam_mpi.model.bases.rest import Rest, rest_nodes
from hydrabeam_mpi.model.bases.ring_fit import RCOND
from hydrabeam_mpi.model.bases.rings import Pixels, RingGrid, degree_grid
from hydrabeam_mpi.model.bases.with_rest import WithRest

_POINTS_AT_ONCE = 4096


@dataclass(frozen=True)
class FittedBeam:
    """Coefficients of a beam in a basis and what they leave over.

    Attributes
    ----------
    basis : LinearBasis
    coeffs : ndarray, (n_modes,)
    rms_residual, max_residual : float
        Of |samples - fit| over the samples fitted.
    n_pixels : int
        Number of samples.
    n_cut : int
        Number of directions of coefficient space that the samples do not determine.
    """

    basis: LinearBasis
    coeffs: Array
    rms_residual: float
    max_residual: float
    n_pixels: int
    n_cut: int


class Evaluable(Protocol):
    """Anything that gives beam values at (za, az)."""

    def __call__(self, za: FloatArray, az: FloatArray) -> Array:
        """Return the values, (Npoints,)."""
        ...


def fit_beam(beam: Evaluable | Pixels, basis: LinearBasis | Selection) -> FittedBeam:
    """Fit a beam; for a selection, fit all modes, keep the largest and fit those again.

    Parameters
    ----------
    beam : beam or Pixels
        A beam with its own samples (attribute ``pixels``) is fitted on them, any other on the 1 degree grid.
        So is, with a warning, a beam that has samples at fewer zenith angles than the modes to select from need.
    basis : LinearBasis or Selection
        A basis is used as it is.

    Raises
    ------
    InputError
        If a complex beam (cross-polarised) is to be fitted by real functions, or there are fewer samples than
        modes.
    """
    pixels = beam if isinstance(beam, Pixels) else beam_pixels(beam)
    if not isinstance(basis, Selection):
        return fit_basis(basis, pixels)
    full = basis.basis
    rings = RingGrid.from_pixels(pixels)
    if rings is not None and len(rings.za) < full.n_rings and not isinstance(beam, Pixels):
        warnings.warn(
            f"the beam's samples at {len(rings.za)} zenith angles cannot carry {full.n_rings} radial modes: "
            "it is interpolated to the 1 degree grid",
            stacklevel=2,
        )
        pixels = Pixels(*degree_grid(), beam(*degree_grid()))
    coeffs, _ = _solve(full, pixels)
    n_modes = min(basis.n_modes or full.n_modes, full.n_modes)
    amplitudes = full.amplitudes(coeffs)
    if np.count_nonzero(has_part(amplitudes)) < n_modes:
        amplitudes = full.expected(amplitudes)
    chosen = full.largest(amplitudes, n_modes)
    if not basis.rest or isinstance(beam, Pixels) or np.iscomplexobj(pixels.values):
        return fit_basis(chosen, pixels)
    return fit_basis(_with_rest(chosen, beam, pixels), pixels)


def beam_pixels(beam: Evaluable) -> Pixels:
    """Return a beam's own samples, or its values on the 1 degree grid where it has none."""
    own = getattr(beam, "pixels", None)
    if isinstance(own, Pixels):
        return own
    za, az = degree_grid()
    return Pixels(za, az, beam(za, az))


def fit_basis(basis: LinearBasis, pixels: Pixels) -> FittedBeam:
    """Fit the coefficients of a given basis to samples; errors as for :func:`fit_beam`."""
    coeffs, n_cut = _solve(basis, pixels)
    residual = np.abs(pixels.values - basis.synthesize(coeffs, pixels.za, pixels.az))
    rms = float(np.sqrt(np.mean(residual**2)))
    return FittedBeam(basis, coeffs, rms, float(residual.max()), len(residual), n_cut)


def fit_several(basis: LinearBasis, pixels: Pixels, values: Array) -> Array:
    """Return the coefficients of several beams, (K, n_modes), by their values at the same samples, (K, Npixels)."""
    several = replace(pixels, values=values)
    if isinstance(basis, WithRest):
        coeffs, rest = fit_several(basis.basis, pixels, values), basis.rest(pixels.za, pixels.az)
        each = [replace(pixels, values=one) for one in values]
        parts = [_part_of_rest(one, basis.basis, own, rest) for one, own in zip(each, coeffs, strict=True)]
        return np.column_stack([coeffs, parts])
    return _solve(basis, several)[0]


def _with_rest(chosen: LinearBasis, beam: Evaluable, pixels: Pixels) -> LinearBasis:
    """Return a basis with one more function, what it leaves of the beam; without it where it leaves nothing."""
    coeffs, _ = _solve(chosen, pixels)
    left = _left_of(pixels, chosen, coeffs)
    if np.abs(left.values).max() <= NEGLIGIBLE * np.abs(pixels.values).max():
        return chosen
    # Of the size that the others have, on average over a part of the samples, so that coefficients compare.
    some = slice(None, None, max(1, len(left.za) // _POINTS_AT_ONCE))
    size = float(np.sqrt(np.mean(np.abs(chosen.evaluate(left.za[some], left.az[some])) ** 2)))
    scale = size / float(np.sqrt(np.mean(left.values**2)))
    at_nodes = _left_of(_at_nodes(beam), chosen, coeffs).values
    return WithRest(chosen, Rest(scale * at_nodes, _samples_of(beam, scale)))


def rest_of(beam: Evaluable, basis: LinearBasis, coeffs: Array) -> Rest | None:
    """Return what the functions of a basis leave of a real beam with the ``coeffs``, (n_modes,), of its fit.

    None where that is nothing, or the beam is complex.
    """
    nodes = _at_nodes(beam)
    left = _left_of(nodes, basis, coeffs).values
    if np.iscomplexobj(left) or np.abs(left).max() <= NEGLIGIBLE * np.abs(nodes.values).max():
        return None
    return Rest(left, _samples_of(beam, 1.0))


def _samples_of(beam: Evaluable, scale: float) -> HealpixMap | None:
    """Return a multiple of the HEALPix map that a beam is interpolated from; None where it is from none."""
    samples = getattr(beam, "interpolate", None)
    return samples.times(scale) if isinstance(samples, HealpixMap) else None


def _at_nodes(beam: Evaluable) -> Pixels:
    """Return the values of a beam at the nodes of a rest."""
    za, az = rest_nodes()
    return Pixels(za, az, np.asarray(beam(za, az)))


def _left_of(pixels: Pixels, basis: LinearBasis, coeffs: Array) -> Pixels:
    """Return what a fit leaves of samples, of which it is the real part where they are real."""
    fitted = basis.synthesize(coeffs, pixels.za, pixels.az)
    return replace(pixels, values=pixels.values - (fitted if np.iscomplexobj(pixels.values) else fitted.real))


def _part_of_rest(pixels: Pixels, basis: LinearBasis, coeffs: Array, rest: FloatArray) -> Array:
    """Return how much of the rest, at the samples, is in what the other functions leave of these."""
    return np.asarray((rest @ _left_of(pixels, basis, coeffs).values) / (rest @ rest))


def _solve(basis: LinearBasis, pixels: Pixels) -> tuple[Array, int]:
    """Return the coefficients and the number of directions cut; but for a rest, of several beams, too."""
    if isinstance(basis, WithRest):
        # The rest is what the others leave, and is fitted to that.
        coeffs, n_cut = _solve(basis.basis, pixels)
        part = _part_of_rest(pixels, basis.basis, coeffs, basis.rest(pixels.za, pixels.az))
        return np.append(coeffs, part), n_cut
    if np.iscomplexobj(pixels.values) and not basis.is_complex:
        told = "a complex beam needs complex coefficients"
        raise InputError(told, field="[basis] form", remedy='use form = "complex"')
    if len(pixels.za) < basis.n_modes:
        raise InputError(
            f"has {basis.n_modes} functions to choose from, which cannot be fitted to the beam's {len(pixels.za)} "
            "samples above the horizon",
            field="[basis]",
            remedy="ask for lower orders (k_max, m_max), or give a finer beam",
        )
    on_rings = _on_rings(basis, pixels)
    return _fit_points(basis, pixels) if on_rings is None else on_rings


def _on_rings(basis: LinearBasis, pixels: Pixels) -> tuple[Array, int] | None:
    """Return the same where the samples lie on rings and the basis has a way of its own for these."""
    rings = RingGrid.from_pixels(pixels) if basis.n_rings else None
    return None if rings is None else basis.fit_rings(rings)


def _fit_points(basis: LinearBasis, pixels: Pixels) -> tuple[Array, int]:
    """Solve the normal equations of any basis at any points, by eigenvectors; of several values, (K, Npixels), too."""
    normal = np.zeros((basis.n_columns, basis.n_columns))
    projection = np.zeros((*pixels.values.shape[:-1], basis.n_columns), dtype=pixels.values.dtype)
    for start in range(0, len(pixels.za), _POINTS_AT_ONCE):
        part = slice(start, start + _POINTS_AT_ONCE)
        columns = basis.columns(pixels.za[part], pixels.az[part])
        normal += columns @ columns.T
        projection += pixels.values[..., part] @ columns.T
    # With A = C^T M the matrix of the functions, C that of the columns: A^H A = M^H (C C^T) M.
    normal_of_modes = basis.mix(basis.mix(normal).conj().T)
    rhs = basis.mix(projection.conj()).conj().T
    values, vectors = eigen(normal_of_modes)
    keep = values > RCOND**2 * values[-1]
    solution = ((vectors[:, keep].conj().T @ rhs).T / values[keep]) @ vectors[:, keep].T
    return solution, basis.n_modes - int(keep.sum())
