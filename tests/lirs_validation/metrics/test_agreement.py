"""Agreement of occupied cells, against a search of all pairs: maps turned, shifted, of two resolutions."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_validation.metrics.map import (
    Agreement,
    CellDistance,
    agreement,
    as_stored,
    cell_distance,
    contradicted,
    iou,
    log_odds_at,
    nearest_occupied,
    sample_like,
    unknown_share,
)
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2

seeds = st.integers(0, 2**32 - 1)
UNKNOWN = math.nan


def random_map(rng: np.random.Generator, near: tuple[float, float]) -> OccupancyGrid:
    """Return a map whose corner lies somewhere near a point; unknown, free, undecided, occupied cells."""
    p = rng.choice((UNKNOWN, 0.1, 0.5, 0.9), rng.integers(1, 9, 2), p=(0.25, 0.35, 0.1, 0.3))
    origin = Pose2(*(np.array(near) + rng.uniform(-0.4, 0.4, 2)).tolist(), float(rng.uniform(-3.1, 3.1)))
    return OccupancyGrid.from_probability(p, float(rng.uniform(0.04, 0.3)), origin)


def two_maps(seed: int) -> tuple[OccupancyGrid, OccupancyGrid]:
    rng = np.random.default_rng(seed)
    near = tuple(rng.uniform(-20, 20, 2).tolist())
    return random_map(rng, near), random_map(rng, near)


def center(grid: OccupancyGrid, row: int, col: int) -> tuple[float, float]:
    """Return the center of a cell, by the definition of the origin."""
    x, y, yaw = grid.origin.as_array().tolist()
    u, v = (col + 0.5) * grid.resolution, (row + 0.5) * grid.resolution
    return x + math.cos(yaw) * u - math.sin(yaw) * v, y + math.sin(yaw) * u + math.cos(yaw) * v


def value(grid: OccupancyGrid, point: tuple[float, float]) -> float:
    """Return the log-odds under a point; NaN outside."""
    x, y, yaw = grid.origin.as_array().tolist()
    dx, dy = point[0] - x, point[1] - y
    col = math.floor((math.cos(yaw) * dx + math.sin(yaw) * dy) / grid.resolution)
    row = math.floor((math.cos(yaw) * dy - math.sin(yaw) * dx) / grid.resolution)
    inside = 0 <= row < grid.shape[0] and 0 <= col < grid.shape[1]
    return float(grid.log_odds[row, col]) if inside else UNKNOWN


def all_pairs(asked: OccupancyGrid, other: OccupancyGrid) -> list[tuple[int, int, float]]:
    """Return row, column and distance to the nearest of every occupied cell under which the other knows."""
    targets = [center(other, r, c) for r, c in np.argwhere(other.occupied).tolist()]
    found = []
    for r, c in np.argwhere(asked.occupied).tolist():
        here = center(asked, r, c)
        if not math.isnan(value(other, here)):
            found.append((r, c, min((math.dist(here, there) for there in targets), default=math.inf)))
    return found


def share(asked: OccupancyGrid, other: OccupancyGrid, tolerance: float) -> float | None:
    """Return the share that is confirmed: None of two maps without walls, 0 where no cell can be asked."""
    if not asked.occupied.any() and not other.occupied.any():
        return None
    distances = [d for _, _, d in all_pairs(asked, other)]
    return sum(d <= tolerance for d in distances) / len(distances) if distances else 0.0


@given(seeds, st.sampled_from((0.03, 0.1, 0.35)))
def test_against_all_pairs(seed: int, tolerance: float) -> None:
    built, reference = two_maps(seed)
    found = agreement(built, reference, tolerance)
    assert found.precision == share(built, reference, tolerance)
    assert found.recall == share(reference, built, tolerance)
    wrong = np.zeros(built.shape, np.bool_)
    for row, col, distance in all_pairs(built, reference):
        wrong[row, col] = distance > tolerance
    np.testing.assert_array_equal(contradicted(built, reference, tolerance), wrong)
    if found.precision and found.recall:
        assert found.f1 == pytest.approx(2 / (1 / found.precision + 1 / found.recall))
    else:
        assert found.f1 == (None if found.precision is None else 0.0)


@given(seeds)
def test_distances_against_all_pairs(seed: int) -> None:
    built, reference = two_maps(seed)
    cells, distance = nearest_occupied(built, reference)
    pairs = all_pairs(built, reference)
    assert cells.tolist() == [[r, c] for r, c, _ in pairs]
    np.testing.assert_allclose(distance, [d for _, _, d in pairs], atol=1e-12)
    found = cell_distance(built, reference)
    if not pairs or not reference.occupied.any():
        assert found is None
    else:
        assert found.mean == pytest.approx(np.mean([d for _, _, d in pairs]))
        assert found.p95 == pytest.approx(np.percentile([d for _, _, d in pairs], 95))


@given(seeds)
def test_cells_of_another_grid_against_the_cell_under_each_point(seed: int) -> None:
    built, reference = two_maps(seed)
    under = [
        [value(built, center(reference, r, c)) for c in range(reference.shape[1])]
        for r in range(reference.shape[0])
    ]
    np.testing.assert_array_equal(sample_like(built, reference), np.float32(under))
    known = reference.known
    expected = np.isnan(np.array(under))[known].mean() if known.any() else None
    assert unknown_share(built, reference) == (None if expected is None else pytest.approx(expected))
    both = known & ~np.isnan(np.array(under))
    one, two = (np.float32(under) > math.log(0.65 / 0.35)) & both, reference.occupied & both
    nothing = 0.0 if built.occupied.any() or reference.occupied.any() else None
    expected = (one & two).sum() / (one | two).sum() if (one | two).any() else nothing
    assert iou(built, reference) == (None if expected is None else pytest.approx(expected))


@given(seeds, st.integers(-9, 9), st.integers(-9, 9), st.floats(-4, 4))
def test_cells_of_a_grid_on_the_same_lattice(seed: int, row: int, col: int, yaw: float) -> None:
    """They are copied; a shift by a hundredth of a cell reads the same ones cell by cell."""
    built, other = two_maps(seed)
    shift, frame = built.origin @ Pose2(0.05 * col, 0.05 * row, 0.0), Pose2(3.0, -70.0, yaw)
    like = replace(other, resolution=0.05, origin=shift).moved(frame)
    built = replace(built, resolution=0.05)
    off = built.moved(frame @ Pose2(0.0005, 0.0, 0.0))
    np.testing.assert_array_equal(sample_like(built.moved(frame), like), sample_like(off, like))


def test_cells_of_a_turned_grid_of_the_same_resolution() -> None:
    grid = OccupancyGrid(np.arange(30, dtype=np.float32).reshape(5, 6), 0.5)
    turned = replace(grid, origin=Pose2(yaw=0.3))
    found = sample_like(grid, turned)
    np.testing.assert_array_equal(
        found, log_odds_at(grid, turned.centers(np.argwhere(grid.known))).reshape(5, 6)
    )
    assert not np.array_equal(found, grid.log_odds)


def test_a_point_outside_is_unknown_on_every_side() -> None:
    grid = OccupancyGrid(np.arange(6, dtype=np.float32).reshape(2, 3), 0.5, Pose2(-4.0, 7.0))
    points = np.array([(-4.0, 7.0), (-2.51, 7.99), (-2.5, 7.5), (-3.0, 8.0), (-4.01, 7.5), (-3.9, 6.99)])
    np.testing.assert_array_equal(
        log_odds_at(grid, points), np.float32([0, 5, np.nan, np.nan, np.nan, np.nan])
    )
    assert log_odds_at(grid, points.reshape(2, 3, 2)).shape == (2, 3)


def test_what_is_neither_occupied_nor_free_is_undecided() -> None:
    p = np.array([[0.24, 0.26, 0.64, 0.66, UNKNOWN, 0.02]])
    grid = OccupancyGrid.from_probability(p, 0.1, Pose2(1.0, 2.0, 3.0))
    found = as_stored(grid)
    assert found.known.tolist() == [[True, False, False, True, False, True]]
    np.testing.assert_array_equal(
        found.log_odds[found.known], grid.log_odds[[[True, False, False, True, False, True]]]
    )
    assert (found.resolution, found.origin) == (grid.resolution, grid.origin)


@pytest.mark.parametrize(("cells", "agrees"), [(4, True), (5, False), (-4, True), (-5, False)])
def test_cells_ten_centimeters_apart_agree(cells: int, agrees: bool) -> None:
    """Centers 4 x 0.025 m apart: 0.10 m but for rounding, which the tolerance forgives."""
    p = np.full((1, 40), 0.1)
    p[0, 20] = 0.9
    built = OccupancyGrid.from_probability(p, 0.025, Pose2(-17.3, 0.7))
    reference = OccupancyGrid.from_probability(np.roll(p, cells), 0.025, Pose2(-17.3, 0.7))
    one = 1.0 if agrees else 0.0
    assert agreement(built, reference) == Agreement(precision=one, recall=one, f1=one)
    assert contradicted(built, reference).sum() == (0 if agrees else 1)
    distance = pytest.approx(abs(cells) * 0.025)
    assert cell_distance(built, reference) == CellDistance(mean=distance, p95=distance)  # type: ignore[arg-type]
