"""The Fourier-Bessel basis on the hemisphere projected to the unit disc (HDBI II, section 2.2).

    f_km(za, az) = J0(u_k rho) / q_k * exp(i m az) / sqrt(N_az),    rho = sqrt(1 - cos za) / alpha

with alpha = sqrt(1 - cos edge), so that rho = 1 at za = edge. The radial functions obey

    "dirichlet"   J0(u_k) = 0              q_k = J1(u_k) / sqrt 2
    "neumann"     u_1 = 0, J1(u_k) = 0     q_k = |J0(u_k)| / sqrt 2

either of which makes the integral of rho (J0/q)^2 over 0..1 equal to one; the azimuthal functions have unit
norm as vectors on N_az equally spaced azimuths. In real form the pair exp(+-i m az) is replaced by
sqrt2 cos(m az) and sqrt2 sin(m az), which keeps that norm.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from scipy.special import j0

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.base import LinearBasis, NextModes, Selection
from hydrabeam_mpi.model.bases.bessel import Boundary, radial_rows, radial_zeros
from hydrabeam_mpi.model.bases.disc import EDGE, azimuthal_around, azimuthal_rows, check_edge
from hydrabeam_mpi.model.bases.expected import expected_of_all, next_expected
from hydrabeam_mpi.model.bases.joined import Joined
from hydrabeam_mpi.model.bases.plans import complex_columns, plan_mixing, plan_products
from hydrabeam_mpi.model.bases.polar_table import n_nodes, radii
from hydrabeam_mpi.model.bases.ring_fit import fit_rings
from hydrabeam_mpi.model.bases.rings import RingGrid

Form = Literal["real", "complex"]

AT_EDGE = 0
"""Number k by which the function that is constant in radius is called beside those that are zero at the edge."""

_SETTINGS = ("form", "boundary", "edge", "n_az")
_POINTS_AT_ONCE = 2048  # so that the work space stays near 6 MB whatever is asked


class FourierBessel(LinearBasis):
    """A set of Fourier-Bessel modes.

    An object owns work space that its methods overwrite (never their results): threads need one each.

    Parameters
    ----------
    modes : iterable of (k, m)
        Radial numbers k = 1, 2, ... and azimuthal numbers m, in the order of the coefficients. In real form
        m > 0 means cos(m az) and m < 0 means sin(|m| az).
    form : {"real", "complex"}
    edge : float
        Zenith angle of the rim of the disc, radians.
    boundary : {"dirichlet", "neumann"}
        Condition at the rim.
    n_az : int
        Number of azimuths on which the azimuthal functions have unit norm.

    Raises
    ------
    InputError
        If there is no mode, a mode is repeated or has k < 1, or a setting is out of range.
    """

    title: ClassVar[str] = "Fourier-Bessel"

    def __init__(
        self,
        modes: Iterable[tuple[int, int]],
        form: Form = "real",
        edge: float = EDGE,
        boundary: Boundary = "dirichlet",
        n_az: int = 360,
    ) -> None:
        self.modes = [(int(k), int(m)) for k, m in modes]
        _check(self.modes, form, edge, boundary)
        self.form, self.edge, self.boundary, self.n_az = form, float(edge), boundary, int(n_az)
        self.is_complex = form == "complex"
        self.n_modes = len(self.modes)
        self._ks = sorted({k for k, _ in self.modes})
        self._m_max = max(abs(m) for _, m in self.modes)
        self._inv_alpha_squared = 1 / (1 - np.cos(self.edge))
        azimuthal_norm = np.sqrt((1 if self.is_complex else 2) / self.n_az)
        self._radial = radial_rows(tuple(self._ks), boundary, float(azimuthal_norm))
        columns = complex_columns(self.modes) if self.is_complex else self.modes
        self.n_columns = len(columns)
        # Of every column, its row among the radial and among the azimuthal functions.
        self._k_row = np.searchsorted(self._ks, [k for k, _ in columns])
        self._m_row = np.array([2 * abs(m) + (m < 0) for _, m in columns])
        self._products = plan_products(self._k_row.tolist(), self._m_row.tolist())
        self._mixing = plan_mixing(self.modes, columns) if self.is_complex else None
        self._buffer = np.empty(0)

    @classmethod
    def full(cls, k_max: int = 80, m_max: int = 45, **settings: Any) -> FourierBessel:
        """Return the basis of all modes k = 1..k_max, |m| <= m_max; ``settings`` as for the class."""
        signed = [0] + [sign * m for m in range(1, m_max + 1) for sign in (1, -1)]
        return cls([(k, m) for m in signed for k in range(1, k_max + 1)], **settings)

    @classmethod
    def selection(
        cls,
        n_modes: int | None = 1024,
        form: Form = "real",
        k_max: int = 80,
        m_max: int = 45,
        rest: bool = False,
        **settings: Any,
    ) -> Selection:
        """Select so many modes, None for all, of those of `full`; with the ``rest``, all that a beam has beyond."""
        return Selection(cls.full(k_max, m_max, form=form, **settings), n_modes, rest)

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> Selection:
        """Select the largest of a job's ``n_modes`` from all up to its orders; see :class:`LinearBasis`."""
        same = {name: settings[name] for name in ("n_modes", "form", "k_max", "m_max", "boundary", "rest")}
        return cls.selection(edge=np.deg2rad(settings["edge"]), **same)

    def with_modes(self, modes: Iterable[tuple[int, int]], form: Form | None = None) -> FourierBessel:
        """Return the basis of other modes on the same disc."""
        return FourierBessel(modes, form or self.form, self.edge, self.boundary, self.n_az)

    def describe(self) -> dict[str, Any]:
        """Return kind, form, boundary, edge (rad), n_az and the list of modes [k, m]."""
        settings = {name: getattr(self, name) for name in _SETTINGS}
        return {"kind": "fourier_bessel", **settings, "modes": [list(mode) for mode in self.modes]}

    @classmethod
    def from_description(cls, description: Mapping[str, Any]) -> FourierBessel:
        """Restore a basis from its description."""
        return cls(description["modes"], **{name: description[name] for name in _SETTINGS})

    def expected(self, amplitudes: FloatArray) -> FloatArray:
        """Return how large coefficients may be by those of a model beam, (n_modes,); see `expected_of_all`."""
        return expected_of_all(self.modes, amplitudes)

    @property
    def orders(self) -> IntArray:
        """Return k - 1 and abs(m) of each mode, (n_modes, 2)."""
        k, m = np.array(self.modes).T
        return np.stack([k - 1, abs(m)], axis=1)

    def largest(self, amplitudes: FloatArray, n_modes: int) -> FourierBessel:
        """Return the basis of the modes with the largest coefficients, sorted by amplitude |a_km|, (n_modes,).

        The modes +-m of a real beam, which have equal amplitude, are kept or dropped together, in either form:
        one of them alone would make the beam complex. Where only one place is left for a pair, the next mode with
        m = 0 takes it.
        """
        amplitude = dict(zip(self.modes, amplitudes.tolist(), strict=True))
        ranked = sorted(self.modes, key=lambda mode: -amplitude[mode])
        if any(amplitude[k, m] != amplitude.get((k, -m)) for k, m in ranked):
            return self.with_modes(ranked[:n_modes])
        kept: list[tuple[int, int]] = []
        for k, m in ranked:
            together = [(k, m), (k, -m)] if m else [(k, 0)]
            if m >= 0 and len(kept) + len(together) <= n_modes:
                kept += together
        return self.with_modes(kept)

    def next_modes(self, amplitudes: FloatArray, n_before: int, most: int) -> NextModes:
        """Return the modes expected to be largest of those that are lacking, from ``amplitudes``, (n_modes,).

        With the Dirichlet condition all functions are zero at the edge, so that those of constant radius, which are
        not, come first, with k = 0: it would take very many others to follow a beam that is not.
        """
        signed = [m for order in range(self._m_max + 1) for m in dict.fromkeys([order, -order])]
        at_edge = [(AT_EDGE, m) for m in signed] if self.boundary == "dirichlet" else []
        new, sizes = next_expected(self.modes, amplitudes, at_edge, n_before, most)
        n_beyond = sum(k == AT_EDGE for k, _ in new)
        return NextModes(tuple(new), sizes, lambda: self._real(new), n_beyond)

    def _real(self, modes: list[tuple[int, int]]) -> LinearBasis:
        """Return these functions, the constant ones first; only the Neumann condition has such a one."""
        constant = [(1, m) for k, m in modes if k == AT_EDGE]
        others = [(k, m) for k, m in modes if k != AT_EDGE]
        parts = [FourierBessel(constant, "real", self.edge, "neumann", self.n_az)] if constant else []
        return Joined([*parts, *([self.with_modes(others, form="real")] if others else [])])

    @property
    def n_rings(self) -> int:
        """As many as there are radial functions."""
        return max(self._ks)

    def fit_rings(self, rings: RingGrid) -> tuple[Array, int]:
        """Fit the modes of each m on its own, (..., n_modes); see :class:`LinearBasis`."""
        return fit_rings(rings, self.modes, lambda za: self.radial_functions(self.rho(za)), self.n_az, self.is_complex)

    def radial_functions(self, rho: FloatArray) -> FloatArray:
        """Return ``J0(u_k rho) / q_k`` for k = 1 .. the largest k of the modes, (k_max, Npoints)."""
        u, q = radial_zeros(max(self._ks), self.boundary)
        return np.asarray(j0(u[:, None] * rho) / q[:, None])

    def rho(self, za: FloatArray) -> FloatArray:
        """Return the radius on the disc, ``sqrt(1 - cos za) / alpha``, (Npoints,)."""
        return np.sqrt(self._rho_squared(za))

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate the real columns, (n_columns, Npoints); see :meth:`LinearBasis.columns`."""
        if out is None:
            out = np.empty((self.n_columns, len(za)))
        for start in range(0, len(za), _POINTS_AT_ONCE):
            part = slice(start, start + _POINTS_AT_ONCE)
            radial, azimuthal = self._factors(za[part], az[part], out.dtype)
            target = out[:, part]
            for column, k, m in self._products:
                np.multiply(radial[k], azimuthal[m], target[column])
        return out

    def mix(self, rows: Array) -> Array:
        """Turn columns, (..., n_columns), into functions, (..., n_modes); see :meth:`LinearBasis.mix`."""
        if self._mixing is None:
            return rows
        cos, sin, sign = self._mixing
        mixed = rows[..., sin] * sign
        mixed += rows[..., cos]
        return mixed

    def column_coeffs(self, coeffs: Array) -> Array:
        """Return the equivalent coefficients of the columns, (n_columns,); see :meth:`LinearBasis.column_coeffs`."""
        if self._mixing is None:
            return coeffs
        cos, sin, sign = self._mixing
        folded = np.zeros((self.n_columns, *coeffs.shape[:-1]), dtype=np.complex128)
        np.add.at(folded, cos, np.moveaxis(coeffs, -1, 0))
        np.add.at(folded, sin, np.moveaxis(sign * coeffs, -1, 0))
        return np.moveaxis(folded, 0, -1)

    def amplitudes(self, coeffs: Array) -> FloatArray:
        """Return |b|, in real form that of the equivalent complex mode, which cosine and sine share, (n_modes,).

        A beam that is even in azimuth has no sine terms; a width from each term alone would pin it there.
        """
        if self.is_complex:
            return np.abs(coeffs)
        power = dict(zip(self.modes, (np.abs(coeffs) ** 2).tolist(), strict=True))
        return np.sqrt([(power[k, m] + power.get((k, -m), 0.0)) / 2 for k, m in self.modes])

    def synthesize(self, coeffs: Array, za: FloatArray, az: FloatArray) -> Array:
        """Evaluate the beam ``sum_n b_n f_n``, (Npoints,): a product over k, then one over m."""
        matrix = self._by_orders(coeffs)
        parts = [matrix.real, matrix.imag] if np.iscomplexobj(matrix) and matrix.imag.any() else [matrix.real]
        values = np.zeros((len(parts), len(za)))
        for start in range(0, len(za), _POINTS_AT_ONCE):
            part = slice(start, start + _POINTS_AT_ONCE)
            radial, azimuthal = self._factors(za[part], az[part])
            for value, weight_part in zip(values, parts, strict=True):
                np.einsum("mi,mi->i", weight_part @ radial, azimuthal, out=value[part])
        if len(parts) == 2:
            return values[0] + 1j * values[1]
        return values[0].astype(matrix.dtype)

    def united(self, other: LinearBasis) -> tuple[FourierBessel, list[int]] | None:
        """Return the basis of the modes of both, if on the same disc; see :meth:`LinearBasis.united`."""
        if not isinstance(other, FourierBessel) or any(getattr(self, n) != getattr(other, n) for n in _SETTINGS):
            return None
        place = {mode: number for number, mode in enumerate(dict.fromkeys([*self.modes, *other.modes]))}
        return self.with_modes(place), [place[mode] for mode in other.modes]

    @property
    def table_nodes(self) -> tuple[int, int]:
        """What the highest orders need; see :meth:`LinearBasis.table_nodes`."""
        return n_nodes(np.sqrt(2 * self._inv_alpha_squared) * max(self._ks), self._m_max)

    def at_nodes(self, coeffs: Array, per_unit: int, n_az: int) -> FloatArray:
        """Evaluate a beam at a table's nodes, (Nradii, Naz); see :meth:`LinearBasis.at_nodes`."""
        stretch = np.sqrt(2 * self._inv_alpha_squared)
        azimuthal = azimuthal_around(self._m_max, n_az)
        azimuthal[0] *= 1.0 if self.is_complex else np.sqrt(0.5)
        radial = self._radial.scale * j0(stretch * radii(per_unit)[:, np.newaxis] * self._radial.u)
        return np.asarray(radial @ self._by_orders(coeffs).real.T @ azimuthal)

    def _by_orders(self, coeffs: Array) -> Array:
        """Return the coefficients of products of azimuthal and radial functions, (2 m_max + 2, Nk)."""
        weights = self.column_coeffs(coeffs)
        matrix = np.zeros((2 * self._m_max + 2, len(self._ks)), dtype=weights.dtype)
        matrix[self._m_row, self._k_row] = weights
        return matrix

    def _rho_squared(self, za: FloatArray) -> FloatArray:
        # 1 - cos za, without its loss of digits near the zenith.
        return (2 * self._inv_alpha_squared) * np.sin(0.5 * np.asarray(za)) ** 2

    def _factors(self, za: FloatArray, az: FloatArray, dtype: Any = np.float64) -> tuple[FloatArray, FloatArray]:
        """Return the radial rows, (Nk, Npoints), and the azimuthal rows cos 0, sin 0, cos az, sin az, ...

        In single precision they are, at the end, rounded: in between errors would grow with the orders.
        """
        n_points = len(za)
        sizes = [len(self._radial), self._radial.n_terms, 2 * self._m_max + 2]
        if self._buffer.size < sum(sizes) * n_points:
            self._buffer = np.empty(sum(sizes) * n_points)
        rows = self._buffer[: sum(sizes) * n_points].reshape(sum(sizes), n_points)
        radial, work, azimuthal = np.split(rows, np.cumsum(sizes)[:-1])
        if dtype != radial.dtype:
            radial = np.empty(radial.shape, dtype)
        self._radial.evaluate(self._rho_squared(za), radial, work)
        azimuthal_rows(np.asarray(az), azimuthal, work)
        if not self.is_complex:
            azimuthal[0] = np.sqrt(0.5)
        return radial, azimuthal.astype(dtype, copy=False)


def _check(modes: list[tuple[int, int]], form: str, edge: float, boundary: str) -> None:
    if not modes:
        raise InputError("a basis needs at least one mode", field="n_modes", remedy="ask for 1 or more")
    if len(set(modes)) < len(modes) or min(k for k, _ in modes) < 1:
        raise InputError("every mode (k, m) needs k >= 1 and may occur once", field="modes")
    for field, value, known in (("form", form, get_args(Form)), ("boundary", boundary, get_args(Boundary))):
        if value not in known:
            raise InputError(f"unknown {field} {value!r}", field=field, remedy='use "{}" or "{}"'.format(*known))
    check_edge(edge)
