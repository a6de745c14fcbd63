"""Beam files of every kind read as power beams, and those written read back by pyuvdata, matvis and fftvis."""

import warnings

import numpy as np
import pytest
import yaml
from astropy_healpix import HEALPix
from matvis.core.beams import prepare_beam_unpolarized
from pyuvdata import AiryBeam, BeamInterface, ShortDipoleBeam, UVBeam

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.beamfits import BeamFile, write_power_beam
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.model.bases.rings import RingGrid
from hydrabeam_mpi.model.fit import fit_beam

DEG = np.pi / 180


def dipole_uvbeam(freqs=(150e6,), x_points="east", **grid):
    """E-field of a short dipole as pyuvdata samples it; by default on a 5 degree grid of the whole sphere."""
    if not grid:
        grid = {"axis1_array": np.arange(72) * 5 * DEG, "axis2_array": np.arange(37) * 5 * DEG}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return ShortDipoleBeam(x_orientation=x_points).to_uvbeam(
            np.array(freqs, dtype=float), beam_type="efield", **grid
        )


def airy_uvbeam(freqs, diameter=3.0):
    grid = {"axis1_array": np.arange(36) * 10 * DEG, "axis2_array": np.arange(91) * DEG}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        beam = AiryBeam(diameter=diameter, x_orientation="east")
        return beam.to_uvbeam(np.array(freqs, dtype=float), beam_type="power", **grid)


def saved(uvbeam, folder, name="beam.beamfits"):
    uvbeam.write_beamfits(str(folder / name), clobber=True, run_check=False)
    return folder / name


def quietly(path, **settings):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return BeamFile(path, **settings)


DIRECTIONS = np.array([20.0, 45, 70, 85]) * DEG, np.array([10.0, 100, 190, 355]) * DEG


def dipole_power(pol, za, az):
    """Power of two crossed dipoles: 1 - (s.e)^2 along the axis e, and -(s.e)(s.n) across."""
    east, north = np.sin(za) * np.cos(az), np.sin(za) * np.sin(az)
    return {"ee": 1 - east**2, "nn": 1 - north**2, "en": -east * north, "ne": -east * north}[pol]


@pytest.mark.parametrize("pol", ["ee", "nn", "en", "ne"])
@pytest.mark.parametrize("x_points", ["east", "north"])
def test_efield_becomes_the_power_beam_of_the_feed_that_points_there(tmp_path, pol, x_points):
    beam = quietly(saved(dipole_uvbeam(x_points=x_points), tmp_path)).beam(150e6, pol)
    np.testing.assert_allclose(beam(*DIRECTIONS), dipole_power(pol, *DIRECTIONS), atol=1e-4)
    pixels = beam.pixels
    np.testing.assert_allclose(pixels.values, dipole_power(pol, pixels.za, pixels.az), atol=1e-12)
    assert np.iscomplexobj(pixels.values) == (pol in ("en", "ne"))
    assert beam.info.pol == pol


def test_labels_of_the_file_can_be_asked_for(tmp_path):
    file = quietly(saved(dipole_uvbeam(x_points="north"), tmp_path))
    np.testing.assert_array_equal(file.beam(150e6, "xx").pixels.values, file.beam(150e6, "nn").pixels.values)
    np.testing.assert_array_equal(file.beam(150e6, "YY").pixels.values, file.beam(150e6, "ee").pixels.values)


def wrong_header(folder):
    uvbeam = dipole_uvbeam(x_points="east")
    uvbeam.set_feeds_from_x_orientation("north")
    return saved(uvbeam, folder)


def test_header_that_contradicts_the_field_is_told(tmp_path):
    with pytest.warns(UserWarning, match=r'points East.*east_feed = "x"'):
        file = BeamFile(wrong_header(tmp_path))
    np.testing.assert_allclose(file.beam(150e6, "ee")(*DIRECTIONS), dipole_power("nn", *DIRECTIONS), atol=1e-4)


