"""Map scores: what a ruler says."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lirs_validation.metrics import (
    StartAlignment,
    agreement,
    cell_distance,
    false_occupied,
    iou,
    map_scores,
    map_ssim,
    unknown_share,
)
from lirs_validation.metrics.agreement import contradicted, decided
from lirs_validation.metrics.near_obstacles import near_obstacle
from lirs_wct.formats.map_server import read_map, write_map
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.walls import WallGrid

# unknown, free, undecided, occupied
cells = arrays(np.float64, (12, 15), elements=st.sampled_from([np.nan, 0.1, 0.5, 0.9]))
poses = st.builds(Pose2, st.floats(-20, 20), st.floats(-20, 20), st.floats(-math.pi, math.pi))
FLAT = HeightField(np.zeros((2, 2), np.float32), (10.0, 10.0), (-5.0, -5.0))


def grid(p: np.ndarray, resolution: float = 0.05, origin: Pose2 | None = None) -> OccupancyGrid:
    return OccupancyGrid.from_probability(p, resolution, origin)


def line(row: int, rows: int = 20, cols: int = 30) -> OccupancyGrid:
    p = np.full((rows, cols), 0.1)
    p[row] = 0.9
    return grid(p)


@given(cells, poses)
def test_a_map_agrees_with_itself(p: np.ndarray, origin: Pose2) -> None:
    m = grid(p, origin=origin)
    expected = 1.0 if m.occupied.any() else None
    assert agreement(m, m).f1 == expected
    assert iou(m, m) == expected
    assert unknown_share(m, m) == (0.0 if m.known.any() else None)


@given(cells, cells, poses)
def test_agreement_is_symmetric(p: np.ndarray, q: np.ndarray, offset: Pose2) -> None:
    a, b = grid(p), grid(q, origin=Pose2(offset.x / 40, offset.y / 40, offset.yaw))
    one, other = agreement(a, b), agreement(b, a)
    assert one.f1 == pytest.approx(other.f1) if one.f1 is not None else other.f1 is None
    assert (one.precision, one.recall) == (other.recall, other.precision)


@given(cells, cells, poses)
def test_moving_both_maps_changes_nothing(p: np.ndarray, q: np.ndarray, T: Pose2) -> None:
    a, b = grid(p), grid(q, origin=Pose2(0.1, -0.05))
    assert agreement(a.moved(T), b.moved(T)) == agreement(a, b)
    assert iou(a.moved(T), b.moved(T)) == iou(a, b)


@pytest.mark.parametrize(("shift", "f1"), [(0, 1.0), (1, 1.0), (2, 1.0), (3, 0.0), (-2, 1.0), (-3, 0.0)])
def test_ten_centimeters_are_two_cells(shift: int, f1: float) -> None:
    a, b = line(8), line(8 + shift)
    assert agreement(a, b).f1 == f1
    assert iou(a, b) == (1.0 if shift == 0 else 0.0)


def test_precision_and_recall_by_hand() -> None:
    p, q = np.full((20, 30), 0.1), np.full((20, 30), 0.1)
    p[5, :10] = 0.9  # built: 10 cells, of which 6 are right
    q[5, :6] = 0.9
    q[15, :2] = 0.9  # reference: 8 cells, of which 2 were missed
    p[5, 6:8] = 0.1  # and a gap of two so that the other 2 are too far
    p[5, 8:12] = 0.9
    scores = agreement(grid(p), grid(q))
    assert scores.precision == pytest.approx(6 / 10)
    assert scores.recall == pytest.approx(6 / 8)
    assert scores.f1 == pytest.approx(2 * 0.6 * 0.75 / 1.35)
    assert iou(grid(p), grid(q)) == pytest.approx(6 / 12)


def test_only_cells_known_in_both_are_asked() -> None:
    reference = line(8)
    p = np.full((20, 30), np.nan)
    p[6:11, :10] = 0.1
    p[8, :10] = 0.9
    built = grid(p)
    assert agreement(built, reference).f1 == 1.0
    assert iou(built, reference) == 1.0
    assert unknown_share(built, reference) == pytest.approx(1 - 50 / 600)


def test_a_neighbor_counts_even_where_the_other_map_knows_nothing() -> None:
    # A wall's far side is unknown to a laser: a wall one cell off must still be found.
    p, q = np.full((9, 9), 0.1), np.full((9, 9), 0.1)
    p[4], q[5] = 0.9, 0.9
    p[5:], q[6:] = np.nan, np.nan
    scores = agreement(grid(p), grid(q))
    assert scores.precision == 1.0


@pytest.mark.parametrize("empty", ["built", "reference", "both"])
def test_a_map_without_walls_is_wrong_where_there_are_walls(empty: str) -> None:
    free, wall = grid(np.full((20, 30), 0.1)), line(8)
    built = wall if empty == "reference" else free
    reference = wall if empty == "built" else free
    scores = map_scores(built, reference, surface=FLAT, truth=reference)
    shares = (scores.f1, scores.f1_input, scores.precision, scores.recall, scores.iou)
    assert set(shares) == ({None} if empty == "both" else {0.0})
    # FLAT has no wall anywhere: what is occupied is false.
    assert scores.false_occupied == {"built": 0.0, "reference": 1.0, "both": None}[empty]
    assert scores.reference_false_occupied == {"built": 1.0, "reference": 0.0, "both": None}[empty]


def test_maps_that_know_nothing_in_common() -> None:
    scores = map_scores(line(8), line(8).moved(Pose2(100, 0, 0)), surface=FLAT)
    assert (scores.f1, scores.iou, scores.f1_input) == (0.0, 0.0, None)
    assert scores.unknown == 1.0
    assert scores.occupied_cells == 30


def test_iou_of_a_turned_map_reads_the_nearest_cell() -> None:
    quarter = line(8).moved(Pose2(0, 0, math.pi / 2))
    upright = np.full((30, 20), 0.1)
    upright[:, 20 - 1 - 8] = 0.9
    same = grid(upright, origin=Pose2(-20 * 0.05, 0.0, 0.0))
    assert iou(quarter, same) == 1.0
    assert agreement(quarter, same).f1 == 1.0


def test_distances_by_hand_both_ways() -> None:
    p, q = np.full((20, 30), 0.1), np.full((20, 30), 0.1)
    p[5, 0:20] = 0.9
    q[5, 0:19] = 0.9  # 0.05 m from the last built cell
    q[9, 0] = 0.9  # 0.20 m from the nearest built cell
    built, reference = grid(p), grid(q)
    there, back = cell_distance(built, reference), cell_distance(reference, built)
    assert there is not None
    assert back is not None
    assert there.mean == pytest.approx(0.05 / 20)
    assert back.mean == pytest.approx(0.20 / 20)
    assert there.p95 == pytest.approx(np.percentile([0.05] + [0.0] * 19, 95))
    scores = map_scores(built, reference, surface=FLAT)
    assert (scores.to_reference, scores.from_reference) == (there, back)


@given(cells, cells, poses)
def test_distances_confirm_what_the_tolerance_confirms(p: np.ndarray, q: np.ndarray, T: Pose2) -> None:
    a, b = grid(p), grid(q, origin=Pose2(T.x / 40, T.y / 40, T.yaw))
    wrong, distance = contradicted(a, b), cell_distance(a, b)
    asked = agreement(a, b).precision
    if distance is None:
        assert asked in (None, 0.0)
    else:
        assert asked is not None
        assert (distance.mean == 0.0) <= (asked == 1.0)
        assert wrong.any() == (asked < 1.0)


def test_a_map_is_judged_as_its_file_says_it(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    choices = (np.nan, 0.05, 0.24, 0.26, 0.5, 0.64, 0.66, 0.95)
    built, reference = (grid(rng.choice(choices, (60, 80)), origin=Pose2(1.0, 2.0, 0.3)) for _ in range(2))
    scores = map_scores(built, reference, surface=FLAT)
    written = []
    for name, one in (("built", built), ("reference", reference)):
        write_map(tmp_path / name, one)
        written.append(read_map(tmp_path / f"{name}.yaml"))
    again = asdict(map_scores(written[0], written[1], surface=FLAT))
    assert again == asdict(scores)
    assert decided(built).known.sum() == (built.occupied | built.free).sum() < built.known.sum()


# ---- geometry


def step(cell: float = 0.05, n: int = 41) -> HeightField:
    """Ground at 0 west of x = 0, at 1 m from x = cell eastward."""
    z = np.zeros((n, n), np.float32)
    z[:, n // 2 + 1 :] = 1.0
    return HeightField.centered(z, (cell, cell))


@pytest.mark.parametrize("cell", [0.02, 0.05, 0.5])
def test_a_step_is_near_within_the_distance(cell: float) -> None:
    field = step(cell)
    x = np.array([-0.101, -0.099, 0.0, cell / 2, cell + 0.099, cell + 0.101])
    points = np.column_stack((x, np.full(6, 0.3)))
    near = near_obstacle(points, field, None, 0.10)
    assert near.tolist() == [False, True, True, True, True, False]


def test_a_slope_counts_above_45_degrees_only() -> None:
    rows = np.arange(9, dtype=np.float32)
    gentle = HeightField(np.tile(rows * np.float32(0.0999), (9, 1)), (0.1, 0.1), (0.0, 0.0))
    steep = HeightField(np.tile(rows * np.float32(0.1001), (9, 1)), (0.1, 0.1), (0.0, 0.0))
    points = np.array([[0.4, 0.4]])
    assert not near_obstacle(points, gentle, None, 0.1).any()
    assert near_obstacle(points, steep, None, 0.1).all()


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_steep_faces_against_plain_geometry(seed: int) -> None:
    """Sample every steep triangle densely: no sample may be nearer than the kernel believes."""
    rng = np.random.default_rng(seed)
    field = HeightField(rng.uniform(0, 0.5, (6, 5)).astype(np.float32), (0.31, 0.27), (-1.0, 2.0))
    points = rng.uniform((-1.3, 1.7), (0.6, 3.7), (25, 2))
    samples = _steep_samples(field)
    distance = np.array([np.min(np.linalg.norm(samples - p, axis=1)) for p in points])
    near = near_obstacle(points, field, None, 0.10)
    slack = 0.02
    assert near[distance <= 0.10].all()
    assert not near[distance > 0.10 + slack].any()


def _steep_samples(field: HeightField) -> np.ndarray:
    z, (cx, cy), (x0, y0) = field.south_up.astype(float), field.cell, field.origin
    a, b = np.meshgrid(np.linspace(0, 1, 25), np.linspace(0, 1, 25))
    weights = np.column_stack((a.ravel(), b.ravel()))
    weights = weights[weights.sum(axis=1) <= 1]
    out = [np.full((1, 2), 1e9)]
    for j in range(z.shape[0] - 1):
        for i in range(z.shape[1] - 1):
            sw, se, ne, nw = ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))
            for tri in ((sw, se, ne), (sw, ne, nw)):
                v = np.array([(x0 + c * cx, y0 + r * cy, z[r, c]) for c, r in tri])
                n = np.cross(v[1] - v[0], v[2] - v[0])
                if math.hypot(n[0], n[1]) > n[2]:
                    out.append(v[0, :2] + weights @ (v[1:, :2] - v[0, :2]))
    return np.concatenate(out)


def test_wall_cells_turned_with_their_map() -> None:
    solid = np.zeros((10, 10), np.bool_)
    solid[4, 4] = True  # 0.4..0.5 m in the grid
    walls = WallGrid(solid, 0.1, Pose2(1.0, 2.0, 0.7))
    local = np.array([[0.45, 0.45], [0.5 + 0.0999, 0.45], [0.5 + 0.1001, 0.45], [0.45, 0.31], [0.45, 0.29]])
    near = near_obstacle(walls.origin.apply(local), FLAT, walls, 0.10)
    assert near.tolist() == [True, True, False, True, False]


def test_false_occupied_is_the_share_in_the_open() -> None:
    p = np.full((40, 40), 0.1)
    p[10, 20] = 0.9  # on the step
    p[10, 30], p[12, 30], p[14, 30] = 0.9, 0.9, 0.9  # half a meter off
    built = grid(p, origin=Pose2(-1.0, -1.0))
    assert false_occupied(built, step(), None) == pytest.approx(0.75)


def test_every_score_is_of_its_own_two_maps() -> None:
    """Three maps that differ, none at the origin, on ground with a step and beside a wall."""
    rng = np.random.default_rng(8)
    choices, share = (np.nan, 0.1, 0.5, 0.9), (0.2, 0.45, 0.05, 0.3)
    shapes = ((21, 34), (24, 30), (26, 33))
    built, true_pose, truth = (
        grid(rng.choice(choices, shape, p=share), 0.05, Pose2(-4.0 - 0.1 * k, 7.0 + 0.07 * k, 0.02 * k))
        for k, shape in enumerate(shapes)
    )
    z = np.zeros((9, 12), np.float32)
    z[3:, 5:] = 1.0
    surface = HeightField(z, (0.2, 0.3), (-4.5, 6.0))
    walls = WallGrid(rng.random((5, 6)) < 0.2, 0.17, Pose2(-3.5, 7.2, 0.4))
    alignment = StartAlignment(T_world_aligned=Pose2(0.3, -0.2, 0.05), shift=1.25, turn=0.75)
    scores = map_scores(built, true_pose, surface=surface, walls=walls, truth=truth, alignment=alignment)
    own, other = agreement(decided(built), decided(true_pose)), agreement(decided(built), decided(truth))
    assert (scores.f1, scores.precision, scores.recall) == (own.f1, own.precision, own.recall)
    assert (scores.f1_input, scores.precision_input, scores.recall_input) == (
        other.f1, other.precision, other.recall,
    )  # fmt: skip
    assert scores.iou == iou(decided(built), decided(true_pose))
    assert scores.unknown == unknown_share(decided(built), decided(true_pose))
    assert scores.to_reference == cell_distance(decided(built), decided(true_pose))
    assert scores.from_reference == cell_distance(decided(true_pose), decided(built))
    assert scores.ssim == map_ssim(decided(built), decided(true_pose))
    assert scores.occupied_cells == built.occupied.sum()
    moved = decided(built).moved(alignment.T_world_aligned)
    assert scores.f1_aligned == agreement(moved, decided(true_pose)).f1
    assert scores.false_occupied_aligned == false_occupied(moved, surface, walls)
    assert scores.reference_false_occupied == false_occupied(true_pose, surface, walls)
    assert (scores.start_shift, scores.start_turn) == (1.25, 0.75)
    assert json.dumps(asdict(scores))  # plain numbers, as a record holds them
    near = near_obstacle(built.occupied_points(), surface, walls, 0.10 + 1e-9)
    assert scores.false_occupied == pytest.approx(1 - near.mean())
    assert 0 < scores.false_occupied < 1
    known = [v for v in asdict(scores).values() if isinstance(v, float)]
    assert len(set(known)) == len(known) == 15


@pytest.mark.parametrize(("cells", "false"), [(4, 0.0), (5, 1.0)])
def test_an_occupied_cell_ten_centimeters_from_a_wall_is_not_false(cells: int, false: float) -> None:
    walls = WallGrid(np.array([[True]]), 0.025, Pose2(-17.3, 0.7))
    p = np.full((1, 40), 0.1)
    p[0, cells] = 0.9  # its center 0.0125 m and so many cells less one east of the wall's face
    built = OccupancyGrid.from_probability(p, 0.025, Pose2(-17.3 + 0.0125, 0.7))
    assert false_occupied(built, FLAT, walls) == false
