"""Levenberg-Marquardt with the rules and the defaults of Ceres, on which the original's results depend.

The solver stops early (function tolerance 1e-6), so that where it stops is part of the result. Robust losses
are the problem's, as weights in its normal equations.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Protocol

import numpy as np

from lirs_wct.arrays import FloatArray

FUNCTION_TOLERANCE, GRADIENT_TOLERANCE, PARAMETER_TOLERANCE = 1e-6, 1e-10, 1e-8
INITIAL_RADIUS, MAX_RADIUS, MIN_RADIUS = 1e4, 1e16, 1e-32
MIN_RELATIVE_DECREASE = 1e-3
MIN_DIAGONAL, MAX_DIAGONAL = 1e-6, 1e32
MAX_NONMONOTONIC_STEPS = 5


class NormalEquations(NamedTuple):
    """A least-squares problem at one point.

    Attributes:
        cost: half the sum of squared residuals.
        gradient: (n,) of the cost.
        diagonal: (n,) of J'J.
        hessian: J'J, in the form that the problem's `solve` takes.
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
    problem: LeastSquares, x: FloatArray, max_num_iterations: int, *, nonmonotonic: bool = False
) -> FloatArray:
    """Return the point (n,) at which the solver stops, from a start (n,)."""
    now = problem.evaluate(x)
    best, least = x, now.cost
    judge = StepJudge(now.cost, MAX_NONMONOTONIC_STEPS if nonmonotonic else 0)
    scale2 = 1 / (1 + np.sqrt(now.diagonal)) ** 2
    radius, shrink = INITIAL_RADIUS, 2.0
    for _ in range(max_num_iterations):
        if np.abs(now.gradient).max() <= GRADIENT_TOLERANCE or radius < MIN_RADIUS:
            break
        damping = np.clip(now.diagonal * scale2, MIN_DIAGONAL, MAX_DIAGONAL) / (scale2 * radius)
        step = problem.solve(now, damping)
        expected = 0.5 * float(step @ (damping * step) - now.gradient @ step)
        if expected > 0:
            then = problem.evaluate(x + step)
            if _is_converged(x, step, now.cost - then.cost, now.cost):
                break
            quality = judge.quality(then.cost, expected)
            if quality > MIN_RELATIVE_DECREASE:
                judge.accept(then.cost, expected)
                x, now = x + step, then
                radius = min(MAX_RADIUS, radius / max(1 / 3, 1 - (2 * quality - 1) ** 3))
                shrink = 2.0
                if now.cost < least:
                    best, least = x, now.cost
                continue
        radius, shrink = radius / shrink, 2 * shrink
    return best


def _is_converged(x: FloatArray, step: FloatArray, decrease: float, cost: float) -> bool:
    """Return whether a step is too small to be taken."""
    short = PARAMETER_TOLERANCE * (math.sqrt(float(x @ x)) + PARAMETER_TOLERANCE)
    return math.sqrt(float(step @ step)) <= short or abs(decrease) <= FUNCTION_TOLERANCE * cost