def test_feed_named_east_overrides_the_header(tmp_path):
    file = quietly(wrong_header(tmp_path), east_feed="x")
    for pol in ("ee", "nn", "en"):
        np.testing.assert_allclose(file.beam(150e6, pol)(*DIRECTIONS), dipole_power(pol, *DIRECTIONS), atol=1e-4)
    with pytest.raises(InputError, match="'z' is not a feed"):
        BeamFile(wrong_header(tmp_path), east_feed="z")


def test_file_without_orientation_needs_to_be_told(tmp_path):
    uvbeam = dipole_uvbeam()
    uvbeam.feed_angle = np.array([0.3, 0.3 + np.pi / 2])
    path = saved(uvbeam, tmp_path)
    with pytest.raises(InputError, match=r"'ee' has no meaning.*east_feed"):
        quietly(path).beam(150e6, "ee")
    np.testing.assert_allclose(quietly(path).beam(150e6, "xx")(*DIRECTIONS), dipole_power("ee", *DIRECTIONS), atol=1e-4)


def test_measured_feeds_of_hera(data_dir):
    """The dipole's header is right; the Vivaldi's is not, nor is the nside of its E-field file."""
    models = data_dir / "models"
    quietly(models / "HERA_Dipole_efield_100-101MHz.fits")
    with pytest.warns(UserWarning, match="efield_150MHz_nside16") as caught:
        BeamFile(models / "HERA_Vivaldi_efield_150MHz_nside16.beamfits")
    messages = " ".join(str(warning.message) for warning in caught)
    assert "nside is said to be 64" in messages
    assert "points East" in messages


@pytest.mark.parametrize(
    ("name", "freq", "settings"),
    [
        ("HERA_Vivaldi_power_131MHz_nside64.beamfits", 131e6, {"east_feed": "x"}),
        ("HERA_Vivaldi_power_81MHz_nside64.beamfits", 81e6, {"east_feed": "x"}),
        ("HERA_Dipole_efield_100-101MHz.fits", 101e6, {}),
    ],
)
def test_measured_beams_are_normalised_and_fitted(data_dir, name, freq, settings):
    file = quietly(data_dir / "models" / name, **settings)
    beam = file.beam(freq, "ee")
    assert beam.pixels.values.max() == 1
    assert beam.pixels.za.max() <= np.pi / 2 + 1e-9
    # The file's own samples come back, and an East-West dipole hardly sees the horizon in the East.
    some = slice(0, None, 97)
    np.testing.assert_allclose(beam(beam.pixels.za[some], beam.pixels.az[some]), beam.pixels.values[some], atol=1e-9)
    low = np.full(2, 85 * DEG)
    east, north = beam(low, np.array([0, np.pi / 2]))
    assert east < 0.3 * north
    assert fit_beam(beam, FourierBessel.selection(500, k_max=40, m_max=20)).rms_residual < 1e-3
    cross = file.beam(freq, "en")
    np.testing.assert_allclose(cross.pixels.values, file.beam(freq, "ne").pixels.values.conj(), atol=1e-12)
    assert cross.info.peak == pytest.approx(np.sqrt(beam.info.peak * file.beam(freq, "nn").info.peak))


@pytest.mark.parametrize("ordering", ["ring", "nested"])
@pytest.mark.parametrize("northern_half", [False, True])
def test_healpix_in_any_order_and_extent(tmp_path, ordering, northern_half):
    pixels = np.arange(12 * 16**2)
    _, lat = HEALPix(16, ordering).healpix_to_lonlat(pixels)
    if northern_half:
        pixels = pixels[lat.value > -1e-9]
    uvbeam = dipole_uvbeam(nside=16, ordering=ordering, healpix_pixel_array=pixels)
    beam = quietly(saved(uvbeam, tmp_path)).beam(150e6, "ee")
    assert len(beam.pixels.za) == 12 * 16**2 // 2 + 2 * 16
    found = beam.pixels
    np.testing.assert_allclose(found.values * beam.info.peak, dipole_power("ee", found.za, found.az), atol=1e-12)
    rings = RingGrid.from_pixels(found)
    np.testing.assert_array_equal(rings.n_az[:4], [4, 8, 12, 16])


