"""The update's rules, and traces of scans against a plain twin."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from slam_baselines.leveling import ScanPoints
from slam_baselines.occupancy_map import (
    COLUMN,
    ONE,
    STEP,
    UNSEEN,
    VALUE,
    GrowingGrid,
    OccupancyMap,
    RayTracer,
    Trace,
    UpdateConfig,
    bounding_box,
)

Array = NDArray[np.float64]
NONE = np.zeros((0, 3))
MISS, HIT, LIMIT = UpdateConfig().steps


def enter(
    grid: OccupancyMap,
    hits: Array,
    *,
    origin: Array | None = None,
    free: Array = NONE,
    min_slopes: int = 0,
    wall_slope: int = 0,
) -> None:
    origin = np.array((0.02, 0.02, 0.4)) if origin is None else origin
    ends = np.concatenate((hits, free, origin[None]))
    box = np.concatenate((ends[:, :2].min(axis=0), ends[:, :2].max(axis=0)))
    scan = ScanPoints(origin, hits, free)
    np.testing.assert_array_equal(bounding_box(scan), box)
    grid.update(scan, np.full(len(hits), min_slopes, np.uint8), wall_slope, box)


def at(grid: OccupancyMap, x: float, y: float) -> float:
    return grid.occupancy_grid(0).log_odds[tuple(grid.occupancy_grid(0).cells((x, y)))]


def ring(n: int, radius: float, z: float = 0.4) -> Array:
    a = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return np.stack((radius * np.cos(a), radius * np.sin(a), 0 * a + z), axis=-1)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 400), st.floats(0.1, 8.0), st.integers(1, 4))
def test_no_cell_changes_twice_in_a_scan(n: int, radius: float, times: int) -> None:
    grid = OccupancyMap(0.05)
    for _ in range(times):
        enter(grid, ring(n, radius))
    values = grid.occupancy_grid(0).log_odds
    legal = {min(LIMIT, HIT * times), max(-LIMIT, MISS * times)}
    assert {round(v / STEP) for v in values[~np.isnan(values)].tolist()} <= legal


def test_the_scratch_of_many_scans_is_as_good_as_a_fresh_one() -> None:
    """Marks of earlier scans stay in it; after 255 scans they come round again."""
    kept, fresh = OccupancyMap(0.1), OccupancyMap(0.1)
    for k in range(600):
        origin = np.array((0.02 * (k % 40), 0.01 * (k % 70), 0.4))
        hits = ring(40 + k % 5, 1.0 + 0.01 * (k % 90)) + origin * (1, 1, 0)
        enter(kept, hits, origin=origin)
        fresh._tracer = RayTracer(0.1)
        enter(fresh, hits, origin=origin)
    np.testing.assert_array_equal(kept.layers.log_odds, fresh.layers.log_odds)


def test_a_hit_wins_over_beams_that_pass() -> None:
    grid = OccupancyMap(0.05)
    beyond = np.array(((1.0, 0.02, 0.4), (2.0, 0.02, 0.4)))
    enter(grid, beyond)
    assert at(grid, 1.0, 0.02) == pytest.approx(HIT * STEP)
    assert at(grid, 0.5, 0.02) == pytest.approx(MISS * STEP)


def test_the_map_grows_and_keeps_what_it_knew() -> None:
    grid = OccupancyMap(0.1)
    enter(grid, np.array(((1.0, 1.0, 0.4),)))
    enter(grid, np.array(((-40.0, 33.0, 0.4),)))
    assert at(grid, 1.0, 1.0) == pytest.approx(HIT * STEP)
    assert at(grid, -40.0, 33.0) == pytest.approx(HIT * STEP)


def test_log_odds_stay_within_their_limit_and_recover() -> None:
    grid = OccupancyMap(0.05)
    for _ in range(50):
        enter(grid, np.array(((1.0, 0.02, 0.4),)))
    assert at(grid, 1.0, 0.02) == pytest.approx(LIMIT * STEP)
    for _ in range(2 * LIMIT // -MISS + 1):
        enter(grid, np.array(((2.0, 0.02, 0.4),)))
    assert at(grid, 1.0, 0.02) < 0


def test_what_may_be_ground_is_not_known_to_be_occupied() -> None:
    grid = OccupancyMap(0.05)
    enter(grid, np.array(((1.0, 0.02, 0.4),)), min_slopes=20, wall_slope=30)
    assert not grid.occupancy_grid(30).occupied.any()
    assert grid.occupancy_grid(30).free.any() or grid.occupancy_grid(30).known.any()
    assert grid.occupancy_grid(20).occupied.sum() == 1
    assert grid.layers.value.max() == 1
    grid.revalue(20)
    assert grid.layers.value.max() > 100


def test_a_beam_high_above_a_proven_wall_leaves_it_alone() -> None:
    high, low = (OccupancyMap(0.05) for _ in range(2))
    for grid, z in ((high, 1.5), (low, 0.4)):
        enter(grid, np.array(((1.0, 0.02, 0.4),)), min_slopes=90, wall_slope=50)
        for _ in range(9):
            enter(
                grid,
                np.array(((2.0, 0.02, z),)),
                origin=np.array((0.02, 0.02, z)),
                min_slopes=90,
                wall_slope=50,
            )
    assert at(high, 1.0, 0.02) > 0 > at(low, 1.0, 0.02)


def test_beams_without_return_clear_to_their_end() -> None:
    grid = OccupancyMap(0.05)
    enter(grid, NONE, free=np.array(((1.0, 0.02, 0.4),)))
    assert at(grid, 0.99, 0.02) == pytest.approx(MISS * STEP)


@given(st.integers(0, 2**32 - 1), st.integers(0, 120), st.integers(0, 120))
@settings(max_examples=20, deadline=None)
def test_another_wall_slope_leaves_what_each_cell_says_of_itself(seed: int, before: int, after: int) -> None:
    """The matcher's layer is a function of log-odds and minimum slope."""
    rng, grid = np.random.default_rng(seed), OccupancyMap(0.1)
    for wall_slope in (before, before, after):
        grid.revalue(wall_slope)
        for _ in range(3):
            hits = rng.uniform((-4, -4, 0), (4, 4, 2), (50, 3))
            enter(grid, hits, min_slopes=int(rng.integers(0, 256)), wall_slope=wall_slope)
    layers = grid.layers
    expected = VALUE[layers.log_odds.astype(np.int64) + 128]
    expected[(layers.log_odds > 0) & (layers.min_slope < after)] = UNSEEN
    np.testing.assert_array_equal(layers.value, expected)
    assert (layers.log_odds > 0).any()
    assert (layers.log_odds < 0).any()


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-40, 40)] * 2, *[st.floats(0, 30)] * 2), min_size=1, max_size=6),
    st.sampled_from((0.05, 0.1, 0.2)),
)
def test_a_grid_holds_every_box_with_a_cell_to_spare(
    boxes: list[tuple[float, float, float, float]], resolution: float
) -> None:
    grid = GrowingGrid(resolution, {"a": (np.uint8, 7)})
    for west, south, width, height in boxes:
        before = grid.layers["a"]
        grew = grid.ensure(west, south, west + width, south + height)
        assert grew == (grid.layers["a"] is not before)
        rows, cols = grid.shape
        assert grid.col0 <= west / resolution - 1 + 1e-6
        assert grid.row0 <= south / resolution - 1 + 1e-6
        assert grid.col0 + cols >= (west + width) / resolution + 2 - 1e-6
        assert grid.row0 + rows >= (south + height) / resolution + 2 - 1e-6
        assert not grid.ensure(west, south, west + width, south + height)


