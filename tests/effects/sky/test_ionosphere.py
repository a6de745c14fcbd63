from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.sky.ionosphere import Ionosphere
from tests.effects.direct import assert_same, visibilities
from tests.effects.small import small_block, small_setup, with_effect


@pytest.mark.parametrize("towards", [0, 1])
def test_visibilities_are_those_of_a_shifted_sky(towards: int) -> None:
    """Plane trigonometry in the vertical plane of the shift, which goes as the wavelength squared."""
    setup = small_setup()
    arcmin = 10.0 + np.arange(6)
    x = np.zeros((6, 2))
    x[:, towards] = arcmin
    for channel, freq in enumerate((131e6, 151e6)):
        block = small_block(setup, channel)
        effect = Ionosphere()
        block.integrate_for([effect])

        def shift(directions: FloatArray, itime: int, freq: float = freq) -> FloatArray:
            angle = np.deg2rad(arcmin[itime] / 60) * (141e6 / freq) ** 2
            shifted = directions.copy()
            shifted[towards] = np.cos(angle) * directions[towards] + np.sin(angle) * directions[2]
            shifted[2] = np.cos(angle) * directions[2] - np.sin(angle) * directions[towards]
            return shifted

        assert_same(with_effect(effect, block, x.ravel()), visibilities(block, turn=shift), block)


def test_times_are_told_apart_in_any_order() -> None:
    setup = replace(small_setup(), times=np.array([4, 0, 2]))
    block = replace(small_block(setup), times=np.array([0, 4]))
    effect = Ionosphere()
    block.integrate_for([effect])
    columns = effect.columns(block, np.zeros(6))
    assert columns.n_params == 6
    assert columns.index is not None
    assert columns.index[:, 0].tolist() == [[2, 3], [0, 1]]
    names = effect.parameters(setup).names
    assert names[0].endswith(f"{setup.observation.times[4]:.5f}")
    change = effect.added(block, np.array([0.0, 0.0, 1.0, 0.0, 5.0, 0.0]))
    assert change[0].all()
    assert not change[1].any()