@pytest.mark.parametrize("start", [-np.pi, 0.0, 1.0])
def test_azimuth_axis_may_start_anywhere(tmp_path, start):
    axes = {"axis1_array": start + np.arange(72) * 5 * DEG, "axis2_array": np.arange(19) * 5 * DEG}
    beam = quietly(saved(dipole_uvbeam(**axes), tmp_path)).beam(150e6, "ee")
    za, az = DIRECTIONS
    for turns in (-2 * np.pi, 0, 2 * np.pi):
        np.testing.assert_allclose(beam(za, az + turns), dipole_power("ee", za, az), atol=1e-4)


def test_azimuth_axis_may_close_the_circle(tmp_path):
    axes = {"axis1_array": np.arange(73) * 5 * DEG, "axis2_array": np.arange(19) * 5 * DEG}
    beam = quietly(saved(dipole_uvbeam(**axes), tmp_path)).beam(150e6, "ee")
    assert len(beam.pixels.za) == 72 * 19
    za, az = np.full(3, 80 * DEG), np.array([0.5, 358, 359.5]) * DEG
    np.testing.assert_allclose(beam(za, az), dipole_power("ee", za, az), atol=1e-4)


def test_nan_below_the_horizon_does_no_harm_to_a_fit(tmp_path):
    uvbeam = dipole_uvbeam()
    uvbeam.data_array[..., 25:, :] = np.nan
    beam = quietly(saved(uvbeam, tmp_path)).beam(150e6, "ee")
    assert np.isfinite(beam.pixels.values).all()
    assert len(beam.pixels.za) == 19 * 72
    assert np.isfinite(fit_beam(beam, FourierBessel.selection(None, k_max=6, m_max=3)).coeffs).all()
    np.testing.assert_allclose(beam(*DIRECTIONS), dipole_power("ee", *DIRECTIONS), atol=1e-4)
    with pytest.raises(InputError, match=r"beam.beamfits: .* end at a zenith angle of 120 deg"):
        beam(np.array([2.2]), np.zeros(1))


@pytest.mark.parametrize("grid", [{}, {"nside": 16}], ids=["az_za", "healpix"])
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e60])
def test_a_sample_above_the_horizon_that_is_no_number_is_refused(tmp_path, grid, value):
    uvbeam = dipole_uvbeam(**grid)
    uvbeam.data_array.reshape(*uvbeam.data_array.shape[:3], -1)[..., 200] = value
    with pytest.raises(InputError, match=r"beam.beamfits: data_array: 1 of \d+ samples .* above the horizon are NaN"):
        quietly(saved(uvbeam, tmp_path)).beam(150e6, "ee")


@pytest.mark.parametrize(
    ("azimuths", "zenith_angles", "words"),
    [
        (np.arange(37) * 5, np.arange(19) * 5, "axis1_array: no azimuths between 180 and 360 deg"),
        (np.arange(2, 72) * 5, np.arange(19) * 5, "axis1_array: no azimuths between 355 and 10 deg"),
        (np.arange(72) * 5, np.arange(17) * 5, "axis2_array: the samples end at a zenith angle of 80 deg"),
        (np.arange(72) * 5, np.arange(6, 19) * 5, "axis2_array: the samples begin at a zenith angle of 30 deg"),
    ],
)
def test_part_of_a_beam_is_refused(tmp_path, azimuths, zenith_angles, words):
    grid = {"axis1_array": azimuths * DEG, "axis2_array": zenith_angles * DEG}
    with pytest.raises(InputError, match=rf"beam.beamfits: {words}.*; give a beam"):
        BeamFile(saved(dipole_uvbeam(**grid), tmp_path))


