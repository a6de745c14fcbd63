from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io import uvsummary
from hydrabeam_mpi.io.uvsummary import summarise
from tests.visibilities import CROSS, NUMBERS, SECOND, make_uvdata


@pytest.mark.parametrize("window_bytes", [64_000_000, 500], ids=["at once", "in many parts"])
def test_flags_of_all_files_count(window_bytes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uvsummary, "WINDOW_BYTES", window_bytes)
    paths = []
    for night in range(2):
        uv = make_uvdata(times=2459866.2 + night + 10 * SECOND * np.arange(5), seed=night)
        cross = uv.ant_1_array != uv.ant_2_array
        uv.flag_array[:, 1] = True
        uv.flag_array[cross & ((uv.ant_1_array == 20) | (uv.ant_2_array == 20))] = True
        if night == 0:
            uv.flag_array[:, 3] = True
            uv.flag_array[cross & ((uv.ant_1_array == 41) | (uv.ant_2_array == 41))] = True
            # Without weight, which is as good as a flag.
            uv.nsample_array[:, 0] = 0
        else:
            uv.flag_array[cross, 0] = True
            uv.flag_array[np.flatnonzero((uv.ant_1_array == 7) & (uv.ant_2_array == 41))[-1], 0] = False
        paths.append(tmp_path / f"{night}.uvh5")
        uv.write_uvh5(paths[-1], run_check=False)
    summary = summarise(paths)
    assert summary.pol == "ee"
    np.testing.assert_array_equal(summary.flagged_channels, [False, True, False, False])
    assert summary.flagged_antennas == (20,)
    assert summary.nsamples == (0.25, 2.0)
    assert summary.has_autos
    assert summary.units == ("Jy",)
    assert summary.observation.Ntimes == 10


@pytest.mark.parametrize(("lacking", "has_autos"), [(41, False), (20, True)])
def test_autocorrelations_of_unflagged_antennas_count(lacking: int, has_autos: bool, tmp_path: Path) -> None:
    uv = make_uvdata(antpairs=CROSS + tuple((ant, ant) for ant in NUMBERS if ant != lacking))
    uv.flag_array[(uv.ant_1_array == 20) | (uv.ant_2_array == 20)] = True
    uv.write_uvh5(tmp_path / "a.uvh5", run_check=False)
    assert summarise([tmp_path / "a.uvh5"]).has_autos == has_autos


def test_infinite_nsamples_are_refused(tmp_path: Path) -> None:
    uv = make_uvdata()
    uv.nsample_array[2, 0, 0] = np.inf
    uv.flag_array[2, 0, 0] = False
    uv.write_uvh5(tmp_path / "a.uvh5", run_check=False)
    with pytest.raises(InputError, match=r"a.uvh5: nsample_array: unflagged values that are not finite; flag them"):
        summarise([tmp_path / "a.uvh5"])
