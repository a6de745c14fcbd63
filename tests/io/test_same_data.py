"""Data are known again in another file, and none are that are others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyuvdata import UVData

from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.io import same_data
from hydrabeam_mpi.io.same_data import integration_checksums
from hydrabeam_mpi.io.uvmeta import read_observation
from tests.visibilities import NUMBERS, TIMES, make_uvdata


def checksums(path: Path, **selection: Any) -> set[str]:
    found = integration_checksums([path], read_observation([path], Selection(pols=("ee",), **selection)))
    assert len(set(found)) == len(found)
    return set(found)


def saved(uvd: UVData, path: Path) -> Path:
    uvd.write_uvh5(str(path), clobber=True)
    return path


@pytest.fixture
def uvd() -> UVData:
    return make_uvdata()


def test_order_orientation_precision_flags_and_autos_do_not_count(uvd: UVData, tmp_path: Path) -> None:
    own = checksums(saved(uvd, tmp_path / "own.uvh5"))
    assert len(own) == len(TIMES) * uvd.Nfreqs
    uvd.conjugate_bls("ant2<ant1")
    uvd.reorder_blts("baseline")
    uvd.select(ant_str="cross")
    uvd.flag_array[::3] = True
    uvd.data_array = uvd.data_array.astype(np.complex64)
    assert checksums(saved(uvd, tmp_path / "copy.uvh5")) == own


@pytest.mark.parametrize("pols", [("ee", "nn", "en", "ne"), ("en", "ne"), ("ne", "ee")])
def test_orientation_does_not_count_of_cross_hands_either(pols: tuple[str, ...], tmp_path: Path) -> None:
    """Turned, "en" is "ne"; a file that is asked for one of the two has other data in the other orientation."""
    uvd = make_uvdata(pols=(-5, -6, -7, -8))
    found = []
    for name, order in (("one", "ant1<ant2"), ("other", "ant2<ant1")):
        uvd.conjugate_bls(order)
        path = saved(uvd, tmp_path / f"{name}.uvh5")
        found.append(set(integration_checksums([path], read_observation([path], Selection(pols=pols)))))
    assert len(found[0]) == len(TIMES) * uvd.Nfreqs
    assert (found[0] == found[1]) == (pols != ("ne", "ee"))


def test_parts_of_the_data_are_parts(uvd: UVData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where a file is read a few integrations at a time."""
    path = saved(uvd, tmp_path / "own.uvh5")
    own = checksums(path)
    monkeypatch.setattr(same_data, "WINDOW_BYTES", 2000)
    assert checksums(path) == own
    observation = read_observation([path], Selection(pols=("ee",)))
    shared = [integration_checksums([path], observation, part, 3) for part in range(3)]
    assert all(shared)
    assert sorted(one for part in shared for one in part) == sorted(own)
    some = checksums(path, time_range=(TIMES[1], TIMES[3]), exclude_antennas=NUMBERS[:1])
    assert some < own
    assert len(some) == 3 * uvd.Nfreqs
    uvd.select(freq_chans=[2], times=TIMES[:2])
    assert checksums(saved(uvd, tmp_path / "channel.uvh5")) < own


def test_what_differs_is_not_the_same(uvd: UVData, tmp_path: Path) -> None:
    own = checksums(saved(uvd, tmp_path / "own.uvh5"))
    uvd.data_array[np.flatnonzero(uvd.baseline_array == uvd.antnums_to_baseline(3, 7))[0], 1, 0] *= 1 + 1e-6
    assert len(own - checksums(saved(uvd, tmp_path / "changed.uvh5"))) == 1
    uvd.data_array[uvd.time_array == TIMES[2]] = 0
    assert len(checksums(saved(uvd, tmp_path / "dead.uvh5"))) == len(own) - uvd.Nfreqs
    assert own.isdisjoint(checksums(saved(make_uvdata(seed=2), tmp_path / "other.uvh5")))
