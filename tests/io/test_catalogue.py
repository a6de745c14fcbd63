import gzip
import logging
import os
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from astropy import units
from astropy.coordinates import SkyCoord
from astropy.io.votable import from_table
from astropy.table import Table
from astropy_healpix import healpix_to_lonlat, nside_to_pixel_area
from pyradiosky import SkyModel
from pyradiosky.data import DATA_PATH as PYRADIOSKY_DATA

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.catalogue import VOTableColumns, read_catalogue
from hydrabeam_mpi.model.sky import separation

FREQS = np.array([131e6, 150e6])
RA, DEC = np.array([10.0, 50.0, 350.0]), np.array([-30.0, -37.0, 5.0])
FLUX = np.array([2.0, 0.5, 30.0])
INDEX = np.array([-0.8, 0.3, -1.1])
SUBBANDS = np.arange(100e6, 181e6, 8e6)


def sky_model(frame="icrs", flux=FLUX, **kwargs):
    """A point-source SkyModel at RA, DEC, (Nfreqs, 3) or (3,) Jy."""
    stokes = np.zeros((4, *np.atleast_2d(flux).shape))
    stokes[0] = flux
    spectral = {
        "spectral_type": "spectral_index",
        "spectral_index": INDEX,
        "reference_frequency": np.full(3, 180e6) * units.Hz,
    }
    return SkyModel(
        name=["a", "b", "c"],
        skycoord=SkyCoord(RA, DEC, unit="deg").transform_to(frame),
        stokes=stokes * units.Jy,
        **(kwargs or spectral),
    )


def subbands(flux, spectral_type="subband", freqs=SUBBANDS):
    return sky_model(flux=flux, spectral_type=spectral_type, freq_array=freqs * units.Hz)


def written(model, path):
    (model.write_text_catalog if path.suffix == ".txt" else model.write_skyh5)(path)
    return path


def assert_in_place(sky, atol_arcsec=1e-3):
    shift = separation(sky.ra, sky.dec, np.deg2rad(RA), np.deg2rad(DEC))
    assert np.rad2deg(shift).max() * 3600 < atol_arcsec


@pytest.mark.parametrize("frame", ["icrs", "fk5", "galactic"])
@pytest.mark.parametrize("name", ["sky.skyh5", "sky.txt"])
def test_power_laws_in_any_frame(tmp_path, name, frame):
    sky = read_catalogue(written(sky_model(frame), tmp_path / name), FREQS)
    # The text format keeps six decimals of a degree.
    assert_in_place(sky, 4e-3)
    np.testing.assert_allclose(sky.flux, FLUX * (FREQS[:, np.newaxis] / 180e6) ** INDEX, rtol=1e-6)
    assert sky.names == ("a", "b", "c")
    assert sky.reference_flux is None


def test_subbands_are_interpolated(tmp_path):
    exact = FLUX * (SUBBANDS[:, np.newaxis] / 180e6) ** INDEX
    path = written(subbands(exact), tmp_path / "sky.skyh5")
    sky = read_catalogue(path, FREQS)
    np.testing.assert_allclose(sky.flux, FLUX * (FREQS[:, np.newaxis] / 180e6) ** INDEX, rtol=2e-5)


@pytest.mark.parametrize("n_bands", [2, 3])
def test_between_few_subbands_fluxes_are_linear(tmp_path, n_bands):
    freqs, flux = np.array([130e6, 140e6, 150e6])[:n_bands], np.random.default_rng(0).uniform(1, 2, (n_bands, 3))
    sky = read_catalogue(written(subbands(flux, freqs=freqs), tmp_path / "sky.skyh5"), np.array([131e6, 139e6]))
    expected = [np.interp([131e6, 139e6], freqs, of_source) for of_source in flux.T]
    np.testing.assert_allclose(sky.flux, np.transpose(expected), rtol=1e-12)