RESOLUTION = 0.1


def a_scan(seed: int) -> ScanPoints:
    rng = np.random.default_rng(seed)
    origin = rng.normal(0, 3, 3)
    return ScanPoints(origin, origin + rng.normal(0, 4, (80, 3)), origin + rng.normal(0, 6, (40, 3)))


Cell = tuple[int, int]


def plain(scan: ScanPoints, corner: Cell) -> tuple[list[Cell], dict[Cell, float]]:
    """Cells of the hits, and of what is passed first, with the beam's height there."""
    to_cells = 1 / RESOLUTION

    def at(point: NDArray[np.float64]) -> tuple[float, float]:
        return float(point[1] * to_cells - corner[0]), float(point[0] * to_cells - corner[1])

    hits = [(int(row), int(col)) for row, col in map(at, scan.hits)]
    met, passed = set(hits), {}
    (y, x), z = at(scan.origin), float(scan.origin[2])
    for end, more in [(p, -1) for p in scan.hits] + [(p, 1) for p in scan.free]:
        dy, dx = at(end)[0] - y, at(end)[1] - x
        n = int(max(abs(dx), abs(dy))) + 1
        for k in range(n + more):
            row, col = (int(a * ONE) + k * int(d / n * ONE) for a, d in ((y, dy), (x, dx)))
            cell = row // int(ONE), col // int(ONE)
            if cell not in met:
                met.add(cell)
                passed[cell] = z + k * ((float(end[2]) - z) / n)
    return hits, passed


def numbered(trace: Trace, z: float) -> dict[Cell, float]:
    """Cells that a trace passes, with the beam's height there."""
    beam = np.searchsorted(trace.ends, np.arange(trace.ends[-1]), side="right")
    return {
        (int(cell) >> 32, int(cell) & COLUMN): z + int(step) * float(trace.rise[b])
        for cell, step, b in zip(trace.cells, trace.steps, beam, strict=False)
    }


def test_a_trace_is_that_of_a_plain_twin() -> None:
    tracer = RayTracer(RESOLUTION)
    for seed in range(20):
        scan = a_scan(seed)
        trace = tracer.trace(scan, bounding_box(scan))
        hits, passed = plain(scan, trace.corner)
        assert [(int(c) >> 32, int(c) & COLUMN) for c in trace.hit_cells] == hits
        assert [hits.index(cell) == i for i, cell in enumerate(hits)] == trace.hit_first.tolist()
        assert numbered(trace, float(scan.origin[2])) == passed


def test_one_trace_serves_maps_of_any_extent() -> None:
    alone, other = OccupancyMap(RESOLUTION), OccupancyMap(RESOLUTION)
    tracer, far = RayTracer(RESOLUTION), ScanPoints(np.full(3, 50.0), np.full((1, 3), 51.0), np.empty((0, 3)))
    other.update(far, np.zeros(1, np.uint8), 0, bounding_box(far))
    for seed in range(10):
        scan, slopes = a_scan(seed), np.full(80, 90, np.uint8)
        box = bounding_box(scan)
        alone.update(scan, slopes, 20, box)
        other.enter(tracer.trace(scan, box), scan, slopes, 20, box)
    rows, cols = alone.grid.shape
    row, col = alone.grid.row0 - other.grid.row0, alone.grid.col0 - other.grid.col0
    for here, there in zip(alone.layers, other.layers, strict=True):
        np.testing.assert_array_equal(here, there[row : row + rows, col : col + cols])
