from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.posterior_file import (
    ChannelRecord,
    PosteriorFile,
    read_covariance,
    read_posterior,
    write_posterior,
)

N = 5


def arrays(seed: int, dtype: type) -> dict[str, Any]:
    rng = np.random.default_rng(seed)

    def draw(*shape: int) -> Any:
        real = rng.standard_normal(shape)
        return real + 1j * rng.standard_normal(shape) if dtype is complex else real

    return {
        "mean": draw(N),
        "covariance": draw(N, N) + 9 * np.eye(N),
        "std": np.abs(draw(N)),
        "prior_mean": draw(N),
        "prior_std": np.full(N, np.inf),
        "draws": draw(0, N),
        "map_mean": draw(91, 360),
        "z_counts": rng.integers(9, size=(2, 7)),
    }


def written(path: Path, dtype: type = complex) -> PosteriorFile:
    """Write three channels, of which the middle one had a flat prior."""
    channels = [
        ChannelRecord(131e6 + i * 97656.25, {"n_data": i, "warning": "α"}, arrays(i, dtype), [1.5, None, -2e5][i])
        for i in range(3)
    ]
    # As many modes as all of the default basis have: far beyond the 64 KiB that an HDF5 attribute may have in place.
    basis = {"kind": "fourier-bessel", "modes": [[k, m] for k in range(1, 81) for m in range(-45, 46)]}
    provenance = {"ranks": 2, "sha256": {f"/data/{i:060d}.uvh5": "0" * 64 for i in range(1000)}}
    content = PosteriorFile(basis, provenance, "ee", np.linspace(0, 1, 91), np.linspace(0, 6, 360), channels)
    write_posterior(path, content)
    return content


@pytest.mark.parametrize("dtype", [float, complex])
def test_round_trip(dtype: type, tmp_path: Path) -> None:
    path = tmp_path / "posterior.h5"
    content = written(path, dtype)
    back = read_posterior(path)
    assert back.basis == content.basis
    assert back.provenance == content.provenance
    assert back.polarization == "ee"
    np.testing.assert_array_equal(back.grid_za, content.grid_za)
    np.testing.assert_array_equal(back.grid_az, content.grid_az)
    assert len(back.channels) == 3
    for number, (found, expected) in enumerate(zip(back.channels, content.channels, strict=True)):
        assert found.freq == expected.freq
        assert found.summary == expected.summary
        assert found.log_evidence == expected.log_evidence
        assert type(found.log_evidence) is type(expected.log_evidence)
        assert found.arrays.keys() == expected.arrays.keys() - {"covariance"}
        for name, array in found.arrays.items():
            np.testing.assert_array_equal(array, expected.arrays[name])
            assert array.dtype == expected.arrays[name].dtype
        np.testing.assert_array_equal(read_covariance(path, number), expected.arrays["covariance"])


def test_layout_is_that_of_the_documentation(tmp_path: Path) -> None:
    written(tmp_path / "posterior.h5")
    with h5py.File(tmp_path / "posterior.h5") as file:
        assert set(file.attrs) == {"format", "basis", "provenance", "polarization", "telescope_name"}
        assert set(file) == {"grid_za", "grid_az", "channel_0000", "channel_0001", "channel_0002"}
        assert set(file["channel_0000"].attrs) == {"freq", "summary", "log_evidence"}
        assert set(file["channel_0001"].attrs) == {"freq", "summary"}


def no_file(path: Path) -> None:
    path.unlink()


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:5000])


def text(path: Path) -> None:
    path.write_text("no posterior")


def drop_basis(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file.attrs["basis"]


def spoil_summary(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file["channel_0001"].attrs["summary"] = "{"


def drop_prior(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file["channel_0001/prior_std"]


def no_number(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file["channel_0001/map_mean"][3, 4] = np.nan


def no_spread(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file["channel_0001/std"][1] = 0


@pytest.mark.parametrize(
    "spoil", [no_file, truncate, text, drop_basis, spoil_summary, drop_prior, no_number, no_spread]
)
def test_what_is_no_posterior_is_refused(spoil: Any, tmp_path: Path) -> None:
    path = tmp_path / "posterior.h5"
    written(path)
    spoil(path)
    with pytest.raises(InputError, match=r"posterior.h5: .*; name a folder written by"):
        read_posterior(path)


def test_a_variance_that_is_not_positive_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "posterior.h5"
    written(path)
    with h5py.File(path, "r+") as file:
        file["channel_0001/covariance"][2, 2] = -1
    read_covariance(path, 0)
    with pytest.raises(
        InputError, match=r"posterior.h5: channel_0001/covariance: holds a variance that is not positive"
    ):
        read_covariance(path, 1)
