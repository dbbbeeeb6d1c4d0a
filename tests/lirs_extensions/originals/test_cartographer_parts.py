"""Parts of Cartographer as published, each against an independent computation."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import least_squares

from lirs_extensions.originals.cartographer.config import CartographerOriginalConfig
from lirs_extensions.originals.cartographer.local_slam import PoseExtrapolator
from lirs_extensions.originals.cartographer.pose_graph import (
    LoopSearcher,
    PoseGraphProblem,
    adjust,
    bound_grids,
    pose_constraint,
)
from lirs_extensions.originals.cartographer.probability_grid import (
    COST,
    ProbabilityGrid,
    RangeData,
    _drawn,
    _sorted_order,
    adaptive_voxel_filter,
    update_table,
    voxel_filter,
)
from lirs_extensions.originals.cartographer.scan_matching import (
    NormalEquations,
    SolverOptions,
    _MatchProblem,
    interpolate_bicubic,
    minimize,
    rotated_cells,
    search_online,
)
from lirs_wct import Pose2
from lirs_wct.geometry import relative_poses
from slam_baselines.cartographer.pose_graph import PoseConstraints

HIT, MISS = update_table(0.55), update_table(0.49)


def wall_points(n: int = 120) -> np.ndarray:
    """A corner of two walls, with a notch, around the origin."""
    t = np.linspace(-1.5, 1.5, n)
    walls = [np.stack((np.full(n, 1.9), t), -1), np.stack((t, np.full(n, -1.7)), -1)]
    return np.concatenate((*walls, np.stack((t[:30], 1.2 + 0.2 * t[:30]), -1))).astype(np.float32)


def drawn_grid(scans: int = 30) -> ProbabilityGrid:
    grid, nowhere = ProbabilityGrid(0.05, np.zeros(2)), np.zeros((0, 2), np.float32)
    for _ in range(scans):
        grid.insert(RangeData(np.zeros(2, np.float32), wall_points(), nowhere), HIT, MISS)
    return grid


def test_a_new_rate_turns_the_heading_one_scan_late() -> None:
    """Odometry that begins to turn at the third scan: the heading follows at the fourth."""
    extrapolator, pose = PoseExtrapolator(), Pose2()
    extrapolator.add_pose(0.0, pose)
    predicted = []
    for k, (x, yaw) in enumerate(((0.1, 0.0), (0.2, 0.0), (0.3, 0.1), (0.4, 0.2)), start=1):
        extrapolator.add_odometry(0.1 * k, Pose2(x, 0.0, yaw))
        pose = extrapolator.predict(0.1 * k)
        predicted.append(pose)
        extrapolator.add_pose(0.1 * k, pose)
    assert [round(p.yaw, 9) for p in predicted] == [0.0, 0.0, 0.0, 0.1]
    # One odometry gives no velocity yet.
    assert [round(math.hypot(p.x, p.y), 3) for p in predicted[:3]] == [0.0, 0.1, 0.2]
    assert extrapolator.heading == pytest.approx(0.1)


def test_without_odometry_the_last_two_poses_predict() -> None:
    extrapolator = PoseExtrapolator()
    for k in range(3):
        extrapolator.add_pose(0.1 * k, Pose2(0.1 * k, 0.2 * k, 0.05 * k))
    pose = extrapolator.predict(0.4)
    assert (pose.x, pose.y, pose.yaw) == pytest.approx((0.4, 0.8, 0.2))


def test_probabilities_multiply_as_odds_within_their_limits() -> None:
    step = 0.8 / 32766
    for table, p in ((HIT, 0.55), (MISS, 0.49)):
        value, odds = np.uint16(0), 1.0
        for _ in range(5):
            value, odds = table[value] - np.uint16(32768), odds * p / (1 - p)
            assert 1 - COST[value] == pytest.approx(odds / (1 + odds), abs=5 * step)
    assert 1 - COST[0] == pytest.approx(0.1)
    assert COST[1] == pytest.approx(0.1)
    value = np.uint16(0)
    for _ in range(100):
        value = HIT[value] - np.uint16(32768)
    assert 1 - COST[value] == pytest.approx(0.9)


def test_a_scan_updates_each_cell_once_and_a_hit_wins() -> None:
    """Cells passed: those that points closely spaced along the beams fall into."""
    rng = np.random.default_rng(1)
    ends = rng.uniform(-6, 6, (40, 2)).astype(np.float32)
    grid = ProbabilityGrid(0.05, np.zeros(2))
    grid.insert(RangeData(np.zeros(2, np.float32), ends[:20], ends[20:]), HIT, MISS)
    hit = np.zeros(grid.cells.shape, bool)
    hit[tuple(grid.indices(ends[:20]).T)] = True
    passed = np.zeros_like(hit)
    along = np.linspace(0, 1, 20001)[:, None]
    for end in ends:
        passed[tuple(grid.indices(along * end).T)] = True
    np.testing.assert_array_equal(grid.cells == HIT[0] - 32768, hit)
    missed = grid.cells == MISS[0] - 32768
    assert not (missed & hit).any()
    # The corner of a cell may lie between two samples, and ends are rounded to 50 um.
    assert (missed != (passed & ~hit)).sum() <= 0.005 * passed.sum()


def test_a_grid_grows_and_is_cropped_without_moving_its_cells() -> None:
    small, far = drawn_grid(1), np.array([[30.0, -20.0]], np.float32)
    at = [small.cells[tuple(index)] for index in small.indices(wall_points())]
    small.insert(RangeData(far[0], far, far[:0]), HIT, MISS)
    cropped = small.crop()
    for grid in (small, cropped):
        assert [grid.cells[tuple(index)] for index in grid.indices(wall_points())] == at
    assert cropped.cells.size < small.cells.size


def test_interpolation_is_catmull_rom_s() -> None:
    rng = np.random.default_rng(2)
    cells = rng.integers(0, 32768, (12, 9)).astype(np.uint16)
    values = COST[cells].astype(float)

    def spline(samples: np.ndarray, t: float) -> tuple[float, float]:
        inner = np.arange(1, len(samples) - 1)
        curve = CubicHermiteSpline(inner, samples[1:-1], (samples[2:] - samples[:-2]) / 2)
        return float(curve(t)), float(curve(t, 1))

    for u, v in rng.uniform((1.1, 1.1), (9.9, 6.9), (20, 2)):
        rows = np.array([spline(row, v) for row in values])
        f, fu = spline(rows[:, 0], u)
        assert interpolate_bicubic(cells, COST, u, v) == pytest.approx((f, fu, spline(rows[:, 1], u)[0]))
    assert interpolate_bicubic(cells, COST, -5.0, 40.0) == pytest.approx((0.9, 0.0, 0.0))


def test_the_matcher_s_equations_are_those_of_its_residuals() -> None:
    grid, points, config = drawn_grid(), wall_points(), CartographerOriginalConfig().ceres_matcher
    problem = _MatchProblem(grid, points, np.array((0.01, 0.0, 0.02)), config)
    x, h = np.array((0.02, -0.03, 0.01)), 1e-6
    at = problem.evaluate(x)
    numeric = [(problem.evaluate(x + d).cost - problem.evaluate(x - d).cost) / (2 * h) for d in np.eye(3) * h]
    np.testing.assert_allclose(at.gradient, numeric, rtol=1e-5)


class Valley:
    """Rosenbrock's function as residuals 10 (y - x^2) and 1 - x."""

    def evaluate(self, x: np.ndarray) -> NormalEquations:
        r = np.array((10 * (x[1] - x[0] ** 2), 1 - x[0]))
        J = np.array(((-20 * x[0], 10.0), (-1.0, 0.0)))
        H = J.T @ J
        return NormalEquations(0.5 * float(r @ r), J.T @ r, np.diag(H).copy(), H)

    def solve(self, equations: NormalEquations, damping: np.ndarray) -> np.ndarray:
        return -np.linalg.solve(equations.hessian + np.diag(damping), equations.gradient)


