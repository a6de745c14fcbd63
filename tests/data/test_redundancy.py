import numpy as np
import pytest

from hydrabeam_mpi.data.redundancy import find_redundant_groups


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
