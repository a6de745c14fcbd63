"""Beam files through pyuvdata: any UVBeam is read, as one power beam a frequency and polarisation.

Normalisation: a co-polarised power beam is divided by the largest of its own samples with za <= 90 degrees
(where no sample is at the zenith, the beam between them may exceed one by a little), a cross-polarised one by
the geometric mean of the two co-polarised peaks. An E-field is turned into power on its own pixels.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Self

import numpy as np
from astropy.io import fits
from pyuvdata import UVBeam
from pyuvdata.utils import polnum2str, polstr2num

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.beamsamples import check_peak, check_values, pixel_directions, read_uvbeam, usable_uvbeam
from hydrabeam_mpi.io.feeds import UNKNOWN, orientation_from_field, pol_number, x_orientation
from hydrabeam_mpi.io.reading import reading
from hydrabeam_mpi.model.bases.healpix_map import HealpixMap
from hydrabeam_mpi.model.bases.rings import SAME_ANGLE, Pixels
from hydrabeam_mpi.model.beam import BeamInfo, SampledBeam
from hydrabeam_mpi.model.interpolate import AzZaGrid
from hydrabeam_mpi.words import in_ascii

SAME_FREQ = 5e-4
"""Relative distance within which a beam's frequency is the one asked for."""
# Channels around the frequency asked for that take part in interpolation.
_FREQS_TO_INTERPOLATE = 8


