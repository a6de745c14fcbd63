import warnings

import numpy as np
import pytest
from astropy import units
from astropy.coordinates import AltAz, EarthLocation, SkyCoord
from astropy.time import Time

from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.model.engines.fringes import enu
from hydrabeam_mpi.model.positions import ApparentPositions, ManyDirections, RotatedPositions, count_above_horizon
from hydrabeam_mpi.model.sky import Sky, mock_sky

HERA = EarthLocation.from_geodetic(21.42830 * units.deg, -30.72152 * units.deg, 1051.69 * units.m)
FREQS = np.array([131e6])
ARCSEC = np.deg2rad(1 / 3600)
JD_2017, JD_2025, JD_2050 = 2458042.60288, 2460700.25, 2469807.5


def observation(times=(JD_2017,), lsts=None):
    times = np.asarray(times, dtype=float)
    if lsts is None:
        lsts = Time(times, format="jd", scale="utc", location=HERA).sidereal_time("apparent").rad
    return Observation(
        telescope_name="HERA",
        location=HERA,
        antenna_numbers=np.arange(2),
        antenna_names=("a", "b"),
        antpos=np.array([[0.0, 0.0, 0.0], [14.6, 0.0, 0.0]]),
        antpairs=np.array([[0, 1]]),
        freqs=FREQS,
        channel_width=np.array([1e5]),
        times=times,
        lsts=np.asarray(lsts),
        integration_time=np.full(len(times), 10.0),
        pols=("ee",),
    )


def astropy_enu(sky, jd):
    """Directions by astropy's own transformation, (3, Nsrc), whole sphere."""
    frame = AltAz(obstime=Time(jd, format="jd", scale="utc"), location=HERA)
    altaz = SkyCoord(sky.ra, sky.dec, unit="rad", frame="icrs").transform_to(frame)
    north, east, up = altaz.cartesian.xyz.value
    return np.stack([east, north, up])


def angles(a, b):
    """Angles between unit vectors, stable where they are small."""
    return 2 * np.arcsin(np.minimum(np.linalg.norm(a - b, axis=0) / 2, 1))


@pytest.mark.parametrize("jd", [JD_2017, JD_2017 + 0.3, JD_2017 + 0.6, JD_2025, JD_2025 + 0.4])
def test_apparent_positions_agree_with_astropy_altaz(jd):
    sky = mock_sky(1, FREQS, n_sources=5000)
    index, za, az = ApparentPositions(sky, observation([JD_2017, jd])).above_horizon(1)
    expected = astropy_enu(sky, jd)
    assert angles(enu(za, az), expected[:, index]).max() < 1e-3 * ARCSEC
    assert za.max() <= np.pi / 2
    # Those left out are exactly those below the horizon.
    np.testing.assert_array_equal(index, np.flatnonzero(expected[2] >= 0))


def test_azimuth_runs_from_east_through_north():
    lst = observation().lsts[0]
    # On the equator six hours before the meridian, beyond the pole, and at the south pole.
    ra = np.array([lst + 1.5, lst, lst])
    dec = np.deg2rad([0.0, 50.0, -90.0])
    _, _, az = ApparentPositions(Sky(ra, dec, np.ones((1, 3))), observation()).above_horizon(0)
    np.testing.assert_allclose(az, [0.04, np.pi / 2, 1.5 * np.pi], atol=0.01)


