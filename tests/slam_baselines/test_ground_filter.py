"""Separation of ground and walls: only proven walls count, and vertical faces are proven."""

import math

import numpy as np
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from lirs_wct.arrays import ByteArray
from lirs_wct.geometry.pose import Pose2
from slam_baselines.ground_filter import (
    IN_FULL,
    NOT_DRAWN,
    GroundFilter,
    GroundFilterConfig,
    Margins,
    UpperBound,
    blocks_of,
    limits_for_weights,
    lower,
    neighbors_of,
    raise_min_slopes,
)
from slam_baselines.leveling import LeveledScan, ScanLeveler, ScanPoints
from slam_baselines.occupancy_map import SLOPE_STEP, OccupancyMap
from tests.slam_baselines.synthetic import Drive, wavy

Array = NDArray[np.float64]
NONE = np.zeros((0, 3))
LASER = np.array((0.0, 0.0, 0.32))


def leaning(pitch: float) -> LeveledScan:
    return LeveledScan(LASER, NONE, NONE, (-math.tan(pitch), 0.0), True, 0.0)


def on_hills(tilt: float = 0.1, distance_traveled: float = 50.0) -> GroundFilter:
    """A filter that has met slopes, far enough from the start to know them."""
    ground_filter = GroundFilter(GroundFilterConfig(height_drift=1e-6))
    ground_filter.move(Pose2(distance_traveled), leaning(tilt))
    ground_filter.height = 0.0
    return ground_filter


def test_on_a_floor_every_hit_is_a_wall() -> None:
    ground_filter = GroundFilter()
    ground_filter.move(Pose2(), leaning(math.radians(0.3)))
    assert ground_filter.wall_slope == ground_filter.match_wall_slope == 0


def test_a_robot_that_leans_as_it_brakes_is_still_on_a_floor() -> None:
    braking, climbing, standing = (GroundFilter() for _ in range(3))
    for ground_filter in (braking, climbing):
        ground_filter.move(Pose2(1.0), leaning(0.0))
    for speed in (0.4, 0.3, 0.2, 0.1, 0.0, 0.0):
        braking.move(Pose2(0.1 * speed), leaning(math.radians(1.0)))
        climbing.move(Pose2(0.04), leaning(math.radians(3.0)))
    standing.move(Pose2(), leaning(math.radians(1.0)))  # it starts on a slope
    assert braking.flat
    assert not climbing.flat
    assert not standing.flat
    assert math.isclose(climbing.tilt, math.radians(3.0 * (1 - 0.8**6)), rel_tol=1e-3)


def test_steeper_ground_met_asks_for_steeper_proof_when_matching() -> None:
    gentle, steep = on_hills(0.03), on_hills(0.15)
    assert 0 < gentle.match_wall_slope < steep.match_wall_slope <= round(100 * math.tan(math.radians(41)))


def test_what_could_be_ground_is_not_drawn_as_a_wall() -> None:
    """A hill may be steeper than all that the robot climbed; up to 45 degrees it is ground."""
    assert on_hills(0.03).wall_slope == on_hills(0.15).wall_slope == 100


def test_rocking_and_slipping_let_the_height_drift() -> None:
    smooth, rocking, slipping = (GroundFilter() for _ in range(3))
    for k in range(100):
        smooth.move(Pose2(0.05), leaning(-0.2))
        rocking.move(Pose2(0.05), leaning(-0.2 - 0.1 * math.sin(k)))
        slipping.move(Pose2(0.05), leaning(-0.2), registered=False)
    assert math.isclose(smooth.drift, 0.0015 * 5.0)
    assert rocking.drift > 1.5 * smooth.drift
    assert slipping.drift > 1.5 * smooth.drift
    # Standing still on a rocking robot moves nothing.
    for k in range(100):
        smooth.move(Pose2(), leaning(0.1 * math.sin(k)))
    assert math.isclose(smooth.drift, 0.0015 * 5.0)


def test_height_follows_the_slope() -> None:
    ground_filter = GroundFilter()
    for _ in range(100):
        ground_filter.move(Pose2(0.1), leaning(-0.1))
    assert math.isclose(ground_filter.height, 10 * math.tan(0.1), rel_tol=1e-9)


def test_one_height_proves_nothing_two_heights_do() -> None:
    ground_filter = on_hills()
    low, high = (np.array(((6.0, 0.0, z),)) for z in (0.1, 0.75))
    assert ground_filter.observe(ScanPoints(LASER, low, NONE), Pose2())[0] < ground_filter.wall_slope
    assert ground_filter.observe(ScanPoints(LASER, high, NONE), Pose2())[0] >= ground_filter.wall_slope


def test_noise_of_the_attitude_proves_nothing() -> None:
    ground_filter, rng = on_hills(), np.random.default_rng(0)
    most = 0
    for _ in range(300):
        hit = np.array(((8.0, 0.0, 0.3 + 8.0 * rng.normal(0, math.radians(0.15))),))
        most = max(most, int(ground_filter.observe(ScanPoints(LASER, hit, NONE), Pose2())[0]))
    assert most < ground_filter.wall_slope


