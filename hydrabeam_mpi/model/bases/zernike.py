"""Zernike polynomials on the hemisphere projected to the unit disc.

    Z_nm(za, az) = N R_n^|m|(rho) cos(m az)   (m >= 0),   N R_n^|m|(rho) sin(|m| az)   (m < 0)

with rho = sqrt(1 - cos za) / sqrt(1 - cos edge), N = sqrt(n + 1) for m = 0 and sqrt(2 n + 2) otherwise, so
that the mean of Z^2 over the disc is one. They are ordered by the OSA/ANSI index j = (n (n + 2) + m) / 2.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.base import LinearBasis, NextModes
from hydrabeam_mpi.model.bases.disc import EDGE, azimuthal_around, azimuthal_rows, check_edge
from hydrabeam_mpi.model.bases.expected import expected_of_all, smallest
from hydrabeam_mpi.model.bases.joined import Joined
from hydrabeam_mpi.model.bases.polar_table import n_nodes, radii


class Zernike(LinearBasis):
    """All Zernike polynomials up to a degree; real.

    Parameters
    ----------
    degree : int
        Largest n.
    edge : float
        Zenith angle of the rim of the disc, radians.

    Raises
    ------
    InputError
        If the degree is negative or the edge out of range.
    """

    title: ClassVar[str] = "Zernike"

    def __init__(self, degree: int, edge: float = EDGE) -> None:
        if degree < 0:
            raise InputError(f"degree = {degree} gives no mode", field="degree", remedy="ask for 0 or more")
        check_edge(edge)
        self.degree, self.edge = int(degree), float(edge)
        self.modes = [(n, m) for n in range(self.degree + 1) for m in range(-n, n + 1, 2)]
        self.n_modes = self.n_columns = len(self.modes)
        self.is_complex = False

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> Zernike:
        """Make the basis of a job's ``max_degree``; see :class:`LinearBasis`."""
        return cls(settings["max_degree"], np.deg2rad(settings["edge"]))

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate the polynomials, (n_modes, Npoints); see :meth:`LinearBasis.columns`."""
        if out is None:
            out = np.empty((self.n_columns, len(za)))
        rho = np.sin(0.5 * np.asarray(za)) / np.sin(0.5 * self.edge)
        azimuthal = np.empty((2 * self.degree + 2, len(rho)))
        azimuthal_rows(np.asarray(az), azimuthal, np.empty((self.degree + 1, len(rho))))
        for n, m, radial in self._radial_parts(rho):
            np.multiply(radial, azimuthal[2 * m], out[_place(n, m)])
            if m:
                np.multiply(radial, azimuthal[2 * m + 1], out[_place(n, -m)])
        return out

    def describe(self) -> dict[str, Any]:
        """Return kind, degree and edge (rad)."""
        return {"kind": "zernike", "degree": self.degree, "edge": self.edge}

    @classmethod
    def from_description(cls, description: Mapping[str, Any]) -> Zernike:
        """Restore a basis from its description."""
        return cls(description["degree"], description["edge"])

    def expected(self, amplitudes: FloatArray) -> FloatArray:
        """Return how large coefficients may be by those of a model beam, (n_modes,); see `expected_of_all`."""
        return expected_of_all([(k + 1, m) for k, m in self.orders.tolist()], amplitudes)

    @property
    def orders(self) -> IntArray:
        """Return (n - abs(m)) / 2 and abs(m) of each polynomial, (n_modes, 2)."""
        n, m = np.array(self.modes).T
        return np.stack([(n - abs(m)) // 2, abs(m)], axis=1)

    def next_modes(self, amplitudes: FloatArray, n_before: int, most: int) -> NextModes:
        """Return those of the next whole degrees, one or more, whatever the ``amplitudes``, (n_modes,)."""
        first = self.degree + 1
        while sum(n + 1 for n in range(self.degree + 1, first)) < n_before:
            first += 1
        top = first
        while sum(n + 1 for n in range(first, top + 2)) <= most:
            top += 1
        modes = tuple((n, m) for n in range(first, top + 1) for m in range(-n, n + 1, 2))
        n_modes = (top + 1) * (top + 2) // 2
        expected = np.full(len(modes), smallest(amplitudes, len(modes)))
        return NextModes(
            modes, expected, lambda: Joined([Zernike(top, self.edge)], range(n_modes - len(modes), n_modes))
        )

    @property
    def table_nodes(self) -> tuple[int, int] | None:
        """What the largest degree needs at the rim, where its zeros are closest; see :meth:`LinearBasis.table_nodes`.

        A disc that ends above the horizon has no table, as polynomials go on without bounds beyond.
        """
        if self.edge < np.pi / 2:
            return None
        return n_nodes((self.degree + 1) ** 2 / (3 * np.sin(0.5 * self.edge)), self.degree)

    @property
    def through_zenith(self) -> bool:
        """Polynomials of the place on the disc are smooth everywhere."""
        return True

    def at_nodes(self, coeffs: Array, per_unit: int, n_az: int) -> FloatArray:
        """Evaluate a beam at a table's nodes, (Nradii, Naz); see :meth:`LinearBasis.at_nodes`."""
        rho = radii(per_unit) / np.sin(0.5 * self.edge)
        by_order = np.zeros((2 * self.degree + 2, len(rho)))
        for n, m, radial in self._radial_parts(rho):
            by_order[2 * m] += coeffs[_place(n, m)].real * radial
            if m:
                by_order[2 * m + 1] += coeffs[_place(n, -m)].real * radial
        return np.asarray(by_order.T @ azimuthal_around(self.degree, n_az))

    def _radial_parts(self, rho: FloatArray) -> Iterator[tuple[int, int, FloatArray]]:
        """Yield n, m >= 0 and N R_n^m of all polynomials, (Npoints,)."""
        for m in range(self.degree + 1):
            for n, radial in zip(range(m, self.degree + 1, 2), self._radial(m, rho), strict=True):
                yield n, m, np.sqrt(n + 1 if m == 0 else 2 * n + 2) * radial

    def _radial(self, m: int, rho: FloatArray) -> list[FloatArray]:
        """Return R_n^m for n = m, m + 2, ..., degree: rho^m times Jacobi's P_j^(0,m)(2 rho^2 - 1)."""
        x = 2 * rho**2 - 1
        jacobi = [np.ones_like(rho)]
        for j in range(1, (self.degree - m) // 2 + 1):
            # The three-term recurrence of P_j^(a,b) at a = 0, b = m.
            c = 2 * j + m
            linear = (c - 1) * (c * (c - 2) * x - m * m) * jacobi[-1]
            previous = 2 * (j - 1) * (j + m - 1) * c * jacobi[-2] if j > 1 else 0.0
            jacobi.append((linear - previous) / (2 * j * (j + m) * (c - 2)) if c > 2 else 0.5 * ((2 + m) * x - m))
        return [rho**m * polynomial for polynomial in jacobi]


def _place(n: int, m: int) -> int:
    """Return the OSA/ANSI index."""
    return (n * (n + 2) + m) // 2
