"""Rows of one file, of every format."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.io.uvfile import read_metadata
from hydrabeam_mpi.io.uvformat import FORMATS
from hydrabeam_mpi.io.uvrows import SEEK_BYTES, WINDOW_BYTES, _windows, read_samples
from tests.visibilities import ENU, SECOND, make_uvdata


def written(uv, path: Path) -> Path:
    uv.write_uvh5(str(path), run_check=False)
    return path


def test_rows_come_in_the_order_asked(tmp_path):
    uv = make_uvdata()
    header, _ = read_metadata(written(uv, tmp_path / "a.uvh5"))
    rows, channels, pols = np.array([40, 3, 17]), np.array([3, 0]), np.array([1, 0])
    data, flags, nsamples = read_samples(header, rows, channels, pols)
    part = np.ix_(rows, channels, pols)
    np.testing.assert_array_equal(data, uv.data_array[part])
    np.testing.assert_array_equal(flags, uv.flag_array[part])
    np.testing.assert_array_equal(nsamples, uv.nsample_array[part])


@pytest.mark.parametrize(
    ("stated", "given", "factor"),
    [
        ("avg", None, 0.5),
        ("avg", "avg", 0.5),
        ("avg", "sum", 0.5),
        ("sum", None, 1.0),
        ("sum", "avg", 1.0),
        (None, None, 1.0),
        (None, "sum", 1.0),
        (None, "avg", 0.5),
    ],
)
def test_convention_of_polarisation_is_one_half_of_i(tmp_path, stated, given, factor):
    """What the file states counts, else what is given; "avg" is halved once."""
    uv = make_uvdata()
    uv.pol_convention = stated
    header, _ = read_metadata(written(uv, tmp_path / "a.uvh5"))
    data, _, _ = read_samples(header, np.arange(5), np.arange(4), np.arange(2), given)
    np.testing.assert_array_equal(data, factor * uv.data_array[:5])


@pytest.mark.parametrize(
    ("kind", "phased"),
    # pyuvdata writes uvfits and measurement sets phased only.
    [(kind, phased) for kind in FORMATS for phased in (False, True) if phased or kind not in ("uvfits", "ms")],
)
@pytest.mark.filterwarnings("ignore:UVData object contains a mix", "ignore:writing default values")
def test_every_format_gives_the_same_drift_scan(tmp_path, kind, phased):
    if kind == "ms":
        pytest.importorskip("casacore", reason="measurement sets need python-casacore")
    uv = make_uvdata()
    other = uv.copy()
    if phased:
        other.phase(lon=1.3, lat=-0.6, cat_name="somewhere", phase_frame="icrs")
    path = tmp_path / "file"  # told by content, not by name
    getattr(other, f"write_{kind}")(str(path))
    header, rows = read_metadata(path)
    assert header.kind == kind
    assert header.pols == ("ee", "nn")
    np.testing.assert_allclose(header.freqs, uv.freq_array, rtol=0, atol=1e-3)
    # These formats store the absolute positions of antennas, or times, in other ways.
    np.testing.assert_allclose(header.antpos[:5], ENU, rtol=0, atol=1e-12 if kind == "uvh5" else 1e-8)
    np.testing.assert_allclose(np.unique(rows.times), np.unique(uv.time_array), rtol=0, atol=1e-4 * SECOND)
    data, flags, nsamples = read_samples(header, np.arange(len(rows.times)), np.arange(4), np.arange(2))
    # Measurement sets and miriad files are written with the lower antenna number first.
    stored = {key: row for row, key in enumerate(row_keys(rows.times, rows.antpairs))}
    assert len(stored) == len(rows.times) == uv.Nblts
    for row, (step, ant_1, ant_2) in enumerate(
        row_keys(uv.time_array, np.stack([uv.ant_1_array, uv.ant_2_array], axis=1))
    ):
        turned = (step, ant_1, ant_2) not in stored
        here = stored[(step, ant_2, ant_1) if turned else (step, ant_1, ant_2)]
        np.testing.assert_array_equal(flags[here], uv.flag_array[row])
        np.testing.assert_allclose(nsamples[here], uv.nsample_array[row], rtol=1e-6)
        found = data[here].conj() if turned else data[here]
        # Single precision, and coarser flux of autocorrelations (1000 Jy) than of the rest.
        tolerance = 1e-6 * abs(uv.data_array[row]).max() if kind in ("ms", "miriad") else 1e-9
        np.testing.assert_allclose(found, uv.data_array[row], rtol=0, atol=tolerance)


@pytest.mark.filterwarnings("ignore:UVData object contains a mix", "ignore:writing default values")
def test_a_measurement_set_with_one_channel(tmp_path):
    pytest.importorskip("casacore", reason="measurement sets need python-casacore")
    uv = make_uvdata()
    one = uv.select(freq_chans=[1], inplace=False)
    one.phase(lon=1.3, lat=-0.6, cat_name="somewhere", phase_frame="icrs")
    one.write_ms(str(tmp_path / "one.ms"))
    header, rows = read_metadata(tmp_path / "one.ms")
    np.testing.assert_allclose(header.freqs, uv.freq_array[1], rtol=0, atol=1e-3)
    data, flags, _ = read_samples(header, np.arange(len(rows.times)), np.arange(1), np.arange(2))
    assert data.shape == flags.shape == (uv.Nblts, 1, 2)
    assert np.abs(data).max() > 0


def row_keys(times, antpairs):
    steps = np.round((times - times[0]) / (10 * SECOND)).astype(int)
    return list(zip(steps.tolist(), *antpairs.T.tolist(), strict=True))


def test_scattered_rows(tmp_path):
    uv = make_uvdata(times=2459866.2 + 10 * SECOND * np.arange(50))
    header, _ = read_metadata(written(uv, tmp_path / "a.uvh5"))
    rng = np.random.default_rng(3)
    # Densely enough to be read in line, and so sparsely that each is picked.
    for n_rows in (300, 2):
        rows = np.r_[0, rng.choice(uv.Nblts - 2, n_rows, replace=False) + 1, uv.Nblts - 1]
        data, flags, nsamples = read_samples(header, rows, np.array([2]), np.array([1, 0]))
        np.testing.assert_array_equal(data, uv.data_array[rows][:, [2], ::-1])
        np.testing.assert_array_equal(flags, uv.flag_array[rows][:, [2], ::-1])
        np.testing.assert_array_equal(nsamples, uv.nsample_array[rows][:, [2], ::-1])


@pytest.mark.parametrize("row_bytes", [21, 4000, 10**6, 10**9])
def test_windows_hold_all_rows_and_little_else(row_bytes):
    rng = np.random.default_rng(3)
    rows = np.flatnonzero(rng.random(100_000) < 0.3)
    windows = list(_windows(rows, row_bytes))
    np.testing.assert_array_equal(np.concatenate([read[wanted] for read, wanted in windows]), rows)
    extra = sum(len(read) for read, _ in windows) - len(rows)
    assert extra * row_bytes <= len(rows) * SEEK_BYTES
    assert len(windows) >= min(len(rows) * row_bytes // WINDOW_BYTES, len(rows))
    assert max(len(read) for read, _ in windows) <= max(WINDOW_BYTES / row_bytes, 1)
