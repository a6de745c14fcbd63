import numpy as np
import pytest

from hydrabeam_mpi.data.partition import BASIS_COST, make_tiles, split_by_cost


@pytest.mark.parametrize("n_items", [0, 1, 2, 7, 30])
@pytest.mark.parametrize("n_parts", [1, 2, 3, 5, 11])
def test_split_covers_everything_once(n_items, n_parts):
    costs = np.random.default_rng(n_items).uniform(0.5, 2.0, n_items)
    parts = split_by_cost(costs, n_parts)
    assert len(parts) == n_parts
    assert [i for part in parts for i in range(n_items)[part]] == list(range(n_items))


def test_split_balances_uneven_costs():
    costs = np.array([5.0, 1, 1, 1, 1, 1])
    loads = [costs[part].sum() for part in split_by_cost(costs, 2)]
    assert loads == [5.0, 5.0]


@pytest.mark.parametrize("n_ranks", [1, 2, 3, 4, 7, 12, 100])
def test_tiles_are_disjoint_complete_and_keep_groups_whole(n_ranks):
    times = np.array([1, 3, 4, 9])
    bls = np.arange(10, 22)
    group = np.array([0, 1, 2, 0, 1, 2, 5, 5, 5, 6, 7, 0])
    tiles = make_tiles(times, np.array([3.0, 1, 1, 2]), bls, group, n_ranks)
    assert len(tiles) == n_ranks
    seen = [(t, b) for tile in tiles for t in tile.times for b in tile.bls]
    assert len(seen) == len(set(seen)) == len(times) * len(bls)
    for tile in tiles:
        inside = set(group[np.isin(bls, tile.bls)])
        assert all(set(bls[group == g]) <= set(tile.bls) for g in inside)


def test_more_ranks_than_rows_leaves_ranks_idle():
    tiles = make_tiles(np.array([0]), np.ones(1), np.array([0, 1]), np.array([0, 0]), 3)
    assert sorted(tile.size for tile in tiles) == [0, 0, 2]
    assert sum(len(tile.times) for tile in tiles) == 1


@pytest.mark.parametrize(
    ("n_times", "n_groups", "n_ranks"),
    [(60, 63, n) for n in (2, 3, 4, 5)] + [(15, 8009, n) for n in (2, 3, 4, 7, 16, 64)],
)
def test_uneven_source_counts_are_balanced(n_times, n_groups, n_ranks):
    counts = np.random.default_rng(1).uniform(1000, 6000, n_times)
    bls = np.arange(n_groups)
    tiles = make_tiles(np.arange(n_times), counts, bls, bls, n_ranks)
    loads = [counts[tile.times].sum() * (BASIS_COST * (tile.size > 0) + len(tile.bls)) for tile in tiles]
    assert max(loads) < 1.1 * np.mean(loads)


def test_a_rank_evaluates_few_times_where_there_are_many():
    tiles = make_tiles(np.arange(30), np.ones(30), np.arange(63), np.arange(63), 2)
    assert [(len(tile.times), len(tile.bls)) for tile in tiles] == [(15, 63), (15, 63)]


def test_no_rows_at_all():
    empty = np.array([], dtype=int)
    assert all(tile.size == 0 for tile in make_tiles(empty, np.array([]), empty, empty, 3))
