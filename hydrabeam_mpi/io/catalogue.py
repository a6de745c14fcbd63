"""Sky catalogues, read by pyradiosky and evaluated at the observed frequencies.

Only Stokes I is used. A HEALPix map becomes one point source a pixel, whose flux is that of the whole pixel.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np
from astropy import units
from astropy.units import Quantity
from scipy.interpolate import interp1d

from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.reading import DAMAGED, check_file, reading
from hydrabeam_mpi.model.sky import Sky, power_law

if TYPE_CHECKING:
    from pyradiosky import SkyModel

logger = logging.getLogger(__name__)

TURNS = 2
"""Turns of a longitude: one either way may come from sums of angles that are longitudes themselves."""
FILE_TYPES = {
    ".skyh5": "skyh5",
    ".h5": "skyh5",
    ".vot": "vot",
    ".votable": "vot",
    ".xml": "vot",
    ".txt": "text",
    ".tsv": "text",
    ".sav": "fhd",
}
FREQ_TOLERANCE_HZ = 1e3


@dataclass(frozen=True)
class VOTableColumns:
    """Which columns of a VOTable hold what; any unambiguous part of a name will do.

    The defaults are those of the power-law fits in the GLEAM extragalactic catalogue.

    Attributes
    ----------
    table, name, lon, lat : str
        The table, and its columns of source names and of coordinates in ``frame``.
    frame : str
        An astropy frame, such as "icrs", "fk5" or "galactic".
    flux : tuple of str
        One flux column, or one for each of ``freqs``.
    freqs : tuple of float
        Centres of the subbands in Hz.
    reference_freq : float, optional
        Hz, where there is one flux column.
    spectral_index : str, optional
        Without it, a single flux column holds at all frequencies.
    """

    table: str = "GLEAM"
    name: str = "GLEAM"
    lon: str = "RAJ2000"
    lat: str = "DEJ2000"
    frame: str = "fk5"
    flux: tuple[str, ...] = ("Fintfit200",)
    freqs: tuple[float, ...] = ()
    reference_freq: float | None = 200e6
    spectral_index: str | None = "alpha"


def read_catalogue(
    path: Path,
    freqs: FloatArray,
    *,
    reference_freq: float | None = None,
    or_nearest: bool = False,
    flux_min: float = 0.0,
    channel_width: FloatArray | float = 0.0,
    columns: VOTableColumns | None = None,
    of_date: bool = False,
) -> Sky:
    """Read a catalogue: skyh5, VOTable, tab-separated text, or an FHD save file with its extended sources.

    Parameters
    ----------
    path : Path
        The ending tells the format (`FILE_TYPES`).
    freqs : ndarray, (Nfreqs,)
        Hz.
    reference_freq : float, optional
        Hz; gives the sky the reference fluxes that brightness cuts compare.
    or_nearest : bool
        Whether that may be the nearest frequency at which there are fluxes.
    flux_min : float
        Jy; fainter sources are left out (`Sky.brighter_than`).
    channel_width : ndarray, (Nfreqs,), or float
        Hz, within which the fluxes of a catalogue of a single frequency are taken.
    columns : VOTableColumns, optional
        For a VOTable; without it, the 20 subbands of GLEAM are read.
    of_date : bool
        Take places of date (TETE), such as a simulated sky's, as they are.

    Returns
    -------
    Sky
        ICRS, unless its places are ``of_date``. Sources without a positive flux at all ``freqs`` are left out, and
        their number is logged.

    Raises
    ------
    InputError
        If the file is missing or unreadable, lacks a flux at these frequencies, or no source is left.
    """
    model = read_model(path, columns)
    return sky_of(
        model,
        path,
        freqs,
        reference_freq=reference_freq,
        or_nearest=or_nearest,
        flux_min=flux_min,
        channel_width=channel_width,
        of_date=of_date,
    )


def sky_of(
    model: SkyModel,
    path: Path,
    freqs: FloatArray,
    *,
    reference_freq: float | None = None,
    or_nearest: bool = False,
    flux_min: float = 0.0,
    channel_width: FloatArray | float = 0.0,
    of_date: bool = False,
) -> Sky:
    """Evaluate a catalogue at some frequencies; it stays as it is.

    Parameters
    ----------
    model : pyradiosky.SkyModel
        Points or a HEALPix map, in Jy or K sr (a map also in K).
    path : Path
        What messages call it.
    freqs, reference_freq, or_nearest, flux_min, channel_width, of_date
        As of `read_catalogue`.

    Returns
    -------
    Sky
        As of `read_catalogue`.

    Raises
    ------
    InputError
        If it lacks a flux at these frequencies, or no source is left.
    """
    is_map = model.component_type == "healpix"
    with reading(path, "a catalogue"):
        if is_map:
            model = model.copy()
            model.healpix_to_point(to_jy=False, run_check=False)
        is_polarised = bool(np.any(model.stokes[1:] != 0))
        coordinates = model.skycoord if of_date and is_of_date(model) else model.skycoord.icrs
        ra, dec = coordinates.ra.rad, coordinates.dec.rad
    if is_polarised:
        logger.warning("%s: polarised sources are taken as unpolarised (only Stokes I is used)", path.name)
    wanted = freqs
    with reading(path, "a catalogue"):
        _check_covered(model, freqs, channel_width, path)
        if reference_freq is not None:
            reference_freq = _reference_freq(model, reference_freq, or_nearest, path)
            wanted = np.append(freqs, reference_freq)
        flux = _to_jansky(_stokes_i(model, wanted, path), model.stokes.unit, wanted)
    flux[:, ~np.isfinite(ra + dec)] = np.nan
    usable = _usable(flux, is_map, path)
    sky = Sky(
        ra=ra[usable],
        dec=dec[usable],
        flux=np.take(flux[: len(freqs)], usable, axis=1),
        names=None if is_map else tuple(str(name) for name in model.name[usable]),
        reference_flux=None if reference_freq is None else flux[-1, usable],
        reference_freq=reference_freq,
    ).brighter_than(flux_min)
    if not sky.Nsrc:
        message = f"no source of {flux_min:g} Jy or more"
        raise InputError(message, file=path, field="flux_min", remedy="lower it")
    return sky


def is_of_date(model: SkyModel) -> bool:
    """Tell whether places are those of a date, by the true equator and equinox."""
    return bool(model.skycoord.frame.name == "tete")


def file_type(path: Path) -> str | None:
    """Return what kind of catalogue a file's name says that it is; VOTables may be compressed."""
    named = FILE_TYPES.get(path.suffix.lower())
    if path.suffix.lower() == ".gz" and FILE_TYPES.get(path.with_suffix("").suffix.lower()) == "vot":
        named = "vot"
    return named