def test_listed_frequencies_are_taken_exactly_and_interpolated_between(tmp_path):
    listed = np.array([120e6, 131e6, 160e6])
    flux = np.random.default_rng(0).uniform(1, 2, (3, 3))
    sky = read_catalogue(written(subbands(flux, "full", listed), tmp_path / "sky.skyh5"), np.array([131e6, 145.5e6]))
    np.testing.assert_array_equal(sky.flux[0], flux[1])
    np.testing.assert_allclose(sky.flux[1], (flux[1] + flux[2]) / 2, rtol=1e-12)


@pytest.mark.parametrize("spectral_type", ["subband", "full"])
@pytest.mark.parametrize("freq", [99e6, 190e6])
def test_frequencies_outside_the_catalogue_are_refused(tmp_path, spectral_type, freq):
    path = written(subbands(np.ones((len(SUBBANDS), 3)), spectral_type), tmp_path / "sky.skyh5")
    with pytest.raises(InputError, match=rf"{path}: no flux at {freq / 1e6:g} MHz, only from 100 to 180 MHz; select"):
        read_catalogue(path, np.array([freq]))


def test_a_flat_spectrum_holds_everywhere(tmp_path):
    sky = read_catalogue(written(sky_model(spectral_type="flat"), tmp_path / "sky.txt"), FREQS)
    np.testing.assert_array_equal(sky.flux, [FLUX, FLUX])


def test_sources_without_positive_flux_are_left_out_and_counted(tmp_path, caplog):
    flux = np.outer(np.ones(len(SUBBANDS)), [np.nan, -1.0, 4.0])
    path = written(subbands(flux), tmp_path / "sky.skyh5")
    with caplog.at_level(logging.WARNING):
        sky = read_catalogue(path, FREQS)
    assert sky.names == ("c",)
    np.testing.assert_allclose(sky.flux, 4.0)
    assert "2 of 3 sources left out: 1 without a flux or place, the others not positive" in caplog.text


def test_a_gap_in_the_subbands_is_bridged_but_not_extrapolated(tmp_path):
    flux = np.outer(SUBBANDS / 100e6, FLUX)
    flux[4, 0] = np.nan  # 132 MHz
    flux[5:, 1] = np.nan  # from 140 MHz on
    sky = read_catalogue(written(subbands(flux), tmp_path / "sky.skyh5"), FREQS)
    assert sky.names == ("a", "c")
    np.testing.assert_allclose(sky.flux[:, 0], 2.0 * FREQS / 100e6, rtol=1e-10)


def test_a_catalogue_without_any_flux_is_refused(tmp_path):
    path = written(subbands(np.full((len(SUBBANDS), 3), np.nan)), tmp_path / "sky.skyh5")
    with pytest.raises(InputError, match="no source with a flux at these frequencies"):
        read_catalogue(path, FREQS)


def test_cuts_refer_to_the_reference_frequency(tmp_path):
    path = written(sky_model(), tmp_path / "sky.skyh5")
    at_100_mhz = FLUX * (100 / 180) ** INDEX
    sky = read_catalogue(path, FREQS, reference_freq=100e6, flux_min=1.0)
    assert sky.names == ("a", "c")
    np.testing.assert_allclose(sky.reference_flux, at_100_mhz[[0, 2]], rtol=1e-12)
    with pytest.raises(InputError, match=r"flux_min: no source of 100 Jy or more; lower it"):
        read_catalogue(path, FREQS, flux_min=100.0)


