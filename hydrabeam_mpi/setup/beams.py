"""The model beam of a job, its fit in the job's basis, and the prior that follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from pyuvdata import BeamInterface, UVBeam

from hydrabeam_mpi.config import ANALYTIC_BEAMS, BUILT_IN_BEAMS, EMBEDDED_BEAM, Job, Perturbation
from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference.mode_widths import ModeSizes, PriorWidths
from hydrabeam_mpi.inference.prior import DiagonalPrior, FlatPrior, Prior
from hydrabeam_mpi.io.beamfits import SAME_FREQ, BeamFile
from hydrabeam_mpi.io.prior_file import read_prior
from hydrabeam_mpi.io.reading import check_file
from hydrabeam_mpi.model.bases import basis_from_settings
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.beam import Beam, BeamInfo, CoefficientBeam, analytic_beam, of_formula
from hydrabeam_mpi.model.fit import FittedBeam, fit_beam
from hydrabeam_mpi.model.perturb import PerturbedBeam
from hydrabeam_mpi.model.shape import shape_of
from hydrabeam_mpi.tables import embedded_beam


@dataclass(frozen=True)
class ScaledBeam:
    """A beam of one frequency taken for another: its pattern shrinks as the wavelength.

    ``B(za, nu) = B_0(za nu / nu_0)``, which holds for the main lobe and the first sidelobes of a dish. Where that
    asks for directions beyond ``za_max`` (radians), the base's value there is taken.
    """

    base: Beam
    freq: float
    za_max: float = np.pi / 2

    @property
    def info(self) -> BeamInfo:
        """The base's, at the frequency that it stands for."""
        name = f"{self.base.info.name} scaled from {self.base.info.freq / 1e6:g} MHz"
        return replace(self.base.info, name=name, freq=self.freq)

    def __call__(self, za: FloatArray, az: FloatArray) -> Array:
        """Evaluate the base at the scaled zenith angle, (Npoints,)."""
        return self.base(np.minimum(za * (self.freq / self.base.info.freq), self.za_max), az)


@dataclass(frozen=True)
class TurnedBeam:
    """The beam of an element's other feed ``pol``, where both are alike and at right angles.

    Azimuth counts from East through North: the feed that points North has B(za, az - 90 deg) where B is that of the
    one that points East, and the other way round. Feeds x point East.
    """

    base: Beam
    pol: str

    @property
    def info(self) -> BeamInfo:
        """The base's, of the other feed."""
        return replace(self.base.info, name=f"{self.base.info.name} turned", pol=self.pol)

    def __call__(self, za: FloatArray, az: FloatArray) -> Array:
        """Evaluate the base a quarter turn away, (Npoints,)."""
        quarter = np.pi / 2 if self.pol[0] in "ex" else -np.pi / 2
        return self.base(za, (az + quarter) % (2 * np.pi))


def other_feed(pol: str) -> str:
    """Return the polarisation of which both feeds are the other one: "nn" for "ee", "xx" for "yy"."""
    return pol.translate(str.maketrans("enxy", "neyx"))


def load_beams(job: Job, freqs: FloatArray, pol: str, given: Any = None) -> tuple[Beam, ...]:
    """Return the model beam of each channel.

    Parameters
    ----------
    job : Job
    freqs : ndarray, (Nfreqs,)
        Hz.
    pol : str
    given : pyuvdata.UVBeam, pyuvdata.BeamInterface or pyuvdata analytic beam, optional
        Instead of the source that the job names.

    Raises
    ------
    InputError
        If the source has no beam at a frequency or in this polarisation.
    """
    settings = job.beam
    if given is not None:
        return _given_beams(job, freqs, pol, given)
    if settings.source in ANALYTIC_BEAMS:
        return tuple(analytic_beam(settings.source, float(freq), pol, diameter=settings.diameter) for freq in freqs)
    if settings.source == EMBEDDED_BEAM:
        return tuple(_embedded(float(freq), pol, settings.frequency == "scale") for freq in freqs)
    known = ", ".join(BUILT_IN_BEAMS)
    check_file(Path(settings.source), field="[beam] source", remedy=f"check the path, or use {known}")
    return _beams_of(BeamFile(Path(settings.source), east_feed=settings.east_feed), job, freqs, pol)


def _given_beams(job: Job, freqs: FloatArray, pol: str, given: Any) -> tuple[Beam, ...]:
    """Return the beam of each channel of an object of pyuvdata."""
    given = given.beam if isinstance(given, BeamInterface) else given
    if isinstance(given, UVBeam):
        return _beams_of(BeamFile.of(given, "beam", east_feed=job.beam.east_feed), job, freqs, pol)
    return tuple(of_formula(given, type(given).__name__, float(freq), pol) for freq in freqs)


