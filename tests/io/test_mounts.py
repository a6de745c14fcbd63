"""Antennas that follow the sky are refused, where a file says so and they are used."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from astropy.io import fits

from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.mounts import TRACKING, UNSET
from hydrabeam_mpi.io.uvmeta import read_observation
from tests.visibilities import NUMBERS, make_uvdata


def written(path: Path, *mounts: str) -> Path:
    """Write data of antennas with these mounts; the last one holds for all others."""
    uv = make_uvdata()
    uv.telescope.mount_type = [*mounts, *[mounts[-1]] * (len(NUMBERS) - len(mounts))]
    uv.write_uvh5(str(path), clobber=True)
    return path


@pytest.mark.parametrize("mount", [one for one in TRACKING if one != UNSET])
def test_an_antenna_in_use_that_follows_the_sky_is_refused(mount: str, tmp_path: Path) -> None:
    path = written(tmp_path / "a.uvh5", "fixed", mount, "fixed")
    with pytest.raises(
        InputError, match=rf'a\.uvh5: mount_type: antenna 7 is on a mount .* \("{re.escape(mount)}"\).*; if it stood'
    ):
        read_observation([path], Selection())
    assert read_observation([path], Selection(exclude_antennas=(7,))).doubts == ()


def test_one_that_stands_still_or_of_which_nothing_is_said_passes(tmp_path: Path) -> None:
    for mount in ("fixed", "other"):
        assert read_observation([written(tmp_path / "a.uvh5", mount)], Selection()).doubts == ()
    uv = make_uvdata(x_orientation=None)
    uv.telescope.mount_type = uv.telescope.feed_array = uv.telescope.feed_angle = None
    uv.write_uvh5(str(tmp_path / "silent.uvh5"), run_check=False)
    assert read_observation([tmp_path / "silent.uvh5"], Selection()).doubts == ()


def test_of_a_mount_that_files_have_where_nobody_set_one_a_line_tells(tmp_path: Path) -> None:
    (doubt,) = read_observation([written(tmp_path / "a.uvh5", "fixed", UNSET)], Selection()).doubts
    assert f'follow the sky ("{UNSET}")' in doubt


def test_of_steered_ones_the_pointing_must_stay(tmp_path: Path) -> None:
    (doubt,) = read_observation([written(tmp_path / "a.uvh5", "fixed", "phased")], Selection()).doubts
    assert "of one pointing" in doubt


@pytest.mark.filterwarnings("ignore")  # pyuvdata's, of what the format does not tell
def test_uvfits_of_others_says_so_of_all(tmp_path: Path) -> None:
    """0 is alt-az, and what nobody has set."""
    uv = make_uvdata()
    uv.phase(lon=1.3, lat=-0.6, cat_name="somewhere", phase_frame="icrs")
    uv.telescope.mount_type = ["alt-az"] * len(NUMBERS)
    uv.write_uvfits(str(tmp_path / "a.uvfits"))
    with fits.open(tmp_path / "a.uvfits") as file:
        assert set(file["AIPS AN"].data["MNTSTA"]) == {0}
    (doubt,) = read_observation([tmp_path / "a.uvfits"], Selection()).doubts
    assert 'follow the sky ("alt-az")' in doubt