@pytest.mark.parametrize("spectral_type", ["subband", "full"])
def test_cuts_refer_to_the_nearest_frequency_that_there_is(tmp_path, spectral_type):
    flux = np.array([[2.0, 0.5, 30.0], [1.0, 3.0, 20.0]])
    path = written(subbands(flux, spectral_type, np.array([140e6, 160e6])), tmp_path / "sky.skyh5")
    freqs = np.array([150e6])
    sky = read_catalogue(path, freqs, reference_freq=100e6, or_nearest=True, flux_min=1.0)
    assert sky.names == ("a", "c")
    np.testing.assert_allclose(sky.reference_flux, [2.0, 30.0])
    assert sky.reference_freq == 140e6
    np.testing.assert_allclose(sky.flux, [[1.5, 25.0]])
    assert read_catalogue(path, freqs, reference_freq=150e6, or_nearest=True).reference_freq == 150e6
    with pytest.raises(InputError, match=r"\[sky\] reference_freq: no flux at 100 MHz in sky.skyh5, only from 140 to"):
        read_catalogue(path, freqs, reference_freq=100e6, flux_min=1.0)


def test_fluxes_of_one_frequency_are_those_of_a_channel_that_holds_it(tmp_path):
    path = written(subbands(FLUX[np.newaxis], "full", np.array([150e6])), tmp_path / "sky.skyh5")
    near = {"reference_freq": 100e6, "or_nearest": True, "channel_width": np.array([1e5])}
    sky = read_catalogue(path, np.array([150.05e6]), **near)
    np.testing.assert_array_equal(sky.flux, [FLUX])
    assert sky.reference_freq == 150e6
    with pytest.raises(InputError, match=r"no flux at 150\.2 MHz, only from 150 to 150 MHz; select other"):
        read_catalogue(path, np.array([150.2e6]), **near)


def test_only_stokes_i_is_used_and_said_so(tmp_path, caplog):
    model = sky_model()
    model.stokes[1] = 0.3 * units.Jy
    sky = read_catalogue(written(model, tmp_path / "sky.skyh5"), FREQS)
    assert "only Stokes I is used" in caplog.text
    np.testing.assert_allclose(sky.flux[0, 0], 2.0 * (131 / 180) ** -0.8)


@pytest.mark.parametrize("unit", ["K", "Jy/sr"])
def test_map_pixels_become_sources(tmp_path, unit):
    nside, freqs = 4, np.array([130e6, 140e6])
    stokes = np.zeros((4, 2, 12 * nside**2))
    stokes[0] = [np.arange(1, 193), np.arange(2, 194)]
    stokes[0, :, 7] = -5.0  # a map may lack its mean
    stokes[0, :, 9] = np.nan
    model = SkyModel(
        nside=nside, hpx_inds=np.arange(192), hpx_order="nested", frame="galactic", component_type="healpix",
        stokes=stokes * units.Unit(unit), spectral_type="full", freq_array=freqs * units.Hz,
    )  # fmt: skip
    sky = read_catalogue(written(model, tmp_path / "map.skyh5"), freqs)
    kept = np.delete(np.arange(192), 9)
    if unit == "K":  # pyradiosky's own conversion
        model.healpix_to_point()
        expected = model.stokes[0].to_value("Jy")
    else:
        expected = stokes[0] * nside_to_pixel_area(nside).to_value("sr")
    np.testing.assert_allclose(sky.flux, expected[:, kept], rtol=1e-9)
    assert sky.names is None
    lon, lat = healpix_to_lonlat(kept, nside, order="nested")
    centres = SkyCoord(lon, lat, frame="galactic").icrs
    assert separation(sky.ra, sky.dec, centres.ra.rad, centres.dec.rad).max() < 1e-9


def votable(path, columns):
    """Write {name: (unit, values)} as the table VIII_100_gleamegc."""
    table = Table({name: units.Quantity(values, unit) if unit else values for name, (unit, values) in columns.items()})
    votable_file = from_table(table)
    votable_file.get_first_table().name = votable_file.get_first_table()._ID = "VIII_100_gleamegc"
    votable_file.to_xml(str(path))
    return path


PLACES = {"GLEAM": (None, ["J1", "J2", "J3"]), "RAJ2000": ("deg", RA), "DEJ2000": ("deg", DEC)}