def _beams_of(file: BeamFile, job: Job, freqs: FloatArray, pol: str) -> tuple[Beam, ...]:
    """Return the beam of each channel, where it is not among the file's by the rule that the job has for that."""
    settings = job.beam
    if settings.frequency != "scale":
        interpolate = settings.frequency == "interpolate"
        return tuple(file.beam(float(freq), pol, interpolate_frequency=interpolate) for freq in freqs)
    nearest = [float(file.freqs[np.argmin(np.abs(file.freqs - freq))]) for freq in freqs]
    return tuple(
        _scaled(file.beam(own, pol), float(freq), file.za_max) for own, freq in zip(nearest, freqs, strict=True)
    )


def _embedded(freq: float, pol: str, scale: bool) -> Beam:
    """Return the built-in beam for one channel."""
    beam = embedded_beam()
    if pol not in ("ee", "xx"):
        raise InputError(
            f"the built-in beam has no '{pol}'", field="[beam] source", remedy="give a beam file, or choose 'ee'"
        )
    if not scale and abs(beam.info.freq - freq) > SAME_FREQ * freq:
        raise InputError(
            f"the built-in beam is at {beam.info.freq / 1e6:g} MHz, not {freq / 1e6:g} MHz",
            field="[beam] source",
            remedy="give a beam file, choose that channel, or set frequency = 'scale'",
        )
    return _scaled(beam, freq)


def _scaled(beam: Beam, freq: float, za_max: float = np.pi / 2) -> Beam:
    """Scale a beam to a frequency that is not its own."""
    return beam if abs(beam.info.freq - freq) <= SAME_FREQ * freq else ScaledBeam(beam, freq, za_max)


def perturb(job: Job, beam: Beam, settings: Perturbation) -> Beam:
    """Return the beam to simulate with (HDBI II, eq. 16)."""
    return PerturbedBeam(beam, job.seed, settings.stretch, settings.sidelobe)


def fit_model_beams(
    job: Job, beams: Sequence[Beam], known: LinearBasis | None = None
) -> tuple[LinearBasis, list[FittedBeam]]:
    """Fit the model beam of every channel in a basis that is ``known``, or in one that is chosen at the middle one."""
    if known is not None:
        return known, [fit_beam(beam, known) for beam in beams]
    middle, basis = len(beams) // 2, basis_from_settings(job.basis.model_dump())
    chosen = fit_beam(beams[middle], basis)
    fits = [chosen if f == middle else fit_beam(beam, chosen.basis) for f, beam in enumerate(beams)]
    return chosen.basis, fits


def make_prior(job: Job, fit: FittedBeam) -> Prior:
    """Return the prior on the coefficients of one channel, centred on the fit unless a file says otherwise.

    Raises
    ------
    InputError
        If the prior's file is none, or does not fit the basis.
    """
    settings = job.prior
    if settings.kind == "flat":
        return FlatPrior(fit.coeffs)
    if settings.kind == "file":
        assert settings.file is not None
        return read_prior(settings.file, fit.basis)
    amplitudes, orders = fit.basis.amplitudes(fit.coeffs), fit.basis.orders
    largest = float(amplitudes.max())
    if not settings.floor:
        amplitudes = fit.basis.expected(amplitudes)
    # Every mode needs a width, if only one above rounding.
    floor = max(settings.floor, 1e-12) * amplitudes.max()
    sizes = ModeSizes(np.maximum(amplitudes, floor), orders, largest)
    return DiagonalPrior.of(fit.coeffs, sizes, stated_widths(job))


def shaped(priors: Sequence[Prior], beams: Sequence[Beam], basis: LinearBasis) -> tuple[Prior, ...]:
    """Return priors of independent coefficients with what beams differ by as a whole beside; see `model.shape`.

    Models are taken as they were fitted: samples of a file may end before the horizon.
    """
    models = [CoefficientBeam(basis, prior.mean, beam.info) for prior, beam in zip(priors, beams, strict=True)]
    pairs = zip(priors, models, strict=True)
    return tuple(replace(cast(DiagonalPrior, prior), shape=shape_of(model, basis)) for prior, model in pairs)


def stated_widths(job: Job) -> PriorWidths:
    """Return the widths of the beam's prior that a job states."""
    settings = job.prior
    smooth = settings.smooth
    return PriorWidths(settings.fraction, smooth.amplitude, smooth.decay, settings.neighbours, settings.azimuthal)


def given_priors(priors: Sequence[Prior], fits: Sequence[FittedBeam]) -> tuple[Prior, ...]:
    """Return the prior of each channel, where one for all or one for each is given.

    Raises
    ------
    InputError
        If they are neither, or are of coefficients of another basis.
    """
    if len(priors) not in (1, len(fits)):
        message = f"{len(priors)} priors, and {len(fits)} channels"
        raise InputError(message, file="prior", remedy="give one for all, or one for each")
    n_modes = fits[0].basis.n_modes
    for prior in priors:
        if np.shape(prior.mean) != (n_modes,):
            message = f"a mean of the shape {np.shape(prior.mean)}, and the basis has {n_modes} modes"
            raise InputError(message, file="prior", remedy="give one of the coefficients of this basis")
    return tuple(priors) if len(priors) == len(fits) else tuple(priors) * len(fits)
