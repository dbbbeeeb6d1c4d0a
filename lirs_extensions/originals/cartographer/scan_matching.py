"""Scan matching in a probability grid by the original's two matchers, with Ceres's rules.

The solver, Levenberg-Marquardt with the rules and the defaults of Ceres, stops early (function tolerance
1e-6), so that where it stops is part of the result. Robust losses are the problem's, as weights in its
normal equations.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from lirs_extensions.originals.cartographer.config import CartographerOriginalConfig, CeresMatcher
from lirs_extensions.originals.cartographer.probability_grid import COST, ProbabilityGrid
from lirs_wct.geometry import Float32Array, FloatArray, IntArray, Pose2, njit, wrap_angle

INITIAL_RADIUS, MIN_RADIUS = 1e4, 1e-32
MIN_RELATIVE_DECREASE = 1e-3
MIN_DIAGONAL, MAX_DIAGONAL = 1e-6, 1e32
MAX_NONMONOTONIC_STEPS = 5


class SolverOptions(NamedTuple):
    """Options of the solver by Ceres's names and defaults; `nonmonotonic` steps may raise the cost."""

    function_tolerance: float = 1e-6
    gradient_tolerance: float = 1e-10
    parameter_tolerance: float = 1e-8
    max_radius: float = 1e16
    nonmonotonic: int = 0


DEFAULTS = SolverOptions()


class NormalEquations(NamedTuple):
    """Least-squares problem at one point: half the sum of squared residuals, gradient (n,), J'J.

    The diagonal of J'J is (n,); the hessian is J'J in the form that the problem's `solve` takes.
    """

    cost: float
    gradient: FloatArray
    diagonal: FloatArray
    hessian: Any


class LeastSquares(Protocol):
    """A nonlinear least-squares problem."""

    def evaluate(self, x: FloatArray) -> NormalEquations:
        """Return the normal equations at x (n,)."""
        ...

    def solve(self, equations: NormalEquations, damping: FloatArray) -> FloatArray:
        """Return the (n,) step: -(J'J + diag(damping))^-1 gradient."""
        ...


class StepJudge:
    """Quality of steps that may raise the cost for a while.

    Conn, Gould and Toint 2000, "Trust-region methods", algorithm 10.1.2.
    """

    def __init__(self, cost: float, max_nonmonotonic: int) -> None:
        self._max_nonmonotonic = max_nonmonotonic
        self._least = self._current = self._reference = self._candidate = cost
        self._since_reference = self._since_candidate = 0.0
        self._nonmonotonic = 0

    def quality(self, cost: float, expected: float) -> float:
        """Return the decrease of the cost over the expected one, the better of two.

        They are counted since the last step, and since the reference.
        """
        return max(
            (self._current - cost) / expected, (self._reference - cost) / (self._since_reference + expected)
        )

    def accept(self, cost: float, expected: float) -> None:
        """Take a step with its cost and its expected decrease."""
        self._current = cost
        self._since_reference += expected
        self._since_candidate += expected
        if cost < self._least:
            self._least = self._candidate = cost
            self._nonmonotonic, self._since_candidate = 0, 0.0
        else:
            self._nonmonotonic += 1
            if cost > self._candidate:
                self._candidate, self._since_candidate = cost, 0.0
        if self._nonmonotonic == self._max_nonmonotonic:
            self._reference, self._since_reference = self._candidate, self._since_candidate


def minimize(
    problem: LeastSquares,
    x: FloatArray,
    max_num_iterations: int,
    *,
    options: SolverOptions = DEFAULTS,
    move: Callable[[FloatArray, FloatArray], FloatArray] = np.add,
) -> FloatArray:
    """Return the point (n,) at which the solver stops; `move` adds a step."""
    now = problem.evaluate(x)
    best, least, moved = x, now.cost, False
    judge = StepJudge(now.cost, options.nonmonotonic)
    scale2 = 1 / (1 + np.sqrt(now.diagonal)) ** 2
    radius, shrink = INITIAL_RADIUS, 2.0
    for _ in range(max_num_iterations):
        if np.abs(now.gradient).max() <= options.gradient_tolerance or radius < MIN_RADIUS:
            break
        damping = np.clip(now.diagonal * scale2, MIN_DIAGONAL, MAX_DIAGONAL) / (scale2 * radius)
        step = problem.solve(now, damping)
        expected = 0.5 * float(step @ (damping * step) - now.gradient @ step)
        if expected > 0:
            candidate = move(x, step)
            then = problem.evaluate(candidate)
            # As in Ceres, a step is not too short before one was taken.
            short = options.parameter_tolerance * (float(np.linalg.norm(x)) + options.parameter_tolerance)
            if moved and np.linalg.norm(candidate - x) <= short:
                break
            if abs(now.cost - then.cost) <= options.function_tolerance * now.cost:
                break
            quality = judge.quality(then.cost, expected)
            if quality > MIN_RELATIVE_DECREASE:
                judge.accept(then.cost, expected)
                x, now, moved = candidate, then, True
                radius = min(options.max_radius, radius / max(1 / 3, 1 - (2 * quality - 1) ** 3))
                shrink = 2.0
                if now.cost < least:
                    best, least = x, now.cost
                continue
        radius, shrink = radius / shrink, 2 * shrink
    return best


