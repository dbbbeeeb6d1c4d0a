"""Minimum slopes against the formula over all neighbors, and weights against slopes that are told in full."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lirs_wct.arrays import ByteArray
from lirs_wct.geometry.pose import Pose2
from slam_baselines.mapping.ground_filter import GroundFilter, GroundFilterConfig
from slam_baselines.mapping.minimum_slope import (
    IN_FULL,
    NOT_DRAWN,
    DrawnSlopes,
    Margins,
    UpperBound,
    blocks_of,
    limits_for_weights,
    lower,
    neighbors_of,
    raise_min_slopes,
)
from slam_baselines.mapping.occupancy_map import SLOPE_STEP, OccupancyMap
from slam_baselines.scan.leveling import LeveledScan, ScanPoints

Array = NDArray[np.float64]
GROUND = 3.0, 4.0, 0.1
MARGINS = Margins(0.02, 0.03, 0.008)
ORIGIN = np.array((0.2, 0.0, 0.3))
FREE = np.zeros((0, 3))


def hilly_bound(rng: np.random.Generator) -> UpperBound:
    """Ground with steps and holes in it, of which a part was never seen; its corner is no round number."""
    rows, cols = 64, 48
    height = (
        0.3 * np.sin(np.arange(rows) / 9)[:, None]
        + 0.02 * np.arange(cols)
        + rng.normal(0, 0.05, (rows, cols))
    )
    height[rng.random((rows, cols)) < 0.3] = np.inf
    cells = height.astype(np.float32)
    return UpperBound(cells, blocks_of(cells), np.array((-8.0, 8.0, 0.1)), neighbors_of(0.1))


def formula(bound: UpperBound, scan: ScanPoints) -> NDArray[np.uint8]:
    """The largest rise over run from all neighbors and from the ground under the robot, one by one."""
    rows, cols = bound.cells.shape
    out = []
    for hit in scan.hits:
        z = hit[2] - (MARGINS.near + MARGINS.far * math.dist(hit, scan.origin))
        best = (z - GROUND[2]) / (math.hypot(hit[0] - GROUND[0], hit[1] - GROUND[1]) + 0.1)
        row, col = math.floor(hit[1] / 0.1 + 8.0), math.floor(hit[0] / 0.1 - 8.0)
        for (r, c), distance in zip(bound.neighbors.cell, bound.neighbors.distance, strict=True):
            if 0 <= row + r < rows and 0 <= col + c < cols:
                best = max(best, (z - MARGINS.old - float(bound.cells[row + r, col + c])) / distance)
        out.append(int(min(max(best / SLOPE_STEP, 0.0), 255.0)))
    return np.array(out, np.uint8)


def slopes_under(drawn: OccupancyMap, points: Array) -> ByteArray:
    """Minimum slopes of the cells of a map under points, 0 where it has none."""
    row, col = np.floor(points[:, 1::-1] / drawn.resolution - drawn.frame[:2]).astype(int).T
    layer, out = drawn.layers.min_slope, np.zeros(len(points), np.uint8)
    inside = (row >= 0) & (row < layer.shape[0]) & (col >= 0) & (col < layer.shape[1])
    out[inside] = layer[row[inside], col[inside]]
    return out


def leveled_hits(rng: np.random.Generator) -> Array:
    """Hits on walls, on the ground and beyond the border of what was seen."""
    return rng.uniform((-4.5, -5.0, -0.5), (2.5, 3.5, 1.5), (60, 3))


@given(st.integers(0, 2**32 - 1), st.floats(-3.0, 3.0))
@settings(max_examples=30, deadline=None)
def test_kernels_follow_the_formula(seed: int, yaw: float) -> None:
    rng = np.random.default_rng(seed)
    bound, hits, pose = hilly_bound(rng), leveled_hits(rng), Pose2(GROUND[0], GROUND[1], yaw)
    placed = LeveledScan(ORIGIN, hits, FREE, (0.0, 0.0), 0.1, 0.0).transformed(pose, 0.2)
    place = pose.x, pose.y, pose.yaw, 0.2
    expected = formula(bound, placed)
    slopes = np.zeros(len(hits), np.uint8)
    raise_min_slopes(bound, ORIGIN, hits, place, GROUND, MARGINS, IN_FULL, NOT_DRAWN, slopes)
    np.testing.assert_array_equal(slopes, expected)
    assert len(np.unique(slopes)) > 10
    known = rng.integers(0, 256, len(hits)).astype(np.uint8)
    slopes = known.copy()
    raise_min_slopes(bound, ORIGIN, hits, place, GROUND, MARGINS, IN_FULL, NOT_DRAWN, slopes)
    np.testing.assert_array_equal(slopes, np.maximum(known, expected))


@given(st.integers(0, 2**32 - 1), st.integers(1, 120), st.floats(0.5, 2.5))
@settings(max_examples=30, deadline=None)
def test_weights_are_those_of_the_slopes_told_in_full(seed: int, wall: int, full_slope: float) -> None:
    """What the kernel does not tell apart has the same weight."""
    rng = np.random.default_rng(seed)
    bound, hits, pose = hilly_bound(rng), leveled_hits(rng), Pose2(GROUND[0], GROUND[1], 0.4)
    placed = LeveledScan(ORIGIN, hits, FREE, (0.0, 0.0), 0.1, 0.0).transformed(pose, 0.2)
    drawn = OccupancyMap(0.2)
    box = np.array((-2.0, -2.0, 4.0, 6.0))
    drawn.update(ScanPoints(ORIGIN, placed.hits[:20], FREE), rng.integers(0, 256, 20).astype(np.uint8), 1,
                 np.array((*np.minimum(box[:2], placed.hits.min(axis=0)[:2]),
                           *np.maximum(box[2:], placed.hits.max(axis=0)[:2]))))  # fmt: skip
    ground_filter = GroundFilter(GroundFilterConfig(full_weight_slope=full_slope))
    expected = ground_filter.graded_weights(
        np.maximum(formula(bound, placed), slopes_under(drawn, placed.hits)), wall
    )
    table = ground_filter.graded_weights(np.arange(256, dtype=np.uint8), wall)
    slopes, limits = np.zeros(len(hits), np.uint8), limits_for_weights(wall, full_slope)
    place, cells = (pose.x, pose.y, pose.yaw, 0.2), DrawnSlopes(drawn.layers.min_slope, drawn.frame)
    raise_min_slopes(bound, ORIGIN, hits, place, GROUND, MARGINS, limits, cells, slopes)
    np.testing.assert_array_equal(table[slopes], expected)


@given(st.lists(st.tuples(st.integers(0, 63), st.integers(0, 47), st.floats(-2, 2, width=32)), max_size=40))
@settings(max_examples=30, deadline=None)
def test_blocks_hold_the_lowest_of_their_cells(drops: list[tuple[int, int, float]]) -> None:
    bound = hilly_bound(np.random.default_rng(0))
    cells = bound.cells.copy()
    for row, col, z in drops:
        lower(bound, row, col, np.float32(z))
        cells[row, col] = min(cells[row, col], np.float32(z))
    np.testing.assert_array_equal(bound.cells, cells)
    np.testing.assert_array_equal(bound.blocks, blocks_of(cells))


def test_the_filter_weighs_hits_as_by_slopes_found_one_after_the_other() -> None:
    """Also while the grid grows."""
    rng, ground_filter, drawn = np.random.default_rng(2), GroundFilter(), OccupancyMap(0.2)
    shares = []
    for k in range(12):
        hits = rng.uniform((-9, -9, -0.2), (9, 9, 1.2), (200, 3))
        scan = LeveledScan(ORIGIN, hits, FREE, (0.1, 0.0), 0.1, 0.1 * k)
        pose = Pose2(1.5 * k, -0.7 * k, 0.3 * k)
        ground_filter.move(Pose2(1.5), scan)
        wall = ground_filter.match_wall_slope
        known = slopes_under(drawn, scan.transformed(pose, ground_filter.height).hits)
        slopes = ground_filter.min_slopes(scan, pose, known=known)
        np.testing.assert_array_equal(ground_filter.min_slopes(scan, pose, drawn=drawn), slopes)
        walls = ground_filter.match_walls(scan, pose, drawn=drawn)
        np.testing.assert_array_equal(walls, slopes >= wall)
        expected = ground_filter.graded_weights(slopes, wall)
        np.testing.assert_array_equal(ground_filter.match_weights(scan, pose, drawn, wall), expected)
        shares.append(float(expected.mean()))
        placed, slopes = ground_filter.insert(scan, pose)
        ends = np.concatenate((placed.hits, placed.origin[None]))
        drawn.update(placed, slopes, wall, np.array((*ends.min(axis=0)[:2], *ends.max(axis=0)[:2])))
    assert 0.02 < min(shares[3:]) < max(shares) < 0.98
