"""Agreement and scores of maps: against searches of all pairs, Wang's equations and a ruler."""

import json
import math
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays

from lirs_validation.metrics.map import (
    Agreement,
    CellDistance,
    agreement,
    as_picture,
    as_stored,
    cell_distance,
    contradicted,
    false_occupied,
    iou,
    map_scores,
    map_ssim,
    near_obstacle,
    nearest_occupied,
    sample_like,
    similarity,
    unknown_share,
)
from lirs_validation.metrics.trajectory import StartAlignment
from lirs_wct.formats.map_server import read_map, write_map
from lirs_wct.geometry import HeightField, OccupancyGrid, WallGrid
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


WINDOW, SIGMA, K1, K2 = 11, 1.5, 0.01, 0.03  # the paper's


def pictures(seed: int, shape: tuple[int, int] = (31, 42)) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x = rng.choice((0.0, 0.5, 1.0), shape, p=(0.1, 0.3, 0.6))
    return x, np.where(rng.random(shape) < 0.15, rng.choice((0.0, 0.5, 1.0), shape), x)


def twin(x: np.ndarray, y: np.ndarray, row: int, col: int) -> float:
    """Wang et al., Eqs. 13-16, about one pixel, term by term."""
    reach = WINDOW // 2
    weights = np.array(
        [[math.exp(-(r * r + c * c) / (2 * SIGMA**2)) for c in range(-reach, reach + 1)]
         for r in range(-reach, reach + 1)]
    )  # fmt: skip
    weights /= weights.sum()
    # Mirrored at the borders, the outermost pixel twice.
    x, y = np.pad(x, reach, mode="symmetric"), np.pad(y, reach, mode="symmetric")
    square = np.s_[row : row + WINDOW, col : col + WINDOW]
    a, b = x[square], y[square]
    ma, mb = (weights * a).sum(), (weights * b).sum()
    va, vb = (weights * (a - ma) ** 2).sum(), (weights * (b - mb) ** 2).sum()
    cov = (weights * (a - ma) * (b - mb)).sum()
    c1, c2 = K1**2, K2**2
    return float((2 * ma * mb + c1) * (2 * cov + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2)))


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_against_the_equations(seed: int) -> None:
    x, y = pictures(seed)
    ours = similarity(x, y)
    rng = np.random.default_rng(seed)
    for row, col in zip(rng.integers(0, 31, 12).tolist(), rng.integers(0, 42, 12).tolist(), strict=True):
        assert ours[row, col] == pytest.approx(twin(x, y, row, col), abs=1e-9)


def test_against_scikit_image() -> None:
    metrics = pytest.importorskip("skimage.metrics")
    x, y = pictures(5, (120, 90))
    _, theirs = metrics.structural_similarity(
        x, y, gaussian_weights=True, sigma=SIGMA, use_sample_covariance=False, data_range=1.0, full=True
    )
    assert np.allclose(similarity(x, y), theirs, atol=1e-9)


def picture_map(p: np.ndarray, origin: Pose2 | None = None) -> OccupancyGrid:
    return OccupancyGrid.from_probability(p, 0.05, origin)


def test_a_map_resembles_itself_wherever_it_lies() -> None:
    p = np.random.default_rng(1).choice((np.nan, 0.1, 0.9), (40, 50))
    here = picture_map(p, Pose2(1.0, -2.0, 0.4))
    assert map_ssim(here, here) == pytest.approx(1.0)
    far = here.moved(Pose2(500.0, 0.0, 0.0))
    assert map_ssim(far, here) is None
    assert map_ssim(picture_map(np.full((9, 9), np.nan)), picture_map(np.full((9, 9), 0.1))) is None


def test_the_mean_is_over_the_cells_known_in_both() -> None:
    rng = np.random.default_rng(6)
    p, q = (rng.choice((np.nan, 0.1, 0.5, 0.9), (14, 23)) for _ in range(2))
    built = picture_map(p, Pose2(2.0, 3.0))
    reference = picture_map(q, Pose2(2.0 - 2 * 0.05, 3.0 + 3 * 0.05))  # two cells west, three north of it
    there = np.full((14, 23), np.nan)
    there[:-3, 2:] = p[3:, :-2]
    both = ~np.isnan(there) & ~np.isnan(q)
    expected = similarity(as_picture(picture_map(there)), as_picture(reference))[both].mean()
    assert map_ssim(built, reference) == pytest.approx(expected, abs=1e-9)