def test_votable_columns(tmp_path):
    columns = PLACES | {"Fintfit200": ("mJy", 1e3 * FLUX), "alpha": (None, INDEX)}
    sky = read_catalogue(votable(tmp_path / "sky.vot", columns), FREQS, columns=VOTableColumns())
    np.testing.assert_allclose(sky.flux, FLUX * (FREQS[:, np.newaxis] / 200e6) ** INDEX, rtol=1e-12)
    assert sky.names == ("J1", "J2", "J3")
    # FK5 differs from ICRS by some tens of milliarcseconds.
    assert_in_place(sky, 0.1)
    assert not np.allclose(sky.ra, np.deg2rad(RA), rtol=0, atol=1e-9)


def test_a_compressed_votable(tmp_path):
    columns = PLACES | {"Fintfit200": ("mJy", 1e3 * FLUX), "alpha": (None, INDEX)}
    plain = votable(tmp_path / "sky.vot", columns)
    packed = tmp_path / "SKY.VOT.GZ"
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    sky = read_catalogue(packed, FREQS, columns=VOTableColumns())
    np.testing.assert_array_equal(sky.flux, read_catalogue(plain, FREQS, columns=VOTableColumns()).flux)
    (tmp_path / "sky.txt.gz").touch()
    with pytest.raises(InputError, match=r"unknown kind of catalogue '\.gz'"):
        read_catalogue(tmp_path / "sky.txt.gz", FREQS)


def test_votable_subbands(tmp_path):
    columns = PLACES | {"S130": ("Jy", FLUX), "S150": ("Jy", 2 * FLUX)}
    options = VOTableColumns(flux=("S130", "S150"), freqs=(130e6, 150e6))
    sky = read_catalogue(votable(tmp_path / "sky.vot", columns), np.array([135e6]), columns=options)
    np.testing.assert_allclose(sky.flux[0], 1.25 * FLUX, rtol=1e-12)


def test_gleam_is_the_default_votable(tmp_path):
    centres = np.array([76, 84, 92, 99, 107, 115, 122, 130, 143, 151, 158, 166, 174, 181, 189, 197, 204, 212, 220, 227])
    fluxes = {f"Fint{mhz:03d}": ("Jy", FLUX * (mhz / 180) ** INDEX) for mhz in centres}
    sky = read_catalogue(votable(tmp_path / "any_name.vot", PLACES | fluxes), FREQS)
    np.testing.assert_allclose(sky.flux, FLUX * (FREQS[:, np.newaxis] / 180e6) ** INDEX, rtol=3e-4)


def test_a_votable_without_the_flux_column_is_refused(tmp_path):
    path = votable(tmp_path / "sky.vot", PLACES)
    with pytest.raises(InputError, match=r"sky\.vot: cannot be read as vot .*Fintfit200.*; check the names") as caught:
        read_catalogue(path, FREQS, columns=VOTableColumns())
    assert "\n" not in str(caught.value)


def test_text_without_a_flux_column_is_refused(tmp_path):
    path = tmp_path / "sky.txt"
    path.write_text("source_id\tra_icrs\tdec_icrs\na\t10\t-30\n")
    with pytest.raises(InputError, match=r"sky\.txt: cannot be read as text .*flux"):
        read_catalogue(path, FREQS)


@pytest.mark.parametrize(("name", "keep"), [("sky.skyh5", 0.5), ("sky.txt", 0.9), ("sky.vot", 0.7), ("sky.sav", 0.5)])
def test_truncated_files_are_refused(tmp_path, name, keep):
    path = tmp_path / name
    if path.suffix == ".vot":
        votable(path, PLACES | {"Fintfit200": ("Jy", FLUX), "alpha": (None, INDEX)})
    elif path.suffix == ".sav":
        shutil.copy(Path(PYRADIOSKY_DATA) / "fhd_catalog_no_extend.sav", path)
    else:
        written(sky_model(), path)
    path.write_bytes(path.read_bytes()[: int(keep * path.stat().st_size)])
    with pytest.raises(InputError, match=f"{name}: cannot be read as"):
        read_catalogue(path, FREQS, columns=VOTableColumns() if path.suffix == ".vot" else None)