def test_dates_past_the_earth_orientation_table_warn_and_go_on():
    sky = mock_sky(1, FREQS, n_sources=200)
    with pytest.warns(Warning, match="polar motions"):
        positions = ApparentPositions(sky, observation([JD_2050], lsts=[0.0]))
    index, za, az = positions.above_horizon(0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        expected = astropy_enu(sky, JD_2050)
    assert angles(enu(za, az), expected[:, index]).max() < 1e-3 * ARCSEC


def test_rotated_positions_agree_with_rotation_matrices():
    sky = mock_sky(2, FREQS, n_sources=2000)
    lsts = np.array([0.3, 5.9])
    positions = RotatedPositions(sky, observation([JD_2017, JD_2017 + 0.1], lsts))
    celestial = np.stack([np.cos(sky.dec) * np.cos(sky.ra), np.cos(sky.dec) * np.sin(sky.ra), np.sin(sky.dec)])
    lat = HERA.lat.rad
    for itime, lst in enumerate(lsts):
        east = np.array([-np.sin(lst), np.cos(lst), 0])
        up = np.array([np.cos(lat) * np.cos(lst), np.cos(lat) * np.sin(lst), np.sin(lat)])
        expected = np.stack([east, np.cross(up, east), up]) @ celestial
        index, za, az = positions.above_horizon(itime)
        np.testing.assert_allclose(enu(za, az), expected[:, index], atol=1e-14)
        np.testing.assert_array_equal(index, np.flatnonzero(expected[2] >= 0))


def test_rotated_and_apparent_positions_differ_by_precession_and_aberration_only():
    sky = mock_sky(2, FREQS, n_sources=2000)
    rotated = RotatedPositions(sky, observation())
    apparent = ApparentPositions(sky, observation())
    (i, *at_i), (j, *at_j) = rotated.above_horizon(0), apparent.above_horizon(0)
    _, in_i, in_j = np.intersect1d(i, j, return_indices=True)
    shift = angles(enu(*at_i)[:, in_i], enu(*at_j)[:, in_j])
    # 50.3 arcsec a year since 2000, and up to 20.5 arcsec of aberration and 17 of nutation.
    precession = 17.8 * 50.3 * ARCSEC
    assert 0.1 * precession < np.median(shift) < shift.max() < precession + 40 * ARCSEC


def test_zenith_keeps_full_precision():
    sky = Sky(np.array([1.0]), np.array([HERA.lat.rad + 1e-9]), np.ones((1, 1)))
    _, za, az = RotatedPositions(sky, observation(lsts=[1.0])).above_horizon(0)
    assert za[0] == pytest.approx(1e-9, rel=1e-6)
    assert az[0] == pytest.approx(np.pi / 2)


def test_a_sky_that_never_rises_gives_no_sources():
    sky = Sky(np.array([1.0]), np.array([1.5]), np.ones((1, 1)))
    for positions in RotatedPositions(sky, observation()), ApparentPositions(sky, observation()):
        index, za, az = positions.above_horizon(0)
        assert len(index) == len(za) == len(az) == 0


@pytest.mark.parametrize("rule", [ApparentPositions, RotatedPositions])
def test_another_sky_is_followed_by_the_same_rule(rule):
    one, two = mock_sky(1, FREQS, n_sources=50), mock_sky(2, FREQS, n_sources=70)
    observed = observation([JD_2017, JD_2017 + 0.3])
    followed, direct = rule(one, observed).follow(two), rule(two, observed)
    for time in range(2):
        for a, b in zip(followed.above_horizon(time), direct.above_horizon(time), strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("rule", [ApparentPositions, RotatedPositions])
def test_many_directions_are_turned_to_where_each_is(rule):
    """Months apart, between which the aberration changes by 20 arc seconds; beside the Sun its light is deflected."""
    sky, other = mock_sky(1, FREQS, n_sources=5000), mock_sky(2, FREQS, n_sources=5)
    positions = rule(other, observation([JD_2017, JD_2017 + 0.6, JD_2025 + 0.3]))
    every = ManyDirections(positions, sky)
    for itime in range(3):
        exact, za, az = positions.follow(sky).above_horizon(itime)
        index, directions = every.above_horizon(itime)
        np.testing.assert_array_equal(index, exact)
        off = angles(directions, enu(za, az))
        assert np.median(off) < 0.01 * ARCSEC
        assert off.max() < 1 * ARCSEC


def test_count_above_horizon_follows_the_true_counts():
    times = JD_2017 + np.linspace(0, 1, 8)
    dense_south = mock_sky(7, FREQS, n_sources=20_000)
    dense_south = dense_south.select((dense_south.dec < -0.3) | (dense_south.ra < 2.0))
    exact = np.array([len(RotatedPositions(dense_south, observation(times)).above_horizon(i)[0]) for i in range(8)])
    assert np.ptp(exact) > 0.2 * exact.mean()
    np.testing.assert_allclose(count_above_horizon(dense_south, observation(times)), exact, rtol=0.1)
    few = dense_south.select(np.arange(500))
    exact_few = [len(RotatedPositions(few, observation(times)).above_horizon(i)[0]) for i in range(8)]
    np.testing.assert_array_equal(count_above_horizon(few, observation(times)), exact_few)


@pytest.mark.parametrize("most", [0, 1500, 10**6])
def test_places_that_are_asked_for_again_are_the_same(most, monkeypatch):
    """Whether there is room to keep those of none, one or both of the times; another sky has places of its own."""
    monkeypatch.setattr("hydrabeam_mpi.model.positions.MOST_KEPT", most)
    sky = mock_sky(1, FREQS, n_sources=1000)
    positions = ApparentPositions(sky, observation([JD_2017, JD_2025]))
    for below in (0.0, 0.1):
        first = [positions.above_horizon(itime, below) for itime in (0, 1)]
        for _ in range(2):
            for itime in (0, 1):
                for one, again in zip(first[itime], positions.above_horizon(itime, below), strict=True):
                    np.testing.assert_array_equal(again, one)
    assert sum(len(za) for _, za in positions._kept.values()) == min(most // 1000, 2) * 1000
    other = Sky(sky.ra[:10], sky.dec[:10], sky.flux[:, :10])
    _, za, _ = positions.follow(other).above_horizon(0, np.pi / 2)
    np.testing.assert_array_equal(za, positions.above_horizon(0, np.pi / 2)[1][:10])
