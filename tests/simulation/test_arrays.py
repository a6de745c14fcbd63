from pathlib import Path

import numpy as np
import pytest
from astropy.coordinates import EarthLocation
from pyuvdata import UVData, utils
from pyuvdata.telescopes import Telescope

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.simulation.arrays import hexagon, read_layout


def unique_vectors(antpos):
    i, j = np.triu_indices(len(antpos), 1)
    vectors = np.round(antpos[j] - antpos[i], 6)
    sign = np.where((vectors[:, 1] < 0) | ((vectors[:, 1] == 0) & (vectors[:, 0] < 0)), -1, 1)
    return np.unique(sign[:, np.newaxis] * vectors + 0.0, axis=0)


def test_hexagon_of_the_paper():
    layout = hexagon(4, 7, 14.6)
    assert layout.antpos.shape == (37, 3)
    np.testing.assert_array_equal(layout.numbers, np.arange(37))
    assert len(set(layout.names)) == 37
    vectors = unique_vectors(layout.antpos)
    assert len(vectors) == 63
    lengths = np.linalg.norm(vectors, axis=1)
    # Three nearest-neighbour directions at 60 degrees, one of them East; the diagonal spans 6 spacings.
    assert np.sum(np.isclose(lengths, 14.6)) == 3
    assert lengths.min() == pytest.approx(14.6)
    assert lengths.max() == pytest.approx(6 * 14.6)
    assert np.any(np.all(np.isclose(vectors, [14.6, 0, 0]), axis=1))
    np.testing.assert_allclose(layout.antpos.mean(axis=0), 0, atol=1e-12)


@pytest.mark.parametrize(("side", "diagonal", "count"), [(1, 1, 1), (2, 3, 7), (3, 5, 19), (3, 4, 10), (11, 21, 331)])
def test_hexagon_sizes(side, diagonal, count):
    assert len(hexagon(side, diagonal, 14.6).antpos) == count


def test_impossible_hexagon_is_refused():
    with pytest.raises(InputError, match=r"hex: .*does not exist; give"):
        hexagon(4, 3, 14.6)


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "array.csv"
    path.write_text(text)
    return path


def test_plain_columns(tmp_path):
    layout = read_layout(write(tmp_path, "# metres\n0 0 0\n14.6 0 0\n\n7.3 12.64 0.1\n"))
    np.testing.assert_array_equal(layout.antpos, [[0, 0, 0], [14.6, 0, 0], [7.3, 12.64, 0.1]])
    np.testing.assert_array_equal(layout.numbers, [0, 1, 2])


@pytest.mark.parametrize("separator", [",", ", ", "  ", "\t"])
def test_named_columns_in_any_order(tmp_path, separator):
    rows = [
        ["Name", "Number", "BeamID", "U", "E", "N"],
        ["HH7", "7", "0", "0.5", "1.5", "-2"],
        ["HH3", "3", "0", "0", "3", "4"],
    ]
    layout = read_layout(write(tmp_path, "\n".join(separator.join(row) for row in rows)))
    assert layout.names == ("HH7", "HH3")
    np.testing.assert_array_equal(layout.numbers, [7, 3])
    np.testing.assert_array_equal(layout.antpos, [[1.5, -2.0, 0.5], [3.0, 4.0, 0.0]])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "no antennas"),
        ("name e n\na 1 2\n", "U: the header lacks this column"),
        ("1 2\n", "2 columns, not 3: 1 2"),
        ("1 2 3\n1 2 nought\n", "not a number .*nought"),
        ("1 2 3\n1 2 nan\n", "antenna 1 has no position"),
        ("1 2 3\n1 2 1e20\n", "antenna 1 stands 1e.20 m from the middle of the array; give places on Earth"),
        ("1 2 3\n1 2 " + 5000 * "[", "not a number .*\\[ \\.\\.\\.; give columns"),
        ("number,e,n,u\n5,1,2,3\n5,2,2,3\n", "number: an antenna number stands twice"),
        ("number,e,n,u\n5,1,2,3\n6,2,2,3\n9,1,2,3\n", "antennas 5 and 9 stand in one place; give each its own"),
    ],
)
def test_bad_text_is_refused_with_the_file_named(tmp_path, text, complaint):
    path = write(tmp_path, text)
    with pytest.raises(InputError, match=complaint) as caught:
        read_layout(path)
    assert str(path) in str(caught.value)


def test_missing_and_binary_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_layout(tmp_path / "none.csv")
    (tmp_path / "binary").write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match="cannot be read as text or uvh5"):
        read_layout(tmp_path / "binary")


ENU = {11: [0.0, 0, 0], 12: [14.6, 0, 0.2], 13: [29.2, 0, 0], 14: [7.3, 12.6, 0]}


@pytest.fixture
def uvh5(tmp_path):
    """A file of four antennas, one of them (13) without data."""
    location = EarthLocation.from_geodetic(21.4283, -30.7215, 1051.7)
    itrs = utils.ECEF_from_ENU(np.array(list(ENU.values())), center_loc=location)
    offsets = itrs - np.array([axis.to_value("m") for axis in location.geocentric])
    uvd = UVData.new(
        freq_array=np.array([150e6]),
        polarization_array=["xx"],
        times=np.array([2458042.6]),
        antpairs=[(11, 12), (11, 14)],
        telescope=Telescope.new(
            name="somewhere",
            location=location,
            instrument="dishes",
            antenna_positions=dict(zip(ENU, offsets, strict=True)),
        ),
        empty=True,
        channel_width=1e5,
        integration_time=10.0,
    )
    path = tmp_path / "array.uvh5"
    uvd.write_uvh5(path)
    return path


def test_uvh5_gives_the_antennas_with_data(uvh5):
    layout = read_layout(uvh5)
    np.testing.assert_array_equal(layout.numbers, [11, 12, 14])
    np.testing.assert_allclose(layout.antpos, [ENU[11], ENU[12], ENU[14]], atol=1e-8)


def test_truncated_uvh5_is_refused(uvh5):
    uvh5.write_bytes(uvh5.read_bytes()[:3000])
    with pytest.raises(InputError, match="cannot be read as uvh5"):
        read_layout(uvh5)