@pytest.mark.parametrize("nonmonotonic", [0, 5])
def test_the_solver_finds_the_bottom_of_a_valley(nonmonotonic: int) -> None:
    start, options = np.array((-1.2, 1.0)), SolverOptions(nonmonotonic=nonmonotonic)
    np.testing.assert_allclose(minimize(Valley(), start, 100, options=options), 1.0, atol=1e-4)
    costs = [Valley().evaluate(minimize(Valley(), start, n, options=options)).cost for n in range(20)]
    assert all(b <= a for a, b in pairwise(costs))


def test_the_solver_takes_a_step_before_one_can_be_too_short() -> None:
    start, tolerant = np.array((-1.2, 1.0)), SolverOptions(parameter_tolerance=10.0)
    points = [minimize(Valley(), start, n) for n in range(9)]
    first = next(point for point in points if not np.array_equal(point, start))
    np.testing.assert_array_equal(minimize(Valley(), start, 100, options=tolerant), first)


def test_the_library_s_sort_and_random_numbers() -> None:
    """std::sort of 20 equal elements, and the draws of std::minstd_rand0, by libstdc++."""
    assert _sorted_order(20).tolist() == [10, *range(19, 10, -1), 0, *range(9, 0, -1)]
    assert sorted(_sorted_order(541).tolist()) == list(range(541))
    for points, kept in ((3, 0), (10, 3), (39, 10)):
        assert np.flatnonzero(_drawn(np.zeros(points, np.int64), 1)).tolist() == [kept]


def test_voxels_keep_one_point_each() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-3, 3, (500, 2)).astype(np.float32)
    kept = voxel_filter(points, 0.5)
    voxels = {tuple(v) for v in np.floor(points / 0.5 + 0.5).astype(int).tolist()}
    assert {tuple(v) for v in np.floor(kept / 0.5 + 0.5).astype(int).tolist()} == voxels
    assert len(kept) == len(voxels)
    config = CartographerOriginalConfig()
    assert len(adaptive_voxel_filter(points[:150], config)) == 150
    assert 200 <= len(adaptive_voxel_filter(points, config)) < 260