def test_what_rises_too_steeply_from_under_the_robot_is_a_wall_at_once() -> None:
    ground_filter = on_hills()
    hit = np.array(((0.6, 0.0, 0.32),))
    min_slope = ground_filter.observe(ScanPoints(LASER, hit, NONE), Pose2())[0]
    assert min_slope >= ground_filter.match_wall_slope


def test_a_beam_that_passes_low_in_front_proves_a_wall() -> None:
    ground_filter = on_hills()
    ground_filter.observe(ScanPoints(LASER, NONE, np.array(((6.0, 1.0, 0.0),))), Pose2())
    passing = np.array(((5.9, -3.0, 0.0),))
    ground_filter.observe(ScanPoints(np.array((5.9, 3.0, 0.0)), NONE, passing), Pose2())
    assert (
        ground_filter.observe(ScanPoints(LASER, np.array(((6.0, 0.0, 0.7),)), NONE), Pose2())[0]
        >= ground_filter.wall_slope
    )


def test_old_heights_are_believed_less_after_a_long_way() -> None:
    min_slope = []
    for drift in (0.0001, 0.02):
        ground_filter = GroundFilter(GroundFilterConfig(height_drift=drift))
        ground_filter.observe(ScanPoints(LASER, np.array(((6.0, 0.0, 0.1),)), NONE), Pose2())
        ground_filter.move(Pose2(20.0), leaning(0.0))
        high = ScanPoints(LASER, np.array(((6.0, 0.0, 0.75),)), NONE)
        min_slope.append(int(ground_filter.observe(high, Pose2())[0]))
    assert min_slope[1] < min_slope[0]


def test_hills_are_never_taken_for_walls_while_blocks_are() -> None:
    """Every hit of a drive at the true poses, against the terrain itself."""
    surface = wavy(1.5)
    drive = Drive(surface, 20.0, np.random.default_rng(3))
    leveler, ground_filter, last = ScanLeveler(), GroundFilter(), drive.truth[0].to_pose2()
    ground_filter.height = drive.truth[0].z
    ground = ground_filter.height - 0.13 - float(surface.height_at(last.x, last.y))
    assert abs(ground) < 0.02
    slope = surface.slope()
    false = found = walls = 0
    for scan, imu, truth in zip(drive.scans, drive.imus, drive.truth, strict=True):
        pose, level = truth.to_pose2(), leveler.level(scan, imu)
        ground_filter.move(last.inverse() @ pose, level)
        last = pose
        placed = level.transformed(pose, ground_filter.height)
        taken = ground_filter.observe(placed, pose) >= ground_filter.wall_slope
        cells = np.round((placed.hits[:, :2] - surface.origin) / surface.cell).astype(int)
        rows, cols = surface.shape[0] - 1 - cells[:, 1], cells[:, 0]
        near = np.array([slope[max(0, r - 3) : r + 4, max(0, c - 3) : c + 4].max(initial=0) > 0.8
                         for r, c in zip(rows, cols, strict=True)])  # fmt: skip
        false += int((taken & ~near).sum())
        walls += int(near.sum())
        found += int((taken & near).sum())
    assert walls > 10_000
    assert false <= 0.01 * (found + false)
    assert found > 0.15 * walls


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
    placed = LeveledScan(ORIGIN, hits, FREE, (0.0, 0.0), True, 0.0).transformed(pose, 0.2)
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
    """Slopes that the kernel does not distinguish have the same weight."""
    rng = np.random.default_rng(seed)
    bound, hits, pose = hilly_bound(rng), leveled_hits(rng), Pose2(GROUND[0], GROUND[1], 0.4)
    placed = LeveledScan(ORIGIN, hits, FREE, (0.0, 0.0), True, 0.0).transformed(pose, 0.2)
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
    place, cells = (pose.x, pose.y, pose.yaw, 0.2), (drawn.layers.min_slope, drawn.frame)
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
    rng, drawn = np.random.default_rng(2), OccupancyMap(0.2)
    ground_filter = GroundFilter(GroundFilterConfig(least_wall_share=0.0))
    shares = []
    for k in range(12):
        hits = rng.uniform((-9, -9, -0.2), (9, 9, 1.2), (200, 3))
        scan = LeveledScan(ORIGIN, hits, FREE, (0.1, 0.0), True, 0.1 * k)
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


def test_a_few_walls_among_ground_are_not_matched() -> None:
    """Where most hits may be ground, those that seem to be walls may be ground, too."""
    ground_filter = GroundFilter()
    ground_filter.tilt = math.radians(10.0)
    wall = ground_filter.match_wall_slope
    for walls, used in ((14, 0), (15, 15), (100, 100)):
        slopes = np.where(np.arange(100) < walls, 200, 0).astype(np.uint8)
        assert np.count_nonzero(ground_filter.weights_among_walls(slopes, wall)) == used