def test_a_healpix_beam_that_lacks_pixels_above_the_horizon_is_refused(tmp_path):
    uvbeam = dipole_uvbeam(nside=16, ordering="ring", healpix_pixel_array=np.arange(500))
    with pytest.raises(InputError, match=r"pixel_array: 1068 of 1568 pixels above the horizon are missing"):
        BeamFile(saved(uvbeam, tmp_path))


def test_a_sample_that_stands_out_alone_is_refused(tmp_path):
    """Divided by it, the beam would be zero everywhere else."""
    uvbeam = airy_uvbeam([150e6])
    uvbeam.data_array[..., 40, 7] = 1e10
    with pytest.raises(InputError, match=r'data_array: one sample of "xx", 1e\+10, is more than 16 times'):
        quietly(saved(uvbeam, tmp_path)).beam(150e6, "ee")


def test_negative_power_is_told(tmp_path):
    uvbeam = airy_uvbeam([150e6])
    uvbeam.data_array[:, 0, :, 40, 7] = -0.25
    path = saved(uvbeam, tmp_path)
    with pytest.warns(UserWarning, match=r"1 of 6552 samples above the horizon are negative, down to -0.25"):
        BeamFile(path)


def test_interpolation_is_pyuvdata_s(tmp_path):
    for name, grid in (("az_za", {}), ("healpix", {"nside": 32})):
        uvbeam = dipole_uvbeam(**grid)
        beam = quietly(saved(uvbeam, tmp_path)).beam(150e6, "nn")
        uvbeam.efield_to_power()
        za, az = DIRECTIONS
        function = {"az_za": "az_za_simple", "healpix": "healpix_simple"}[name]
        settings = {"interpolation_function": function, "return_basis_vector": False}
        expected = uvbeam.interp(az_array=az, za_array=za, **settings)[0][0, 1, 0].real
        np.testing.assert_allclose(beam(za, az), expected / beam.info.peak, atol=1e-6)


def test_uneven_azimuths_are_interpolated_across_the_cut(data_dir):
    """The dipole's azimuths go from 0 to 359 degrees in steps of 2.006."""
    beam = BeamFile(data_dir / "models" / "HERA_Dipole_efield_100-101MHz.fits").beam(100e6, "ee")
    za = np.full(200, 40 * DEG)
    values = beam(za, np.linspace(-3, 3, 200) * DEG)
    assert np.abs(np.diff(values, 2)).max() < 1e-3 * np.ptp(values)
    rings = RingGrid.from_pixels(beam.pixels)
    assert len(rings.za) == 46
    with pytest.warns(UserWarning, match="46 zenith angles cannot carry 80 radial modes"):
        fit = fit_beam(beam, FourierBessel.selection(1024))
    assert fit.n_pixels == 91 * 360
    assert fit.rms_residual < 1e-4


FREQS = np.array([100e6, 110e6, 120e6, 130e6, 140e6])


def test_a_channel_of_the_file_is_taken_as_it_is(tmp_path):
    file = quietly(saved(airy_uvbeam(FREQS), tmp_path))
    np.testing.assert_allclose(file.freqs, FREQS)
    expected = quietly(saved(airy_uvbeam([120e6]), tmp_path, "one.beamfits")).beam(120e6, "ee").pixels.values
    for freq in (120e6, 120.04e6):
        np.testing.assert_array_equal(file.beam(freq, "ee").pixels.values, expected)


def test_frequency_is_interpolated_only_when_asked(tmp_path):
    file = quietly(saved(airy_uvbeam(FREQS), tmp_path))
    with pytest.raises(InputError, match=r"beam.beamfits: freq: no channel at 124.*'interpolate'"):
        file.beam(124e6, "ee")
    between = file.beam(124e6, "ee", interpolate_frequency=True)
    expected = quietly(saved(airy_uvbeam([124e6]), tmp_path, "one.beamfits")).beam(124e6, "ee").pixels.values
    np.testing.assert_allclose(between.pixels.values, expected, atol=1e-4)
    assert between.info.freq == 124e6


