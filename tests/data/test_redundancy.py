import numpy as np
import pytest

from hydrabeam_mpi.config.simulation import Array, Simulate
from hydrabeam_mpi.data.redundancy import check_apart, check_tolerance, find_redundant_groups
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.simulation.mock import mock_observation


def hexagon_vectors(spacing=14.6):
    """All pairs of the 37-element hexagon, written out independently of the package."""
    positions = []
    for row in range(-3, 4):
        n = 7 - abs(row)
        north = row * spacing * np.sqrt(3) / 2
        positions += [((i - (n - 1) / 2) * spacing, north, 0.0) for i in range(n)]
    positions = np.array(positions)
    first, second = np.triu_indices(37, 1)
    return positions[second] - positions[first]


def test_the_hexagon_of_the_paper_has_63_unique_vectors():
    vectors = hexagon_vectors()
    groups = find_redundant_groups(vectors, 1e-7)
    assert len(vectors) == 666
    assert groups.Ngroups == 63
    signs = np.where(groups.flipped, -1, 1)[:, None]
    np.testing.assert_allclose(groups.vectors[groups.group] * signs, vectors, atol=1e-12)


def test_reversed_baselines_share_a_group_only_where_allowed():
    vectors = np.array([[10.0, 2.0, 0.1], [-10.0, -2.0, -0.1], [0.0, -5.0, 0.0], [0.0, 5.0, 0.0]])
    both = find_redundant_groups(vectors, 1e-6)
    assert both.group.tolist() == [0, 0, 1, 1]
    assert both.flipped.tolist() == [False, True, True, False]
    one = find_redundant_groups(vectors, 1e-6, either_sign=False)
    assert one.Ngroups == 4
    assert not one.flipped.any()


@pytest.mark.parametrize("east", [0.9e-3, 1.1e-3, -0.9e-3])
def test_jitter_around_the_sign_rule_does_not_split_a_group(east):
    rng = np.random.default_rng(3)
    vectors = np.array([east, 14.6, 0.0]) + rng.uniform(-4e-4, 4e-4, (40, 3))
    vectors[::2] *= -1
    groups = find_redundant_groups(vectors, 1e-3)
    assert groups.Ngroups == 1
    assert len(np.unique(groups.flipped[::2])) == len(np.unique(groups.flipped[1::2])) == 1
    assert groups.flipped[0] != groups.flipped[1]


def test_autocorrelation_is_its_own_group():
    groups = find_redundant_groups(np.array([[0.0, 0, 0], [5.0, 0, 0], [0.0, 0, 0]]), 1e-6)
    assert groups.group.tolist() == [0, 1, 0]
    assert not groups.flipped.any()


def test_tolerance_decides():
    vectors = np.array([[14.6, 0, 0], [14.6, 0.01, 0]])
    assert find_redundant_groups(vectors, 1e-3).Ngroups == 2
    assert find_redundant_groups(vectors, 2e-2).Ngroups == 1


def displaced(path, offset):
    """Observe at 150 MHz, 2 m, with three antennas in a row 14 m apart, the last of them displaced."""
    path.write_text(f"E,N,U\n0,0,0\n14,0,0\n{28 + offset},0,0\n")
    return mock_observation(Simulate(array=Array(file=path), freqs=(75e6, 150e6)), "ee")


@pytest.mark.parametrize(("offset", "right"), [(0.0, True), (1.9, True), (2.1, False)])
def test_a_group_sees_the_same_fringes(offset, right, tmp_path):
    """The mean of two baselines that differ by the offset is half of it away from either."""
    observation = displaced(tmp_path / "layout.csv", offset)
    groups = find_redundant_groups(observation.bl_vectors, 3.0)
    assert groups.Ngroups == 2
    if right:
        check_tolerance(observation, groups, 3.0)
        return
    said = r"\[data\] redundancy_tol: within 3 m baseline \d-\d counts as one that differs by 1.05 m, 0.53 wavelengths"
    with pytest.raises(InputError, match=said):
        check_tolerance(observation, groups, 3.0)


def test_antennas_stand_apart(tmp_path):
    observation = displaced(tmp_path / "layout.csv", -13.9)
    check_apart(observation, 0.09)
    with pytest.raises(InputError, match=r"antennas 1 and 2 stand in one place, within redundancy_tol = 0.11 m"):
        check_apart(observation, 0.11)
