"""Beams that come with the package, as tables of Fourier-Bessel coefficients."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import h5py
import numpy as np

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.beam import BeamInfo, CoefficientBeam
from hydrabeam_mpi.model.fit import FittedBeam

EMBEDDED = "hera_vivaldi_131MHz.h5"


@dataclass(frozen=True)
class EmbeddedBeam(CoefficientBeam):
    """A beam that comes with the package.

    Attributes
    ----------
    origin : str
        File that was fitted, who made it, and which of its polarisations.
    sha256 : str
        Checksum of that file.
    rms_residual, max_residual : float
        Of |samples - table| over the file's own samples above the horizon, in units of the peak.
    """

    origin: str
    sha256: str
    rms_residual: float
    max_residual: float


def embedded_beam() -> EmbeddedBeam:
    """Return the East-West power beam of HERA's Phase II Vivaldi feed on its dish at 131 MHz.

    The table was made by ``tools/fit_vivaldi_table`` from an electromagnetic simulation by N. Fagnoni, and
    has all modes k = 1..80, |m| <= 45, so that it serves for perturbed beams too. It holds that file's
    polarisation "xx", whose feed lies along East-West, although the header says North.
    """
    with as_file(files(__name__) / EMBEDDED) as path:
        return read_table(path)


def write_table(path: Path, fit: FittedBeam, info: BeamInfo, origin: str, sha256: str) -> None:
    """Write a real beam's complex coefficients of all modes (k, m >= 0), with where they are from.

    Datasets: ``coeffs`` (m_max + 1, k_max), complex. Attributes: edge (rad), boundary, n_az, name, freq (Hz),
    pol, peak, origin, sha256, rms_residual, max_residual.
    """
    basis = fit.basis
    assert isinstance(basis, FourierBessel)
    assert basis.is_complex
    k_max = max(k for k, _ in basis.modes)
    m_max = max(m for _, m in basis.modes)
    table = np.zeros((m_max + 1, k_max), dtype=np.complex128)
    for (k, m), value in zip(basis.modes, fit.coeffs, strict=True):
        if m >= 0:
            table[m, k - 1] = value
    with h5py.File(path, "w") as file:
        file["coeffs"] = table
        file.attrs.update(edge=basis.edge, boundary=basis.boundary, n_az=basis.n_az)
        file.attrs.update(name=info.name, freq=info.freq, pol=info.pol, peak=info.peak)
        file.attrs.update(origin=origin, sha256=sha256)
        file.attrs.update(rms_residual=fit.rms_residual, max_residual=fit.max_residual)


def read_table(path: Path) -> EmbeddedBeam:
    """Read what :func:`write_table` wrote."""
    with h5py.File(path) as file:
        table: Array = file["coeffs"][:]
        about = dict(file.attrs)
    m_max, k_max = table.shape[0] - 1, table.shape[1]
    settings = {"edge": about["edge"], "boundary": about["boundary"], "n_az": about["n_az"]}
    basis = FourierBessel.full(k_max, m_max, form="complex", **settings)
    coeffs = np.array([table[m, k - 1] if m >= 0 else table[-m, k - 1].conj() for k, m in basis.modes])
    info = BeamInfo(about["name"], float(about["freq"]), about["pol"], float(about["peak"]))
    residuals = float(about["rms_residual"]), float(about["max_residual"])
    return EmbeddedBeam(basis, coeffs, info, about["origin"], about["sha256"], *residuals)