def test_two_channels_are_interpolated_linearly(tmp_path):
    file = quietly(saved(dipole_uvbeam(freqs=(100e6, 104e6)), tmp_path))
    beam = file.beam(101e6, "ee", interpolate_frequency=True)
    np.testing.assert_allclose(beam.pixels.values, dipole_power("ee", beam.pixels.za, beam.pixels.az), atol=1e-12)


@pytest.mark.parametrize("freq", [90e6, 150e6])
@pytest.mark.parametrize("interpolate", [False, True])
def test_no_overlap_in_frequency_is_told(tmp_path, freq, interpolate):
    file = quietly(saved(airy_uvbeam(FREQS), tmp_path))
    with pytest.raises(InputError, match=r"beam.beamfits: freq: the beam covers 100-140 MHz, not (90|150) MHz"):
        file.beam(freq, "ee", interpolate_frequency=interpolate)


@pytest.mark.parametrize(("pol", "words"), [("rr", "the file has"), ("qq", "unknown polarisation")])
def test_polarisation_not_in_the_file_is_told(tmp_path, pol, words):
    with pytest.raises(InputError, match=rf"beam.beamfits: pol.*{words}"):
        quietly(saved(dipole_uvbeam(), tmp_path)).beam(150e6, pol)


def test_a_beam_of_stokes_i_is_told(tmp_path):
    uvbeam = airy_uvbeam([150e6])
    uvbeam.select(polarizations=["xx"])
    uvbeam.polarization_array[:] = 1  # pI
    with pytest.raises(InputError, match=r"beam.beamfits: pol: no polarisation 'ee'; the file has pI"):
        quietly(saved(uvbeam, tmp_path)).beam(150e6, "ee")


def test_cross_polarised_beam_needs_both_peaks(tmp_path):
    uvbeam = dipole_uvbeam()
    uvbeam.efield_to_power()
    uvbeam.select(polarizations=["xx", "xy"])
    with pytest.raises(InputError, match="needs xx and yy"):
        quietly(saved(uvbeam, tmp_path)).beam(150e6, "en")


def test_missing_and_foreign_files_are_told(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        BeamFile(tmp_path / "none.beamfits")
    text = tmp_path / "notes.beamfits"
    text.write_text("not a beam")
    with pytest.raises(InputError, match=r"notes.beamfits: cannot be read as a beam"):
        BeamFile(text)
    whole = saved(dipole_uvbeam(), tmp_path).read_bytes()
    (tmp_path / "half.beamfits").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"half.beamfits: cannot be read as a beam"):
        BeamFile(tmp_path / "half.beamfits")


def cst_file(path):
    """E-field of an East-West dipole as CST writes it."""
    header = "Theta [deg.]  Phi [deg.]  Abs(E )[V/m   ]   Abs(Theta)[V/m   ]  Phase(Theta)[deg.]  "
    header += "Abs(Phi  )[V/m   ]  Phase(Phi  )[deg.]  Ax.Ratio[dB    ]"
    rows = [header, "-" * 80]
    for phi in range(0, 360, 10):
        for theta in range(0, 181, 10):
            along_theta, along_phi = np.cos(theta * DEG) * np.cos(phi * DEG), -np.sin(phi * DEG)
            phases = [0 if part >= 0 else 180 for part in (along_theta, along_phi)]
            size = np.hypot(along_theta, along_phi)
            rows.append(
                f"{theta} {phi} {size:.9e} {abs(along_theta):.9e} {phases[0]} {abs(along_phi):.9e} {phases[1]} 40"
            )
    path.write_text("\n".join(rows) + "\n")


