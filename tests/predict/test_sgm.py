"""Semi-global aggregation and sub-pixel winners against plain references."""

import numpy as np
import pytest

from slgaussian.predict.sgm import aggregate, select_winners

DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))


def plain_paths(cost, guide, p1, p2, floor, contrast):
    """The recursion of Hirschmueller 2008, eq. 13, pixel by pixel in float64."""
    H, W, D = cost.shape
    total = np.zeros((H, W, D))
    for dy, dx in DIRECTIONS:
        path = np.zeros((H, W, D))
        rows = range(H) if dy >= 0 else range(H - 1, -1, -1)
        columns = range(W) if dx >= 0 else range(W - 1, -1, -1)
        for y in rows:
            for x in columns:
                py, px = y - dy, x - dx
                path[y, x] = cost[y, x]
                if not (0 <= py < H and 0 <= px < W):
                    continue
                before = path[py, px]
                jump = int(max(floor, p2 / (1 + abs(guide[y, x] - guide[py, px]) / contrast)))
                for d in range(D):
                    ways = [before[d], before.min() + jump]
                    ways += [before[e] + p1 for e in (d - 1, d + 1) if 0 <= e < D]
                    path[y, x, d] += min(ways) - before.min()
        total += path
    return total


@pytest.mark.parametrize("shape", [(7, 9, 5), (1, 6, 4), (6, 1, 4), (5, 4, 2), (4, 5, 40)])
@pytest.mark.parametrize("p1", [20, 200])
def test_aggregation_is_exactly_the_recursion(shape, p1):
    rng = np.random.default_rng(3)
    cost = rng.integers(0, 201, shape, dtype=np.uint8)
    guide = rng.integers(0, 256, shape[:2], dtype=np.uint8)
    largest = np.where(cost > 20, 200, 0).astype(np.uint8)  # sums that come near to overflow
    for costs in (cost, largest):
        fast = aggregate(costs, guide, p1=p1).sum(0)
        assert np.array_equal(fast, plain_paths(costs, guide.astype(float), p1, 200, 12, 20.0))


def split_halves(total):
    """Any halves [2, 1, W, D] with this sum [W, D]."""
    half = np.random.default_rng(0).integers(0, total + 1)
    return np.stack([half, total - half])[:, None].astype(np.uint16)


def test_winner_is_the_vertex_of_a_parabola():
    d = np.arange(12)
    truth = np.linspace(1, 10, 40)
    total = (100 * (d - truth[:, None]) ** 2 + 7).astype(np.int64)
    best, offset, margin = select_winners(split_halves(total))
    assert np.array_equal(best[0], total.argmin(-1))
    # Costs are whole numbers of at least 100 at one candidate's distance: off by up to 1 %.
    assert np.abs(best[0] + offset[0] - truth).max() < 0.01
    assert (margin > 0).all()


def test_margin_is_against_the_best_that_is_not_a_neighbour():
    rng = np.random.default_rng(5)
    total = rng.integers(1, 2000, (50, 7))
    best, _, margin = select_winners(split_halves(total))
    for k, row in enumerate(total):
        gap = np.abs(np.arange(7) - row.argmin()) > 1
        assert best[0, k] == row.argmin()
        assert margin[0, k] == pytest.approx(1 - row.min() / row[gap].min(), abs=1e-6)


def test_flat_costs_win_nothing_and_ends_get_no_offset():
    best, offset, margin = select_winners(split_halves(np.full((3, 8), 500)))
    assert (margin == 0).all()
    assert (best == 0).all()
    falling = np.broadcast_to(np.arange(80, 0, -10), (3, 8))
    best, offset, _ = select_winners(split_halves(falling))
    assert (best == 7).all()
    assert (offset == 0).all()
