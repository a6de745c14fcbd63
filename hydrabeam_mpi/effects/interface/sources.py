"""The sources at one time and how the current beam sees them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.model.engines.fringes import enu
from hydrabeam_mpi.model.rime import Beam
from hydrabeam_mpi.model.tabulated import power_of, table_of

STEP = 1e-5  # rad, of numerical derivatives of beams


@dataclass(frozen=True)
class Sources:
    """The sources above the horizon at one time, and how the current beam sees them.

    Attributes
    ----------
    index : ndarray of int, (Nsrc,)
        Which of the sky's sources.
    za, az : ndarray, (Nsrc,)
        Radians.
    flux : ndarray, (Nsrc,)
        Jy at the block's channel, as the sky model has them.
    beam_function : callable
        The current beam.
    factors : dict of str to ndarray, (Nsrc,)
        What effects of each kind multiply the fluxes with.
    freq : float
        Hz, the block's.
    itime : int
        Index into the observation's times.
    """

    index: IntArray
    za: FloatArray
    az: FloatArray
    flux: FloatArray
    beam_function: Beam
    factors: dict[str, FloatArray] = field(default_factory=dict)
    freq: float = 0.0
    itime: int = 0

    def flux_without(self, kind: str = "") -> FloatArray:
        """Return the fluxes with the factors of all effects that change the sky but those of one kind, (Nsrc,)."""
        flux = self.flux
        for other, factor in self.factors.items():
            if other != kind:
                flux = flux * factor
        return flux

    @cached_property
    def changed(self) -> tuple[IntArray, FloatArray]:
        """Numbers of the sources whose fluxes effects change, and by how much, (K,) each; Jy."""
        if not self.factors:
            return np.zeros(0, dtype=int), np.zeros(0)
        change = self.flux_without() - self.flux
        which = np.flatnonzero(change)
        return which, change[which]

    @cached_property
    def enu(self) -> FloatArray:
        """Unit vectors, (3, Nsrc)."""
        return enu(self.za, self.az)

    @cached_property
    def beam(self) -> FloatArray:
        """Real part of the power beam, (Nsrc,); from the beam's table, where it has one."""
        return self.exact_beam if self._by_table is None else self._by_table[0]

    @cached_property
    def exact_beam(self) -> FloatArray:
        """The same from the beam itself, for small differences, which show what a table lacks, (Nsrc,)."""
        return np.asarray(self.beam_function(self.za, self.az)).real

    @cached_property
    def tangents(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors tangent to the sphere, away from the zenith and around it, (3, Nsrc) each."""
        east, north, cos_za = self.enu
        sin_za = np.hypot(east, north)
        # Azimuths are known by their sine and cosine but at the zenith itself.
        given = (east / sin_za, north / sin_za) if sin_za.all() else (np.cos(self.az), np.sin(self.az))
        cos_az, sin_az = given
        down = np.stack([cos_za * cos_az, cos_za * sin_az, -sin_za])
        return down, np.stack([-sin_az, cos_az, np.zeros_like(sin_az)])

    @cached_property
    def by_tangents(self) -> tuple[FloatArray, FloatArray]:
        """Derivatives of the beam along `tangents`, (Nsrc,) each, per radian.

        From the beam's table, or where it has none by central differences.
        """
        if self._by_table is not None:
            _, by_za, by_az = self._by_table
            sin_za = np.hypot(self.enu[0], self.enu[1])
            return np.where(self.za <= np.pi / 2, by_za, 0.0), by_az / np.maximum(sin_za, STEP)
        down, around = (
            (self.beam_at(self.enu + STEP * tangent) - self.beam_at(self.enu - STEP * tangent)) / (2 * STEP)
            for tangent in self.tangents
        )
        return down, around

    @cached_property
    def _by_table(self) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """The beam and its derivatives by zenith angle and azimuth, (Nsrc,) each, to the horizon, in one go."""
        table = table_of(self.beam_function)
        return None if table is None else table.with_slopes(np.minimum(self.za, np.pi / 2), self.az)

    @property
    def slope(self) -> FloatArray:
        """Gradient of the beam on the sphere as a vector tangent to it, (3, Nsrc), per radian.

        A source displaced by a small tangent vector ``v`` has its beam changed by ``slope . v``.
        """
        (down, around), (by_down, by_around) = self.tangents, self.by_tangents
        return down * by_down + around * by_around

    @property
    def torque(self) -> FloatArray:
        """The torque s x grad B, (3, Nsrc): sources turned by a small rotation w see the beam change by w . torque."""
        (down, around), (by_down, by_around) = self.tangents, self.by_tangents
        return around * by_down - down * by_around

    def beam_at(self, vectors: FloatArray) -> FloatArray:
        """Return the real part of the power beam in other directions, (3, N) of any length; (N,)."""
        za = np.arctan2(np.hypot(vectors[0], vectors[1]), vectors[2])
        az = np.arctan2(vectors[1], vectors[0]) % (2 * np.pi)
        return power_of(self.beam_function, np.minimum(za, np.pi / 2), az)