def test_cst_files_are_read_by_their_settings_yaml(tmp_path):
    """Alone they do not tell what is needed."""
    names = ["dipole_150MHz.txt", "dipole_160MHz.txt"]
    for name in names:
        cst_file(tmp_path / name)
    names_of = {"telescope_name": "T", "feed_name": "F", "feed_version": "1", "model_name": "M", "model_version": "1"}
    of_feed = {"feed_pol": "x", "x_orientation": "east", "mount_type": "fixed"}
    settings = {"frequencies": [150e6, 160e6], "filenames": names, "history": "", **names_of, **of_feed}
    (tmp_path / "dipole.yaml").write_text(yaml.safe_dump(settings))
    file = quietly(tmp_path / "dipole.yaml")
    np.testing.assert_array_equal(file.freqs, [150e6, 160e6])
    beam = file.beam(150e6, "ee")
    np.testing.assert_allclose(beam.pixels.values, dipole_power("ee", beam.pixels.za, beam.pixels.az), atol=1e-8)
    with pytest.raises(
        InputError, match=r"MHz\.txt: \[beam\] source: a text file, and those of CST tell .*; name the settings yaml"
    ):
        BeamFile(tmp_path / names[0])


def power(za, az, freq):
    return np.exp(-((za * freq / 40e6) ** 2)) * (1 + 0.1 * np.sin(za) * np.cos(2 * az)) + 0.001 * np.cos(za)


def written(folder, pols=("ee",), freqs=(150e6, 160e6), scale=1.0, **settings):
    za, az = np.meshgrid(np.arange(91) * DEG, np.arange(360) * DEG, indexing="ij")
    values = scale * np.array([[power(za, az, freq) for freq in freqs] for _ in pols])
    path = folder / "written.beamfits"
    imag = write_power_beam(path, values, np.array(freqs), list(pols), telescope_name="HERA", **settings)
    return path, values, imag


def test_written_beam_is_read_back_by_pyuvdata(tmp_path):
    path, values, imag = written(tmp_path, history="Made for a test.")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        uvbeam = UVBeam.from_file(str(path))
        uvbeam.check(check_extra=True, run_check_acceptability=True)
    np.testing.assert_array_equal(uvbeam.data_array[0], values.real)
    assert imag == 0
    assert uvbeam.beam_type == "power"
    assert uvbeam.telescope_name == "HERA"
    assert "Made for a test." in uvbeam.history
    assert uvbeam.get_x_orientation_from_feeds() == "east"
    assert list(uvbeam.polarization_array) == [-5]
    np.testing.assert_array_equal(uvbeam.freq_array, [150e6, 160e6])
    np.testing.assert_allclose(uvbeam.axis1_array, np.arange(360) * DEG, atol=1e-15)
    np.testing.assert_allclose(uvbeam.axis2_array, np.arange(91) * DEG, atol=1e-15)


@pytest.mark.parametrize("pols", [("ee",), ("nn", "ee"), ("xx",), ("yy",)])
def test_a_written_beam_says_where_nobody_knows_where_its_feeds_point(tmp_path, pols):
    path, *_ = written(tmp_path, pols=pols, history="Made for a test.")
    told = "Where feeds point is not known; x is written as East." in UVBeam.from_file(str(path)).history
    assert told == (pols[0][0] in "xy")


def test_written_beam_is_read_back_as_a_model_beam(tmp_path):
    path, values, _ = written(tmp_path, scale=0.99)
    beam = quietly(path).beam(160e6, "ee")
    assert beam.info.peak == pytest.approx(0.99 * 1.001)
    np.testing.assert_allclose(beam.info.peak * beam.pixels.values, values[0, 1].ravel(), rtol=1e-14)


