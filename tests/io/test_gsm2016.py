import os
from pathlib import Path

import numpy as np
import pytest
from astropy import units
from astropy.coordinates import SkyCoord

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.gsm2016 import read_gsm2016

NPIX = 12 * 64**2
JY_PER_PIXEL = 1e6 * 4 * np.pi / NPIX  # of 1 MJy/sr


@pytest.fixture
def folder(tmp_path):
    """Two component maps with weights at 100 and 400 MHz."""
    maps = np.stack([np.ones(NPIX), np.arange(NPIX) % 4])
    np.savetxt(tmp_path / "lowres_maps.txt", maps, fmt="%d")
    np.savetxt(tmp_path / "spectra.txt", [[0.1, 0.4], [100.0, 1.0], [1.0, 3.0], [0.0, -2.0]])
    return tmp_path


def test_components_are_weighted_and_interpolated_in_log_frequency(folder):
    sky = read_gsm2016(folder, np.array([100e6, 200e6, 400e6]))
    # 200 MHz is half way in log frequency: scale 10, weights 2 and -1.
    expected = [100.0 * np.ones(NPIX), 10.0 * (2 - np.arange(NPIX) % 4), 3.0 - 2 * (np.arange(NPIX) % 4)]
    np.testing.assert_allclose(sky.flux, np.array(expected) * JY_PER_PIXEL, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("freq", "complaint"), [(99e6, "no diffuse emission at 99 MHz"), (401e6, "no diffuse emission at 401 MHz")]
)
def test_out_of_range_is_refused(folder, freq, complaint):
    with pytest.raises(InputError, match=complaint):
        read_gsm2016(folder, np.array([freq]))


def test_bad_files_are_refused(folder):
    maps, spectra = folder / "lowres_maps.txt", folder / "spectra.txt"
    spectra.write_text("0.1 0.4\n1 1\n1 1\n")
    with pytest.raises(InputError, match="3 rows do not fit 2 component maps"):
        read_gsm2016(folder, np.array([150e6]))
    maps.write_text(maps.read_text()[:1000])
    with pytest.raises(InputError, match=r"lowres_maps\.txt: 500 pixels, not 49152"):
        read_gsm2016(folder, np.array([150e6]))
    maps.write_text("one two\n")
    with pytest.raises(InputError, match=r"lowres_maps\.txt: cannot be read as a table of numbers"):
        read_gsm2016(folder, np.array([150e6]))
    maps.unlink()
    with pytest.raises(InputError, match=r"\[sky\] diffuse: no such file"):
        read_gsm2016(folder, np.array([150e6]))


def test_the_real_sky_has_the_known_temperatures():
    data = Path(os.environ.get("HYDRABEAM_DATA", Path(__file__).parents[3] / "shared" / "data"))
    folder = data / "models" / "gsm2016"
    if not folder.exists():
        pytest.skip(f"{folder} is not here")
    freqs = np.array([150e6, 408e6])
    sky = read_gsm2016(folder, freqs)
    pixel_area = 4 * np.pi / NPIX * units.sr
    kelvin = np.stack(
        [
            (flux * units.Jy / pixel_area).to_value("K", units.brightness_temperature(freq * units.Hz))
            for flux, freq in zip(sky.flux, freqs, strict=True)
        ]
    )
    # The 408 MHz all-sky survey has a mean of about 34 K; synchrotron steepens as nu^-2.4 to nu^-2.6.
    assert kelvin[1].mean() == pytest.approx(34, abs=1.5)
    assert -2.6 < np.log(kelvin[0].mean() / kelvin[1].mean()) / np.log(150 / 408) < -2.3
    latitude = np.abs(SkyCoord(sky.ra, sky.dec, unit="rad").galactic.b.deg)
    assert kelvin[0][latitude < 5].mean() > 4 * kelvin[0][latitude > 60].mean()
    # Nowhere brighter than towards the galactic centre, Sgr A* at 17h45.7m -29.0 deg.
    brightest = np.argmax(kelvin[0])
    assert np.rad2deg(sky.ra[brightest]) == pytest.approx(266.4, abs=2)
    assert np.rad2deg(sky.dec[brightest]) == pytest.approx(-29.0, abs=2)
