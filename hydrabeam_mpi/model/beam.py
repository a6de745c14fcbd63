"""Power beams: what they are called, and the ones that follow from a formula or from coefficients.

A beam is a callable ``beam(za, az)`` with a ``BeamInfo``. A co-polarised beam ("ee", "nn", "xx", "yy") is
real, a cross-polarised one complex. Angles are radians, azimuth from East through North.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from pyuvdata import AiryBeam, GaussianBeam, ShortDipoleBeam, UniformBeam
from pyuvdata.utils import polnum2str, polstr2num

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.bases.healpix_map import HealpixMap
from hydrabeam_mpi.model.bases.polar_table import PolarTable
from hydrabeam_mpi.model.bases.rings import Pixels
from hydrabeam_mpi.model.interpolate import AzZaGrid


@dataclass(frozen=True)
class BeamInfo:
    """What a beam is.

    Attributes
    ----------
    name : str
        File or formula.
    freq : float
        Hz.
    pol : str
        Polarisation, such as "ee".
    peak : float
        By what the source's own values were divided.
    """

    name: str
    freq: float
    pol: str
    peak: float = 1.0

    @property
    def is_copol(self) -> bool:
        """Whether both feeds are the same, so that the power beam is real."""
        return self.pol[0] == self.pol[1]


class Beam(Protocol):
    """A power beam."""

    @property
    def info(self) -> BeamInfo:
        """What it is."""
        ...

    def __call__(self, za: FloatArray, az: FloatArray) -> Array:
        """Return the values at (za, az), each (Npoints,)."""
        ...


@dataclass(frozen=True)
class CoefficientBeam:
    """A beam given by coefficients in a basis.

    Attributes
    ----------
    basis : LinearBasis
    coeffs : ndarray, (n_modes,)
    info : BeamInfo
    """

    basis: LinearBasis
    coeffs: Array
    info: BeamInfo

    def __call__(self, za: FloatArray, az: FloatArray) -> Array:
        """Return the sum of the basis functions: its real part for a co-polarised beam, (Npoints,)."""
        values = self.basis.synthesize(self.coeffs, za, az)
        return np.ascontiguousarray(values.real) if self.info.is_copol else values

    @cached_property
    def table(self) -> PolarTable | None:
        """The real part between the nodes of a table, made once; None where the basis offers none."""
        return self.basis.table(self.coeffs)

    @cached_property
    def imaginary(self) -> CoefficientBeam | None:
        """The beam whose real part is the imaginary part of this one; None where the coefficients are real."""
        if not np.iscomplexobj(self.coeffs):
            return None
        return replace(
            self, coeffs=-1j * self.coeffs, info=replace(self.info, name=f"{self.info.name}, imaginary part")
        )


@dataclass(frozen=True)
class SampledBeam:
    """A beam given by samples: interpolated by cubic splines on an az_za grid, bilinearly on HEALPix.

    Attributes
    ----------
    interpolate : AzZaGrid or HealpixMap
        Interpolates the samples.
    pixels : Pixels
        The samples above the horizon.
    info : BeamInfo
    """

    interpolate: AzZaGrid | HealpixMap
    pixels: Pixels
    info: BeamInfo

    def __call__(self, za: FloatArray, az: FloatArray) -> Array:
        """Interpolate the samples, (Npoints,).

        Raises
        ------
        InputError
            If samples that are needed are NaN or missing.
        """
        try:
            return self.interpolate(np.asarray(za, dtype=float), np.asarray(az, dtype=float))
        except InputError as error:
            raise InputError(error.message, file=self.info.name, remedy=error.remedy) from error


@dataclass(frozen=True)
class AnalyticBeam:
    """A beam given by one of pyuvdata's formulae, divided by its value at the zenith.

    Attributes
    ----------
    formula : pyuvdata analytic beam
    info : BeamInfo
    """

    formula: Any
    info: BeamInfo

    def __call__(self, za: FloatArray, az: FloatArray) -> Array:
        """Evaluate the formula, (Npoints,)."""
        values = self._power(np.asarray(za, dtype=float), np.asarray(az, dtype=float)) / self.info.peak
        return values.real if self.info.is_copol else values

    def _power(self, za: FloatArray, az: FloatArray) -> Array:
        orientation = self.formula.get_x_orientation_from_feeds()
        number = polstr2num(self.info.pol, x_orientation=orientation)
        index = list(self.formula.polarization_array).index(number)
        at = {"az_array": az, "za_array": za, "freq_array": np.array([self.info.freq])}
        if not hasattr(self.formula, "_efield_eval"):
            return np.asarray(self.formula.power_eval(**at)[0, index, 0])
        # Not by power_eval, which in pyuvdata 3.2 takes a short dipole's first feed for East wherever it points.
        field = self.formula.efield_eval(**at)[:, :, 0]
        one, two = _FEEDS[index]
        return np.asarray(np.sum(field[:, one] * field[:, two].conj(), axis=0))


_FEEDS = ((0, 0), (1, 1), (0, 1), (1, 0))
"""Of each polarisation of pyuvdata's analytic beams, in their order."""
_FORMULAE = {
    "airy": AiryBeam,
    "gaussian": GaussianBeam,
    "short_dipole": ShortDipoleBeam,
    "uniform": UniformBeam,
}


def analytic_beam(formula: str, freq: float, pol: str = "ee", **parameters: Any) -> AnalyticBeam:
    """Return an analytic beam with feeds x = East, y = North.

    Parameters
    ----------
    formula : {"airy", "gaussian", "short_dipole", "uniform"}
    freq : float
        Hz.
    pol : str
        Polarisation.
    **parameters
        Of pyuvdata's class, such as ``diameter`` (m) or ``sigma`` (rad).

    Raises
    ------
    InputError
        If the formula or a parameter is unknown, or the formula gives no beam at this frequency.
    """
    if formula not in _FORMULAE:
        raise InputError(f"unknown formula {formula!r}", field="beam", remedy=f"known: {', '.join(_FORMULAE)}")
    try:
        made = _FORMULAE[formula](x_orientation="east", **parameters)
    except (TypeError, ValueError) as error:
        raise InputError(f"{formula} beam: {error}", field="beam") from error
    beam = of_formula(made, formula, freq, pol)
    if not np.isfinite(beam.info.peak):
        settings = ", ".join(f"{name} = {value:g}" for name, value in parameters.items())
        message = f"a {formula} beam with {settings} does not exist at {freq / 1e6:g} MHz"
        raise InputError(message, field="[beam] diameter", remedy="give one of a wavelength or more")
    return beam


def of_formula(made: Any, name: str, freq: float, pol: str) -> AnalyticBeam:
    """Return one of pyuvdata's analytic beams at a frequency (Hz) and polarisation, one at the zenith.

    Raises
    ------
    InputError
        If it has no such polarisation.
    """
    unscaled = AnalyticBeam(made, BeamInfo(name, float(freq), pol))
    try:
        zenith = abs(unscaled(np.zeros(1), np.zeros(1))[0])
    except (KeyError, ValueError) as error:
        has = ", ".join(polnum2str(made.polarization_array, x_orientation=made.get_x_orientation_from_feeds()))
        raise InputError(f"no polarisation '{pol}'", field="beam", remedy=f"it has {has}") from error
    if zenith < 1e-12:
        zenith = 1.0
    return AnalyticBeam(made, BeamInfo(name, float(freq), pol, peak=float(zenith)))
