"""Fit a beam by a linear basis: least squares over the beam's own samples above the horizon.

Every sample with za <= 90 degrees has the same weight (as in Wilensky et al. 2024, Paper I), whatever solid
angle it stands for. Directions of coefficient space whose singular value is below ``RCOND`` times the largest
are left at zero: with an edge below the horizon, functions that live between the horizon and the edge are
hardly sampled.

A Fourier-Bessel basis and samples on rings decouple into one small problem for every m, with two rules where
a ring is too coarse for m. Both say that a beam is smooth; without them plain least squares fits the samples
as well but swings by more than the beam itself between the few samples around the zenith, as J0(0) = 1 for
every m:

- a ring of n azimuths has no component with |m| > n/2, and no say on |m| = n/2;
- where no sample is at the zenith, the beam there has no component with m != 0, with the weight of the
  innermost ring.

With at least 2 m_max + 1 azimuths on every ring and a ring at the zenith, neither rule is ever used. Where
azimuths are not quite equally spaced, each ring is fitted in azimuth first, and its coefficients in radius.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.basis import Array, FloatArray, LinearBasis
from hydrabeam_mpi.model.fourier_bessel import EDGE, Boundary, Form, FourierBessel
from hydrabeam_mpi.model.rings import Pixels, RingGrid, degree_grid

RCOND = 1e-6
"""Relative size of the singular values that are treated as zero."""

_POINTS_AT_ONCE = 4096


@dataclass(frozen=True)
class FourierBesselSpec:
    """Which Fourier-Bessel modes describe a beam.

    Attributes
    ----------
    n_modes : int or None
        Number of coefficients kept, the largest of all; None keeps all.
    form : {"complex", "real"}
    k_max, m_max : int
        All modes are k = 1..k_max, |m| <= m_max.
    edge : float
        Zenith angle of the rim of the disc, radians.
    boundary : {"dirichlet", "neumann"}
    """

    n_modes: int | None = 1024
    form: Form = "real"
    k_max: int = 80
    m_max: int = 45
    edge: float = EDGE
    boundary: Boundary = "dirichlet"

    def full_basis(self) -> FourierBessel:
        """Return the basis of all modes."""
        return FourierBessel.full(self.k_max, self.m_max, form=self.form, edge=self.edge, boundary=self.boundary)


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


def fit_beam(beam: Evaluable | Pixels, spec: FourierBesselSpec | LinearBasis) -> FittedBeam:
    """Fit a beam; for a spec, fit all modes, keep the largest and fit those again.

    Parameters
    ----------
    beam : beam or Pixels
        A beam with its own samples (attribute ``pixels``) is fitted on them, any other on the 1 degree grid.
        So is, with a warning, a beam that has samples at fewer zenith angles than the spec has radial modes.
    spec : FourierBesselSpec or LinearBasis
        A basis is used as it is.

    Raises
    ------
    InputError
        If a complex beam (cross-polarised) is to be fitted by real functions, or there are fewer samples than
        modes.
    """
    pixels = beam if isinstance(beam, Pixels) else beam_pixels(beam)
    if not isinstance(spec, FourierBesselSpec):
        return fit_basis(spec, pixels)
    rings = RingGrid.from_pixels(pixels)
    if rings is not None and len(rings.za) < spec.k_max and not isinstance(beam, Pixels):
        warnings.warn(
            f"the beam's samples at {len(rings.za)} zenith angles cannot carry {spec.k_max} radial modes: "
            "it is interpolated to the 1 degree grid",
            stacklevel=2,
        )
        pixels = Pixels(*degree_grid(), beam(*degree_grid()))
    full = spec.full_basis()
    coeffs, _ = _solve(full, pixels)
    n_modes = full.n_modes if spec.n_modes is None else spec.n_modes
    return fit_basis(select_largest(full, coeffs, n_modes), pixels)


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


def select_largest(basis: FourierBessel, coeffs: Array, n_modes: int) -> FourierBessel:
    """Return the basis of the modes with the largest coefficients, sorted by amplitude |a_km|.

    The modes +-m of a real beam, which have equal amplitude, are kept or dropped together, in either form:
    one of them alone would make the beam complex. Where only one place is left for a pair, the next mode with
    m = 0 takes it.
    """
    amplitude = dict(zip(basis.modes, basis.amplitudes(coeffs).tolist(), strict=True))
    ranked = sorted(basis.modes, key=lambda mode: -amplitude[mode])
    if any(amplitude[k, m] != amplitude.get((k, -m)) for k, m in ranked):
        return basis.with_modes(ranked[:n_modes])
    kept: list[tuple[int, int]] = []
    for k, m in ranked:
        together = [(k, m), (k, -m)] if m else [(k, 0)]
        if m >= 0 and len(kept) + len(together) <= n_modes:
            kept += together
    return basis.with_modes(kept)


def _solve(basis: LinearBasis, pixels: Pixels) -> tuple[Array, int]:
    """Return the coefficients and the number of directions cut."""
    if np.iscomplexobj(pixels.values) and not basis.is_complex:
        raise InputError("a complex beam needs complex coefficients", field="form", remedy='use form = "complex"')
    if len(pixels.values) < basis.n_modes:
        raise InputError(
            f"{basis.n_modes} modes cannot be fitted to {len(pixels.values)} samples above the horizon",
            field="n_modes",
            remedy="ask for fewer modes or give a finer beam",
        )
    rings = RingGrid.from_pixels(pixels) if isinstance(basis, FourierBessel) else None
    if isinstance(basis, FourierBessel) and rings is not None:
        return _fit_rings(basis, rings)
    return _fit_points(basis, pixels)


def _fit_rings(basis: FourierBessel, rings: RingGrid) -> tuple[Array, int]:
    """Solve for the modes of each m on its own."""
    m_max = max(abs(m) for _, m in basis.modes)
    za, n_az = rings.za, rings.n_az
    orders = np.sqrt(basis.n_az) * rings.azimuthal_orders(m_max)
    has_zenith = za[0] < 1e-6
    if not has_zenith:
        za = np.concatenate([[0.0], za])
        n_az = np.concatenate([n_az[:1], n_az])
        orders = np.concatenate([np.zeros((1, 2 * m_max + 1)), orders])
    radial = basis.radial_functions(basis.rho(za)).T
    modes_of_m: dict[int, list[int]] = {}
    for n, (_, m) in enumerate(basis.modes):
        modes_of_m.setdefault(m, []).append(n)

    factors: dict[Any, tuple[FloatArray, int]] = {}
    coeffs = np.zeros(basis.n_modes, dtype=np.complex128 if basis.is_complex else np.float64)
    n_cut = 0
    for m, modes in modes_of_m.items():
        ks = np.array([basis.modes[n][0] for n in modes])
        weight = np.where(2 * abs(m) == n_az, 0.0, np.sqrt(n_az))
        if not has_zenith:
            weight[0] = np.sqrt(n_az[0]) if m else 0
        target = np.where(2 * abs(m) > n_az, 0, _order(orders, m, m_max, basis.is_complex))
        key = (ks.tobytes(), weight.tobytes())
        if key not in factors:
            factors[key] = _pseudo_inverse(weight[:, None] * radial[:, ks - 1])
        inverse, cut = factors[key]
        coeffs[modes] = inverse @ (weight * target)
        n_cut += cut
    return coeffs, n_cut


def _order(orders: Array, m: int, m_max: int, is_complex: bool) -> Array:
    """Return the radial profile that the modes of m must follow."""
    if is_complex:
        return orders[:, m_max + m]
    if m == 0:
        return orders[:, m_max].real
    profile = orders[:, m_max + abs(m)]
    return np.sqrt(2) * (profile.real if m > 0 else -profile.imag)


def _pseudo_inverse(matrix: FloatArray) -> tuple[FloatArray, int]:
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    keep = s > RCOND * s[0]
    return (vt[keep].T / s[keep]) @ u[:, keep].T, matrix.shape[1] - int(keep.sum())


def _fit_points(basis: LinearBasis, pixels: Pixels) -> tuple[Array, int]:
    """Solve the normal equations of any basis at any points, by eigenvectors."""
    normal = np.zeros((basis.n_columns, basis.n_columns))
    projection = np.zeros(basis.n_columns, dtype=pixels.values.dtype)
    for start in range(0, len(pixels.za), _POINTS_AT_ONCE):
        part = slice(start, start + _POINTS_AT_ONCE)
        columns = basis.columns(pixels.za[part], pixels.az[part])
        normal += columns @ columns.T
        projection += columns @ pixels.values[part]
    # With A = C^T M the matrix of the functions, C that of the columns: A^H A = M^H (C C^T) M.
    normal_of_modes = basis.mix(basis.mix(normal).conj().T)
    rhs = basis.mix(projection.conj()).conj()
    values, vectors = np.linalg.eigh(normal_of_modes)
    keep = values > RCOND**2 * values[-1]
    solution = vectors[:, keep] @ ((vectors[:, keep].conj().T @ rhs) / values[keep])
    return solution, basis.n_modes - int(keep.sum())