def match_scan(
    grid: ProbabilityGrid, points: Float32Array, target: Pose2, start: Pose2, matcher: CeresMatcher
) -> Pose2:
    """Return the pose of points (n, 2) in the frame of the grid.

    The cost holds 1 - p at the points, interpolated bicubically, the distance from `target` and the turn from
    `start` (Hess et al. 2016, eq. CS).
    """
    problem = _MatchProblem(grid, points, np.array((target.x, target.y, start.yaw)), matcher)
    options = SolverOptions(nonmonotonic=MAX_NONMONOTONIC_STEPS if matcher.use_nonmonotonic_steps else 0)
    x = minimize(problem, start.as_array(), matcher.max_num_iterations, options=options)
    return Pose2(float(x[0]), float(x[1]), wrap_angle(float(x[2])))


@dataclass(frozen=True)
class _MatchProblem:
    grid: ProbabilityGrid
    points: Float32Array
    prior: FloatArray
    matcher: CeresMatcher

    def evaluate(self, x: FloatArray) -> NormalEquations:
        """Return the normal equations at x, y, yaw."""
        c, H, g = self.matcher, np.zeros((3, 3)), np.zeros(3)
        squares = _occupied_space(
            self.grid.cells, self.grid.corner, self.grid.resolution, COST, self.points, x, H, g
        )
        share = c.occupied_space_weight**2 / len(self.points)
        weights = np.array((c.translation_weight, c.translation_weight, c.rotation_weight)) ** 2
        off = x - self.prior
        H = share * H + np.diag(weights)
        cost = 0.5 * (share * squares + float(off @ (weights * off)))
        return NormalEquations(cost, share * g + weights * off, np.diag(H).copy(), H)

    def solve(self, equations: NormalEquations, damping: FloatArray) -> FloatArray:
        """Return the damped step."""
        step: FloatArray = -np.linalg.solve(equations.hessian + np.diag(damping), equations.gradient)
        return step


@njit
def _occupied_space(
    cells: Any, corner: Any, resolution: float, cost: Any, points: Any, pose: Any, H: Any, g: Any
) -> float:
    """Add to `H` and `g` by residuals 1 - p; return their sum of squares."""
    c, s, scale = math.cos(pose[2]), math.sin(pose[2]), 1 / resolution
    total, J = 0.0, np.empty(3)
    for k in range(len(points)):
        px, py = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
        u = (corner[0] - pose[0] - px) * scale - 0.5
        v = (corner[1] - pose[1] - py) * scale - 0.5
        r, du, dv = interpolate_bicubic(cells, cost, u, v)
        J[0], J[1] = -du * scale, -dv * scale
        J[2] = -J[0] * py + J[1] * px
        total += r * r
        for i in range(3):
            g[i] += J[i] * r
            for j in range(3):
                H[i, j] += J[i] * J[j]
    return total


@njit
def interpolate_bicubic(cells: Any, cost: Any, u: float, v: float) -> tuple[float, float, float]:
    """Return 1 - p at row `u`, column `v`, and its derivatives (Catmull-Rom).

    Centers of cells have whole numbers; cells outside are unknown.
    """
    row, col = math.floor(u), math.floor(v)
    (a0, a1, a2, a3), (d0, d1, d2, d3) = _weights(u - row)
    (b0, b1, b2, b3), (e0, e1, e2, e3) = _weights(v - col)
    f = fu = fv = 0.0
    for i, a, d in ((0, a0, d0), (1, a1, d1), (2, a2, d2), (3, a3, d3)):
        r = row - 1 + i
        p0, p1 = _cell_cost(cells, cost, r, col - 1), _cell_cost(cells, cost, r, col)
        p2, p3 = _cell_cost(cells, cost, r, col + 1), _cell_cost(cells, cost, r, col + 2)
        along = b0 * p0 + b1 * p1 + b2 * p2 + b3 * p3
        f += a * along
        fu += d * along
        fv += a * (e0 * p0 + e1 * p1 + e2 * p2 + e3 * p3)
    return f, fu, fv