class BeamFile:
    """A beam file, read once, from which beams are taken.

    Parameters
    ----------
    path : Path
        beamfits, the settings yaml of CST files, FEKO or anything else that pyuvdata recognises.
    east_feed : {"x", "y"}, optional
        Feed that points East, instead of what the header says.

    Raises
    ------
    InputError
        If there is no such file, or pyuvdata cannot read it as a beam on an az_za or HEALPix grid of the whole sky
        above the horizon.

    Warns
    -----
    UserWarning
        If the E-field contradicts the header on where the feeds point, HEALPix pixels contradict their nside, or
        a co-polarised power beam is negative, as an inferred one may be in places.
    """

    def __init__(self, path: Path, *, east_feed: str | None = None) -> None:
        self.path = Path(path)
        self._take(read_uvbeam(self.path), east_feed)

    @classmethod
    def of(cls, uvbeam: UVBeam, name: str, *, east_feed: str | None = None) -> Self:
        """Take a UVBeam in memory, which stays as it is; ``name`` is what messages call it."""
        file = cls.__new__(cls)
        file.path = Path(name)
        with reading(file.path, "a beam"):
            usable = usable_uvbeam(uvbeam.copy())
        file._take(usable, east_feed)
        return file

    def _take(self, uvbeam: UVBeam, east_feed: str | None) -> None:
        """Look at the samples and at what is said of the feeds."""
        self._uvbeam = uvbeam
        self._za, self._az = pixel_directions(self._uvbeam, self.path)
        self._above = self._za <= np.pi / 2 + SAME_ANGLE
        with reading(self.path, "a beam"):
            self._orientation = x_orientation(self._uvbeam, east_feed)
        if self._uvbeam.beam_type == "efield":
            self._check_orientation()
        else:
            self._check_sign()

    @property
    def freqs(self) -> FloatArray:
        """Frequencies of the file, Hz, (Nfreqs,)."""
        return np.array(self._uvbeam.freq_array)

    @property
    def za_max(self) -> float:
        """Largest zenith angle of the file's samples, radians."""
        return float(self._za.max())

    def beam(self, freq: float, pol: str, *, interpolate_frequency: bool = False) -> SampledBeam:
        """Take one power beam.

        Parameters
        ----------
        freq : float
            Hz; must be a channel of the file to 0.05% unless interpolation is asked for.
        pol : str
            "ee", "nn", "en", "ne" by direction, or "xx", "yy", "xy", "yx" as labelled in the file.
        interpolate_frequency : bool
            Interpolate power between the file's channels: cubic splines, linear below four channels.

        Raises
        ------
        InputError
            If the file lacks the frequency or the polarisation, or samples above the horizon are no numbers.
        """
        power = self._power_at(float(freq), interpolate_frequency)
        known = [int(number) for number in power.polarization_array]
        number = pol_number(pol, self._orientation, file=str(self.path), known=known)
        peak = self._peak(power, number, known)
        values = power.data_array[0, known.index(number), 0] / peak
        check_values(values.ravel()[self._above], f'"{pol}"', self.path)
        if number in _COPOLS:
            values = values.real
        info = BeamInfo(self.path.name, float(freq), pol, peak)
        return SampledBeam(self._interpolator(values), Pixels.above_horizon(self._za, self._az, values.ravel()), info)

    def _interpolator(self, values: Array) -> AzZaGrid | HealpixMap:
        if self._uvbeam.pixel_coordinate_system == "healpix":
            return HealpixMap(self._uvbeam.nside, self._uvbeam.ordering, self._uvbeam.pixel_array, values)
        return AzZaGrid(self._uvbeam.axis2_array, self._uvbeam.axis1_array, values)

    def _power_at(self, freq: float, interpolate: bool) -> UVBeam:
        """Return the power beam of all polarisations at one frequency."""
        freqs = self.freqs
        nearest = int(np.argmin(np.abs(freqs - freq)))
        exact = abs(freqs[nearest] - freq) <= SAME_FREQ * freq
        if not exact and not (freqs.min() <= freq <= freqs.max()):
            span = f"{freqs.min() / 1e6:.6g}-{freqs.max() / 1e6:.6g} MHz"
            message = f"the beam covers {span}, not {freq / 1e6:.6g} MHz"
            raise InputError(message, file=self.path, field="freq", remedy="choose channels within it or another beam")
        if not exact and not interpolate:
            message = f"no channel at {freq / 1e6:.6g} MHz, the nearest is {freqs[nearest] / 1e6:.6g} MHz"
            raise InputError(message, file=self.path, field="freq", remedy="set frequency = 'interpolate' in [beam]")
        count = 1 if exact else _FREQS_TO_INTERPOLATE
        channels = np.sort(np.argsort(np.abs(freqs - freq), kind="stable")[:count])
        with reading(self.path, "a beam"):
            chosen: UVBeam = self._uvbeam.select(freq_chans=channels, inplace=False)
            if chosen.beam_type == "efield":
                chosen.efield_to_power()
            if not exact:
                kind = "cubic" if len(channels) >= 4 else "linear"
                chosen = chosen.interp(freq_array=np.array([freq]), freq_interp_kind=kind, new_object=True)
        return chosen

    def _peak(self, power: UVBeam, number: int, known: list[int]) -> float:
        if number in _COPOLS:
            return self._copol_peak(power, known.index(number))
        p, q = polnum2str(number).lower()
        copols = [int(polstr2num(feed + feed)) for feed in (p, q)]
        if not set(copols) <= set(known):
            message = f"the peak of {p}{q} needs {p}{p} and {q}{q}, which the file lacks"
            raise InputError(message, file=self.path, field="pol", remedy="give a beam with both")
        return float(np.sqrt(np.prod([self._copol_peak(power, known.index(copol)) for copol in copols])))

    def _copol_peak(self, power: UVBeam, index: int) -> float:
        values = power.data_array[0, index, 0].ravel().real[self._above]
        what = f'"{polnum2str(int(power.polarization_array[index]))}"'
        check_values(values, what, self.path)
        check_peak(values, what, self.path)
        return float(values.max())

    def _check_sign(self) -> None:
        copols = np.isin(self._uvbeam.polarization_array, _COPOLS)
        values = self._uvbeam.data_array[0, copols].real
        values = values.reshape(*values.shape[:2], self._above.size)[..., self._above]
        negative = np.count_nonzero(values < 0)
        if negative:
            warnings.warn(
                f"{self.path}: {negative} of {values.size} samples above the horizon are negative, down to "
                f"{np.nanmin(values) / np.nanmax(values):.2g} of the largest; no element receives negative power",
                stacklevel=4,
            )

    def _check_orientation(self) -> None:
        with reading(self.path, "a beam"):
            found = orientation_from_field(self._uvbeam, self._za, self._az)
        if found is not None and self._orientation is not None and found != self._orientation:
            east = "x" if found == "east" else "y"
            warnings.warn(
                f"{self.path}: feed x is taken to point {self._orientation.title()}, but its field near the "
                f'zenith points {found.title()}; if the field is right, set east_feed = "{east}"',
                stacklevel=4,
            )


# xx, yy, rr, ll
_COPOLS = (-5, -6, -1, -2)
# Axes of real power in a beamfits file: vector component, spectral window, polarisation, frequency, za, az.
_REAL_POWER_NDIM = 6


