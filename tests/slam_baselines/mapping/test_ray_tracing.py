"""Traces of scans against a plain twin; one trace serves maps of any extent."""

import numpy as np
from numpy.typing import NDArray

from slam_baselines.leveling import ScanPoints
from slam_baselines.occupancy_map import COLUMN, ONE, OccupancyMap, RayTracer, Trace, bounding_box

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
