"""Map scores: what a ruler says."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lirs_validation.metrics.alignment import StartAlignment
from lirs_validation.metrics.map import (
    agreement,
    as_stored,
    cell_distance,
    false_occupied,
    iou,
    map_scores,
    map_ssim,
    unknown_share,
)
from lirs_validation.metrics.world_geometry import near_obstacle
from lirs_wct.formats.map_server import read_map, write_map
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.walls import WallGrid

# unknown, free, undecided, occupied
cells = arrays(np.float64, (12, 15), elements=st.sampled_from([np.nan, 0.1, 0.5, 0.9]))
FLAT = HeightField(np.zeros((2, 2), np.float32), (10.0, 10.0), (-5.0, -5.0))


def grid(p: np.ndarray, resolution: float = 0.05, origin: Pose2 | None = None) -> OccupancyGrid:
    return OccupancyGrid.from_probability(p, resolution, origin)


def line(row: int, rows: int = 20, cols: int = 30) -> OccupancyGrid:
    p = np.full((rows, cols), 0.1)
    p[row] = 0.9
    return grid(p)


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
    # A map with walls is wrong beside one without, also where nothing can be compared.
    far, free = line(8).moved(Pose2(100, 0, 0)), grid(np.full((20, 30), 0.1))
    assert iou(far, free) == iou(free, far) == 0.0
    assert iou(free, free.moved(Pose2(100, 0, 0))) is None
    assert unknown_share(far, free) == 1.0
    assert unknown_share(free, free) == 0.0


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
    assert as_stored(built).known.sum() == (built.occupied | built.free).sum() < built.known.sum()


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
    own = agreement(as_stored(built), as_stored(true_pose))
    other = agreement(as_stored(built), as_stored(truth))
    assert (scores.f1, scores.precision, scores.recall) == (own.f1, own.precision, own.recall)
    assert (scores.f1_input, scores.precision_input, scores.recall_input) == (
        other.f1, other.precision, other.recall,
    )  # fmt: skip
    assert scores.iou == iou(as_stored(built), as_stored(true_pose))
    assert scores.unknown == unknown_share(as_stored(built), as_stored(true_pose))
    assert scores.to_reference == cell_distance(as_stored(built), as_stored(true_pose))
    assert scores.from_reference == cell_distance(as_stored(true_pose), as_stored(built))
    assert scores.ssim == map_ssim(as_stored(built), as_stored(true_pose))
    assert scores.occupied_cells == built.occupied.sum()
    moved = as_stored(built).moved(alignment.T_world_aligned)
    assert scores.f1_aligned == agreement(moved, as_stored(true_pose)).f1
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