def test_columns_of_what_has_none_are_refused(tmp_path):
    written(sky_model(), tmp_path / "sky.skyh5")
    with pytest.raises(InputError, match=r"sky.skyh5: \[sky.columns\]: has no columns to choose; leave that table out"):
        read_catalogue(tmp_path / "sky.skyh5", FREQS, columns=VOTableColumns())


def test_missing_and_unknown_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_catalogue(tmp_path / "none.skyh5", FREQS)
    (tmp_path / "sky.doc").touch()
    with pytest.raises(InputError, match=r"unknown kind of catalogue '\.doc'; use one of \.skyh5"):
        read_catalogue(tmp_path / "sky.doc", FREQS)


def test_extended_fhd_sources_become_their_components():
    path = Path(PYRADIOSKY_DATA) / "extended_source_test.sav"
    sky = read_catalogue(path, np.array([180e6]))
    expected = SkyModel.from_file(path, expand_extended=True)
    whole = SkyModel.from_file(path, expand_extended=False)
    assert sky.Nsrc == expected.Ncomponents > whole.Ncomponents
    assert any("_" in name for name in sky.names)
    np.testing.assert_allclose(sky.flux, expected.at_frequencies([180] * units.MHz, inplace=False).stokes[0].value)


@pytest.fixture(scope="module")
def gleam():
    """The real catalogue at 150 and 180 MHz, whose 157,615 entries take a minute or more to read."""
    data = Path(os.environ.get("HYDRABEAM_DATA", Path(__file__).parents[3] / "shared" / "data"))
    path = data / "models" / "GLEAM_KGS_Fornax_180MHz.sav"
    if not path.exists():
        pytest.skip(f"{path} is not here")
    return read_catalogue(path, np.array([150e6, 180e6]))


@pytest.mark.study
def test_fhd_catalogue_has_its_sources_and_the_components_of_fornax_a(gleam):
    # 157,615 entries, of which three extended ones have 1295, 733 and 609 components.
    assert gleam.Nsrc == 157_615 - 3 + 1295 + 733 + 609
    assert sum("_" in name for name in gleam.names) == 1295 + 733 + 609
    fornax = separation(gleam.ra, gleam.dec, np.deg2rad(50.67), np.deg2rad(-37.21)) < np.deg2rad(0.5)
    assert 540 < gleam.flux[1, fornax].sum() < 600
    assert gleam.flux[1].max() == pytest.approx(215.992, abs=1e-3)  # the brightest single source


@pytest.mark.study
def test_fhd_catalogue_scales_with_its_spectral_indices(gleam):
    ratio = gleam.flux[0] / gleam.flux[1]
    indices = np.log(ratio) / np.log(150 / 180)
    assert -3.3 < indices.min() < np.median(indices) < -0.7
    brightest = np.argmax(gleam.flux[1])
    assert indices[brightest] == pytest.approx(-0.75231266, abs=1e-5)
    assert gleam.flux[1].sum() == pytest.approx(61_690, rel=1e-3)


def test_longitudes_of_many_turns_are_refused(tmp_path):
    path = written(sky_model(), tmp_path / "sky.skyh5")
    with h5py.File(path, "r+") as file:
        file["Header/skycoord/ra"][1] -= 360
    np.testing.assert_allclose(read_catalogue(path, FREQS).ra, np.deg2rad(RA))
    with h5py.File(path, "r+") as file:
        file["Header/skycoord/ra"][1] = 1e300
    with pytest.raises(InputError, match=r"sky.skyh5: Header/skycoord/ra: a longitude of 2.78e\+297 turns"):
        read_catalogue(path, FREQS)