def write_power_beam(
    path: Path,
    values: Array,
    freqs: FloatArray,
    pols: list[str],
    *,
    telescope_name: str,
    history: str = "",
    x_points: str = "east",
) -> float:
    """Write power beams on an azimuth x zenith angle grid as a beamfits file.

    Values are written as they are ("physical" normalisation, bandpass one), as visibilities do constrain the
    amplitude; of a co-polarised beam the real part, the largest imaginary one going to the header (IMAGMAX).
    A file holds evenly spaced channels only. Others go into one each, ``NAME.<freq>MHz.SUFFIX``, as do three of the
    four polarisations without one that stands between them, ``NAME.<pol>.SUFFIX``.

    Parameters
    ----------
    path : Path
    values : ndarray, (Npols, Nfreqs, Nza, Naz)
        On za = 0..90 degrees, both ends included, and az = 0..360 degrees, the end excluded.
    freqs : ndarray, (Nfreqs,)
        Hz.
    pols : list of str
        "ee", "nn", ..., which are labelled with x for the feed that points East, or "xx", "yy", ..., of which the
        history says that nobody knows where they point.
    telescope_name, history : str
        For the header, which has ASCII only: see `in_ascii`.
    x_points : {"east", "north"}
        Where feed x points.

    Returns
    -------
    float
        Largest absolute imaginary part of the co-polarised values.
    """
    about = {"telescope_name": telescope_name, "history": history, "x_points": x_points}
    uvbeam = power_uvbeam(values, freqs, pols, **about)
    parts: dict[str, tuple[Array, FloatArray, list[str]]] = {}
    if _uneven(freqs):
        parts = {f"{freq / 1e6:.6f}MHz": (values[:, [f]], freqs[[f]], pols) for f, freq in enumerate(freqs)}
    elif _uneven(uvbeam.polarization_array):
        parts = {pol: (values[[p]], freqs, [pol]) for p, pol in enumerate(pols)}
    if parts:
        names = [path.with_name(f"{path.stem}.{part}{path.suffix}") for part in parts]
        pairs = zip(names, parts.values(), strict=True)
        return max(write_power_beam(name, some, own, of, **about) for name, (some, own, of) in pairs)
    imag_max = float(uvbeam.extra_keywords["IMAGMAX"])
    uvbeam.write_beamfits(str(path), clobber=True)
    _put_polarisations_in_place(path)
    return imag_max


def power_uvbeam(
    values: Array,
    freqs: FloatArray,
    pols: list[str],
    *,
    telescope_name: str,
    history: str = "",
    x_points: str = "east",
) -> UVBeam:
    """Return power beams on a grid, (Npols, Nfreqs, Nza, Naz), as a UVBeam; see :func:`write_power_beam`.

    Polarisations whose numbers are not evenly spaced are put in the order xx, yy, xy, yx.
    """
    numbers = np.array([int(polstr2num(pol, x_orientation=x_points)) for pol in pols])
    if _uneven(numbers):
        order = np.argsort(-numbers)
        numbers, values = numbers[order], values[order]
    if x_points == "east" and not set("".join(pols)) <= {"e", "n"}:
        history += f" {UNKNOWN}"
    copol = np.isin(numbers, _COPOLS)
    imag_max = float(np.abs(np.imag(values[copol])).max(initial=0.0))
    data = np.array(values, dtype=np.complex128)
    data[copol] = data[copol].real
    n_za, n_az = data.shape[2:]
    uvbeam = UVBeam.new(
        telescope_name=in_ascii(telescope_name),
        data_normalization="physical",
        freq_array=np.asarray(freqs, dtype=float),
        feed_name="inferred",
        model_name="hydrabeam_mpi",
        feed_array=np.array(["x", "y"]),
        feed_angle=np.array([np.pi / 2, 0.0] if x_points == "east" else [0.0, np.pi / 2]),
        mount_type="fixed",
        polarization_array=numbers,
        axis1_array=np.arange(n_az) * (2 * np.pi / n_az),
        axis2_array=np.linspace(0, np.pi / 2, n_za),
        data_array=(data.real if copol.all() else data)[None],
        history=in_ascii(history),
    )
    uvbeam.extra_keywords = {"IMAGMAX": imag_max}
    return uvbeam


def _uneven(values: Array) -> bool:
    return len(values) > 2 and bool(np.ptp(np.diff(values)) > 1e-3)


def _put_polarisations_in_place(path: Path) -> None:
    """Move real polarisations off the axis of spectral windows, where pyuvdata 3.2 writes but cannot read them."""
    with fits.open(path, mode="update") as file:
        if file[0].data.ndim == _REAL_POWER_NDIM and file[0].data.shape[1] > 1:
            file[0].data = file[0].data.swapaxes(1, 2)