@njit(inline="always")
def _weights(t: float) -> Any:
    """Return weights of four samples for value and derivative at 0 <= t < 1."""
    value = (
        0.5 * t * (-1 + t * (2 - t)),
        1 + 0.5 * t * t * (3 * t - 5),
        0.5 * t * (1 + t * (4 - 3 * t)),
        0.5 * t * t * (t - 1),
    )
    slope = (
        0.5 * (-1 + t * (4 - 3 * t)),
        0.5 * t * (9 * t - 10),
        0.5 * (1 + t * (8 - 9 * t)),
        0.5 * t * (3 * t - 2),
    )
    return value, slope


@njit(inline="always")
def _cell_cost(cells: Any, cost: Any, row: int, col: int) -> float:
    if row < 0 or col < 0 or row >= cells.shape[0] or col >= cells.shape[1]:
        return float(cost[0])
    return float(cost[cells[row, col]])


def rotated_cells(
    grid: ProbabilityGrid, points: Float32Array, pose: Pose2, linear: float, angular: float
) -> tuple[IntArray, FloatArray, int]:
    """Return the cells of points (n, 2), turned by each angle of a window.

    These are (angles, n, 2) rows and columns; (angles,) turns, at each of which the farthest point moves by
    less than a cell; and the largest shift in cells. The window is in meters and radians.
    """
    farthest = max(3 * grid.resolution, float(np.hypot(points[:, 0], points[:, 1]).max()))
    step = (1 - 1e-3) * math.acos(1 - grid.resolution**2 / (2 * farthest**2))
    count = math.ceil(angular / step)
    turns = np.arange(-count, count + 1, dtype=np.float64) * step
    ahead = Pose2(yaw=pose.yaw).apply(points)
    c, s = np.cos(turns)[:, None], np.sin(turns)[:, None]
    x, y = c * ahead[:, 0] - s * ahead[:, 1], s * ahead[:, 0] + c * ahead[:, 1]
    placed = np.stack((x + pose.x, y + pose.y), axis=-1)
    return grid.indices(placed), turns, math.ceil(linear / grid.resolution)


def search_online(
    grid: ProbabilityGrid, points: Float32Array, expected: Pose2, config: CartographerOriginalConfig
) -> Pose2:
    """Return the pose with the best score in a small window around the expected one."""
    c = config
    cells, turns, reach = rotated_cells(
        grid, points, expected, c.online_linear_search_window, c.online_angular_search_window
    )
    weights = c.translation_delta_cost_weight, c.rotation_delta_cost_weight
    k, row, col = _best_shift(grid.cells, COST, cells, turns, reach, grid.resolution, weights)
    return shifted_pose(expected, row * grid.resolution, col * grid.resolution, float(turns[k]))


def shifted_pose(pose: Pose2, rows: float, cols: float, turn: float) -> Pose2:
    """Return a pose after a shift by rows and columns, meters, and a turn."""
    return Pose2(pose.x - rows, pose.y - cols, wrap_angle(pose.yaw + turn))


@njit
def _best_shift(
    grid: Any, cost: Any, cells: Any, turns: Any, reach: int, resolution: float, weights: Any
) -> tuple[int, int, int]:
    """Return turn, rows and columns of the best mean probability, less for larger shifts."""
    best, found = -1.0, (0, 0, 0)
    for k in range(len(turns)):
        for col in range(-reach, reach + 1):
            for row in range(-reach, reach + 1):
                total = 0.0
                for i in range(cells.shape[1]):
                    total += 1 - _cell_cost(grid, cost, cells[k, i, 0] + row, cells[k, i, 1] + col)
                away = math.hypot(row, col) * resolution * weights[0] + abs(turns[k]) * weights[1]
                score = total / cells.shape[1] * math.exp(-away * away)
                if score > best:
                    best, found = score, (k, row, col)
    return found
