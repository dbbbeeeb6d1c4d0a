"""Branch and bound finds what trying every pose finds."""

import math

import numpy as np
from hypothesis import given, strategies as st

from slam_baselines.cartographer.branch_and_bound import (
    BoundGrids,
    Exclusion,
    SearchWindow,
    angular_step,
    branch_and_bound,
)
from slam_baselines.occupancy_map import GrowingGrid


def random_grid(rng, share):
    grid = GrowingGrid(0.1, {"value": (np.uint8, 0)})
    grid.ensure(-4, -4, 4, 4)
    value = grid.layers["value"]
    filled = rng.random(value.shape) < share
    value[filled] = rng.integers(1, 256, filled.sum())
    return grid


def exhaustive(grid, points, start, linear, angular, center=None, radius=0.0):
    """The best score of all poses in the window, as plain loops have it."""
    value, res = grid.layers["value"].astype(int), grid.resolution
    step = angular_step(points, res)
    turns, reach = math.ceil(angular / step), math.ceil(linear / res)
    best = -1
    for t in range(-turns, turns + 1):
        c, s = math.cos(start[2] + t * step), math.sin(start[2] + t * step)
        col = np.floor((start[0] + c * points[:, 0] - s * points[:, 1]) / res).astype(int) - grid.col0
        row = np.floor((start[1] + s * points[:, 0] + c * points[:, 1]) / res).astype(int) - grid.row0
        for dr in range(-reach, reach + 1):
            for dc in range(-reach, reach + 1):
                place = start[:2] + np.array((dc, dr)) * res
                if center is not None and np.hypot(*(place - center)) < radius - 1e-9:
                    continue
                r, q = row + dr, col + dc
                inside = (r >= 0) & (q >= 0) & (r < value.shape[0]) & (q < value.shape[1])
                best = max(best, value[r[inside], q[inside]].sum())
    return best / (255 * len(points))


@given(
    seed=st.integers(0, 2**32 - 1),
    share=st.sampled_from([0.002, 0.02, 0.3]),
    beams=st.integers(1, 25),
    depth=st.integers(1, 5),
    linear=st.floats(0.05, 0.7),
    angular=st.floats(0.01, 0.3),
)
def test_it_equals_the_exhaustive_search(seed, share, beams, depth, linear, angular):
    rng = np.random.default_rng(seed)
    grid = random_grid(rng, share)
    points, start = rng.uniform(-4, 4, (beams, 2)), rng.uniform(-1, 1, 3)
    bounds = BoundGrids.of(grid, depth)
    found = branch_and_bound(bounds, points, start, SearchWindow(linear, angular), 0.0)
    assert found.complete
    assert found.score == np.float64(exhaustive(grid, points, start, linear, angular))
    again = branch_and_bound(bounds, points, start, SearchWindow(linear, angular), found.score + 1e-3)
    assert again.score < 0


@given(seed=st.integers(0, 2**32 - 1))
def test_a_neighborhood_is_left_out(seed):
    rng = np.random.default_rng(seed)
    grid = random_grid(rng, 0.05)
    points, start = rng.uniform(-3, 3, (15, 2)), rng.uniform(-1, 1, 3)
    bounds = BoundGrids.of(grid, 3)
    best = branch_and_bound(bounds, points, start, SearchWindow(0.6, 0.1), 0.0)
    second = branch_and_bound(
        bounds, points, start, SearchWindow(0.6, 0.1), 0.0, excluded=Exclusion(best.pose, 0.35)
    )
    assert second.score == np.float64(exhaustive(grid, points, start, 0.6, 0.1, best.pose[:2], 0.35))


@given(seed=st.integers(0, 2**32 - 1), depth=st.integers(1, 5))
def test_bounds_are_maxima_of_squares(seed, depth):
    rng = np.random.default_rng(seed)
    grid = random_grid(rng, 0.01)
    bounds, value = BoundGrids.of(grid, depth), grid.layers["value"]
    for h in range(depth + 1):
        for _ in range(20):
            r, c = rng.integers(0, bounds.levels.shape[1]), rng.integers(0, bounds.levels.shape[2])
            row, col = r + bounds.row0 - grid.row0, c + bounds.col0 - grid.col0
            window = value[max(row, 0) : max(row + 2**h, 0), max(col, 0) : max(col + 2**h, 0)]
            assert bounds.levels[h, r, c] == (window.max() if window.size else 0)


def test_a_search_is_given_up_at_its_limit():
    rng = np.random.default_rng(0)
    grid = random_grid(rng, 0.3)
    found = branch_and_bound(
        BoundGrids.of(grid, 4), rng.uniform(-4, 4, (20, 2)), np.zeros(3), SearchWindow(2.0, 0.5), 0.0, 500
    )
    assert not found.complete
    assert found.nodes < 1500