def read_model(path: Path, columns: VOTableColumns | None = None) -> SkyModel:
    """Read a catalogue as it is, with the parameters and errors of `read_catalogue`."""
    from pyradiosky import SkyModel  # takes long to import, which only jobs with a catalogue need

    kind = file_type(path)
    check_file(path, field="[sky] file")
    if kind is None:
        known = ", ".join(FILE_TYPES)
        message = f"unknown kind of catalogue '{path.suffix}'"
        raise InputError(message, file=path, remedy=f"use one of {known}")
    if columns is not None and kind != "vot":
        raise InputError("has no columns to choose", file=path, field="[sky.columns]", remedy="leave that table out")
    options: dict[str, object] = {"filetype": kind}
    if kind == "vot" and columns is None:
        options["filetype"] = "gleam"
    elif kind == "vot" and columns is not None:
        options |= _votable_options(columns)
    remedy = "check the names and units of its columns" if kind == "vot" else DAMAGED
    # Its warnings are about negative fluxes, which `_usable` sees to, and repeated names, which do no harm.
    with reading(path, kind, remedy=remedy):
        if kind == "skyh5":
            _check_longitudes(path)
        model: SkyModel = SkyModel.from_file(str(path), **options)
        return model


def _check_longitudes(path: Path) -> None:
    """Refuse longitudes of many turns, which astropy would take for any place on the sky."""
    with h5py.File(path, "r") as file:
        places = file["Header"].get("skycoord", {})
        for name in places:
            if places[name].attrs.get("object_type") == "longitude":
                turns = np.abs(Quantity(places[name][()], places[name].attrs["unit"]).to_value("cycle"))
                if np.any(turns > TURNS):
                    told = f"a longitude of {turns[turns > TURNS][0]:.3g} turns"
                    raise InputError(told, field=f"Header/skycoord/{name}", remedy=DAMAGED)


def _votable_options(columns: VOTableColumns) -> dict[str, object]:
    options: dict[str, object] = {
        "table_name": columns.table,
        "id_column": columns.name,
        "lon_column": columns.lon,
        "lat_column": columns.lat,
        "frame": columns.frame,
        "flux_columns": list(columns.flux),
    }
    if len(columns.flux) > 1:
        return options | {"freq_array": Quantity(columns.freqs, "Hz")}
    if columns.reference_freq is not None:
        options["reference_frequency"] = Quantity(columns.reference_freq, "Hz")
    return options | {"spectral_index_column": columns.spectral_index}