@pytest.mark.parametrize(
    ("pols", "x_points", "numbers"),
    [(("ee", "nn"), "east", [-5, -6]), (("ee", "nn"), "north", [-6, -5]), (("yy",), "east", [-6])],
)
def test_polarisations_are_labelled_by_the_feeds(tmp_path, pols, x_points, numbers):
    path, _, _ = written(tmp_path, pols=pols, x_points=x_points)
    uvbeam = UVBeam.from_file(str(path))
    assert list(uvbeam.polarization_array) == numbers
    assert uvbeam.get_x_orientation_from_feeds() == x_points
    assert quietly(path).beam(150e6, pols[0]).info.pol == pols[0]


def test_imaginary_part_of_a_power_beam_is_left_out_and_recorded(tmp_path):
    path, values, imag = written(tmp_path, scale=1 - 0.25j)
    uvbeam = UVBeam.from_file(str(path))
    assert imag == pytest.approx(0.25 * values.real.max())
    assert uvbeam.extra_keywords["IMAGMAX"] == pytest.approx(imag)
    np.testing.assert_array_equal(uvbeam.data_array[0], values.real)


def test_unevenly_spaced_channels_go_into_a_file_each(tmp_path):
    freqs = (150e6, 160e6, 175e6)
    path, values, imag = written(tmp_path, freqs=freqs, scale=1 + 0.5j)
    assert not path.exists()
    names = [tmp_path / f"written.{freq / 1e6:.6f}MHz.beamfits" for freq in freqs]
    with pytest.warns(UserWarning, match="not evenly spaced"):
        together = UVBeam.from_file([str(name) for name in names])
    np.testing.assert_array_equal(together.freq_array, freqs)
    np.testing.assert_array_equal(together.data_array[0], values.real)
    assert imag == pytest.approx(0.5 * values.real.max())


def test_cross_polarised_beams_stay_complex(tmp_path):
    path, values, imag = written(tmp_path, pols=("ee", "en"), freqs=(150e6,), scale=1 + 0.5j)
    uvbeam = UVBeam.from_file(str(path))
    np.testing.assert_array_equal(uvbeam.data_array[0, 0], values[0].real)
    np.testing.assert_array_equal(uvbeam.data_array[0, 1], values[1])
    assert imag == pytest.approx(0.5 * values[0].real.max())


def test_matvis_and_fftvis_evaluate_a_written_beam(tmp_path):
    """Both take beams through pyuvdata's interface, matvis after its own preparation."""
    path, _, _ = written(tmp_path)
    za, az = DIRECTIONS
    prepared = prepare_beam_unpolarized(BeamInterface(UVBeam.from_file(str(path))))
    values = prepared.compute_response(az_array=az, za_array=za, freq_array=np.array([150e6]))
    assert values.shape == (1, 1, 1, 4)
    np.testing.assert_allclose(values[0, 0, 0], power(za, az, 150e6), atol=1e-6)


def test_fftvis_simulates_with_a_written_beam(tmp_path):
    """One source: the visibility is half its flux times the beam, at the phase of the baseline."""
    from astropy.coordinates import EarthLocation
    from astropy.time import Time
    from fftvis.wrapper import simulate_vis

    path, _, _ = written(tmp_path, freqs=(150e6,))
    location = EarthLocation.from_geodetic(21.428, -30.722, 1000.0)
    time = Time(2459000.3, format="jd", location=location)
    lst = time.sidereal_time("apparent").rad
    common = {
        "ants": {0: np.zeros(3), 1: np.array([10.0, 0.0, 0.0])},
        "fluxes": np.array([[2.0]]),
        "ra": np.array([lst + 0.05]),
        "dec": np.array([location.lat.rad]),
        "freqs": np.array([150e6]),
        "times": time.reshape(1),
        "telescope_loc": location,
        "baselines": [(0, 1)],
        "precision": 2,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        beam = UVBeam.from_file(str(path))
        with_file = simulate_vis(beam=beam, polarized=False, **common)
    # The hour angle is 0.05 rad East to within what precession and aberration move.
    assert np.abs(with_file).ravel()[0] == pytest.approx(power(0.05 * np.cos(location.lat.rad), 0.0, 150e6), rel=0.02)