def mean_probability(grid: ProbabilityGrid, cells: np.ndarray) -> float:
    inside = ((cells >= 0) & (cells < grid.cells.shape)).all(axis=1)
    return float(
        np.where(inside, 1 - COST[grid.cells[tuple(np.where(inside[:, None], cells, 0).T)]], 0.1).mean()
    )


def test_bounds_hold_the_largest_cell_below_them() -> None:
    bounds = bound_grids(drawn_grid().crop(), 4)
    rng = np.random.default_rng(4)
    for level in range(4):
        width = 1 << level
        for row, col in rng.integers(0, np.array(bounds.shape[1:]) - width, (50, 2)):
            assert bounds[level, row, col] == bounds[0, row : row + width, col : col + width].max()


def test_the_loop_search_finds_the_best_of_all_poses() -> None:
    grid, points = drawn_grid().crop(), wall_points(40)
    config = CartographerOriginalConfig(
        linear_search_window=0.4, angular_search_window=0.1, branch_and_bound_depth=3, min_score=0.3
    )
    expected = Pose2(0.22, -0.17, 0.05)
    cells, _, reach = rotated_cells(grid, points, expected, 0.4, 0.1)
    shifts = range(-reach, reach + 1)
    best = max(
        mean_probability(grid, turned + np.array((r, c))) for turned in cells for r in shifts for c in shifts
    )
    found = LoopSearcher(grid, config).search(points, expected)
    assert found is not None
    pose, score = found
    assert score == pytest.approx(best, abs=0.004)
    assert pose.distance(Pose2()) < grid.resolution
    assert LoopSearcher(grid, CartographerOriginalConfig()).search(points + 50, expected) is None


def test_the_online_search_prefers_small_shifts() -> None:
    grid, points = drawn_grid(), wall_points()
    found = search_online(grid, points, Pose2(0.1, -0.05, 0.2), CartographerOriginalConfig())
    assert found.distance(Pose2()) < 0.03
    assert abs(found.yaw) < 0.02
    unknown = ProbabilityGrid(0.05, np.zeros(2))
    stay = search_online(unknown, points, Pose2(0.1, -0.05, 0.2), CartographerOriginalConfig())
    assert (stay.x, stay.y, stay.yaw) == pytest.approx((0.1, -0.05, 0.2))


def test_odometry_and_local_slam_weigh_the_same() -> None:
    """Local SLAM says 1 m from node to node, odometry 2 m: with published weights the mean."""
    near, far = Pose2(1.0), Pose2(2.0)
    to_submaps = [
        pose_constraint(0, 0, Pose2(), (500.0, 1600.0)),
        pose_constraint(0, 1, near, (500.0, 1600.0)),
    ]
    chain = [pose_constraint(0, 1, moved, (1e5, 1e5)) for moved in (near, far)]
    _, (first, second) = adjust([Pose2()], [Pose2(), near], to_submaps, chain, 10.0, [50])
    assert first.distance(second) == pytest.approx(1.5, abs=1e-4)


def test_the_adjusted_graph_is_scipy_s() -> None:
    rng = np.random.default_rng(5)
    submaps = [Pose2(), Pose2(2.0, 0.3, 0.1)]
    nodes = [Pose2(*p) for p in rng.normal(0, 1, (6, 3))]
    to_submaps = [
        pose_constraint(s, n, Pose2(*rng.normal(0, 1, 3)), (3.0, 5.0), loop=(s + n) % 3 == 0)
        for s in range(2)
        for n in range(6)
    ]
    chain = [
        pose_constraint(n, n + 1, Pose2(*rng.normal(0, 1, 3)), (4.0, 2.0)) for n in range(5) for _ in range(2)
    ]
    problem = PoseGraphProblem(
        np.zeros(3), 2, PoseConstraints.stack(to_submaps), PoseConstraints.stack(chain), 10.0
    )

    def residuals(x: np.ndarray) -> np.ndarray:
        """Residuals whose squares sum to twice the cost, Huber's loss included."""
        s, n = problem.poses(x)
        found = []
        for a, b, constraint in [(s[t.a], n[t.b], t) for t in to_submaps] + [
            (n[t.a], n[t.b], t) for t in chain
        ]:
            e = relative_poses(a, b) - constraint.z
            e[2] = math.remainder(e[2], math.tau)
            r = np.sqrt(np.diag(constraint.information)) * e
            length = float(np.linalg.norm(r))
            if constraint.robust and length > 10:
                r *= math.sqrt(10 * (2 * length - 10)) / length
            found.extend(r)
        return np.array(found)

    start = np.array([p.as_array() for p in (submaps[1], *nodes)]).ravel()
    at = problem.evaluate(start)
    assert at.cost == pytest.approx(0.5 * float((residuals(start) ** 2).sum()))
    reference = least_squares(residuals, start, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    ours = problem.evaluate(minimize(problem, start, 200)).cost
    assert ours == pytest.approx(reference.cost, rel=1e-3)
    after, _ = adjust(submaps, nodes, to_submaps, chain, 10.0, [200])
    assert after[0] == Pose2()