def _span(model: SkyModel) -> tuple[float, float]:
    """Return the lowest and the highest frequency (Hz) at which a catalogue has fluxes."""
    if model.spectral_type in ("spectral_index", "flat"):
        return 0.0, np.inf
    listed = model.freq_array.to_value("Hz")
    return float(listed.min()), float(listed.max())


def _check_covered(model: SkyModel, freqs: FloatArray, channel_width: FloatArray | float, path: Path) -> None:
    """Refuse frequencies (Hz), (Nfreqs,), at which there are no fluxes."""
    low, high = _span(model)
    # Fluxes of one channel are those of a channel beside it too.
    tolerance = np.maximum(FREQ_TOLERANCE_HZ, channel_width if low == high else 0.0)
    outside = np.abs(np.clip(freqs, low, high) - freqs) > tolerance
    if outside.any():
        message = f"no flux at {freqs[outside][0] / 1e6:g} MHz, only from {low / 1e6:g} to {high / 1e6:g} MHz"
        raise InputError(message, file=path, remedy="select other frequencies or another catalogue")


def _reference_freq(model: SkyModel, asked: float, or_nearest: bool, path: Path) -> float:
    """Return the frequency (Hz) that cuts refer to."""
    low, high = _span(model)
    nearest = float(np.clip(asked, low, high))
    if nearest != asked and or_nearest:
        logger.info("%s: cuts refer to fluxes at %g MHz, the nearest to %g MHz", path.name, nearest / 1e6, asked / 1e6)
    elif abs(nearest - asked) > FREQ_TOLERANCE_HZ:
        message = f"no flux at {asked / 1e6:g} MHz in {path.name}, only from {low / 1e6:g} to {high / 1e6:g} MHz"
        raise InputError(message, field="[sky] reference_freq", remedy="choose one of these, or leave it out")
    return nearest


def _stokes_i(model: SkyModel, freqs: FloatArray, path: Path) -> FloatArray:
    """Evaluate Stokes I at ``freqs`` in the catalogue's own unit, (Nfreqs, Nsrc)."""
    stokes_i = np.asarray(model.stokes[0].value, dtype=float)
    if model.spectral_type == "spectral_index":
        return power_law(stokes_i[0], model.reference_frequency.to_value("Hz"), model.spectral_index, freqs)
    if model.spectral_type == "flat":
        logger.info("%s gives one flux a source, used at every frequency", path.name)
        return np.repeat(stokes_i, len(freqs), axis=0)
    listed = model.freq_array.to_value("Hz")
    inside = np.clip(freqs, listed.min(), listed.max())
    if len(listed) == 1:
        return np.repeat(stokes_i, len(freqs), axis=0)
    if model.spectral_type == "full":
        return np.asarray(interp1d(listed, stokes_i, axis=0)(inside))
    # Sources without a flux in some subbands are interpolated between the others, and NaN beyond them.
    at_freqs = model.at_frequencies(
        Quantity(inside, "Hz"),
        inplace=False,
        # A cubic spline needs four of them.
        freq_interp_kind="cubic" if len(listed) > 3 else "linear",
        nan_handling="interp",
        run_check=False,
    )
    return np.asarray(at_freqs.stokes[0].value)


def _to_jansky(values: FloatArray, unit: units.UnitBase, freqs: FloatArray) -> FloatArray:
    """Convert from Jy or (by Rayleigh-Jeans) from K sr."""
    if unit.is_equivalent("Jy"):
        return values * unit.to("Jy")
    jy_per_k_sr = [(1 * units.K).to_value("Jy/sr", units.brightness_temperature(freq * units.Hz)) for freq in freqs]
    return values * unit.to("K sr") * np.array(jy_per_k_sr)[:, np.newaxis]


def _usable(flux: FloatArray, is_map: bool, path: Path) -> IntArray:
    """Find the sources with a flux: of a map, which may be without its mean, negative pixels are among them."""
    known = np.isfinite(flux).all(axis=0)
    usable = np.flatnonzero(known & ((flux != 0).any(axis=0) if is_map else (flux > 0).all(axis=0)))
    total, unknown = flux.shape[1], np.sum(~known)
    largest = np.abs(flux[:, usable]).max(initial=0.0)
    if largest > LARGEST:
        told = f"a source of {largest:.3g} Jy at these frequencies"
        raise InputError(told, file=path, field="flux", remedy="correct its flux or its spectrum")
    if not len(usable):
        remedy = "select other frequencies or another catalogue"
        raise InputError("no source with a flux at these frequencies", file=path, remedy=remedy)
    if len(usable) < total:
        count = f"{total - len(usable)} of {total} sources left out"
        logger.warning("%s: %s: %d without a flux or place, the others not positive", path.name, count, unknown)
    return usable
