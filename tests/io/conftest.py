import pytest

from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.io.uvdata import read_observation, read_visibilities
from tests.visibilities import whole


@pytest.fixture
def read(tmp_path):
    """Function that writes visibilities and reads them, ``obs, flags, nsamples, [path] = read(uv)``."""

    def read(uv, selection=None, name="a.uvh5"):
        (tmp_path / name).unlink(missing_ok=True)
        uv.write_uvh5(str(tmp_path / name), run_check=False)
        files = [tmp_path / name]
        obs = read_observation(files, selection or Selection())
        _, flags, nsamples = read_visibilities(files, obs, whole(obs))
        return obs, flags, nsamples, files

    return read
