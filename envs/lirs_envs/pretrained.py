"""Navigation policy with memory: a recurrent network chooses headings, `GoToGoal` steers along them.

The network sees the scan, its own path and the goal in a frame whose x axis points to the goal, and chooses
one of 36 headings every 0.4 m at full speed. Its memory is a gated recurrent unit (GRU, Cho et al., "Learning
phrase representations using RNN encoder-decoder for statistical machine translation", 2014). NumPy evaluates
it; `examples/train_pretrained.py` trained the weights.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from lirs_envs.policies import HORIZON, GoToGoal, PolicyContext
from lirs_wct.arrays import Float32Array, FloatArray, njit
from lirs_wct.errors import SourceError, reason_of

HEADINGS = 36
"""Headings to choose from, the first opposite to the goal, counter-clockwise."""
GOALWARD = HEADINGS // 2
"""The heading straight to the goal."""
SCAN_SECTORS, PATH_SECTORS = 72, 36
"""Sectors of the scan and of the robot's path, the first from straight behind the goal."""
FEATURES = 2 * SCAN_SECTORS + PATH_SECTORS + 13
"""Inputs of the network."""
STRIDE = 0.4
"""Distance at full speed between two choices, meters."""
PERIODS = (0.4, 1.2)
"""Least and largest time between two choices, seconds."""
TOP_SPEED = 1.0
"""Speed limit, m/s."""
OLD_PATH = 1.5
"""Last part of the path that is no input, meters."""
STUCK = 6.0
"""Time within 0.3 m after which the robot backs off, seconds."""
WEIGHTS = "navigation.npz"
"""File of the weights that ship."""

Weights = Mapping[str, Float32Array]
"""Arrays by name, as `GRU` and `Linear` of torch name theirs."""


class HeadingSteering(GoToGoal):
    """Steering along chosen headings; a subclass or a program chooses.

    While `due`, pass `features` to something that chooses, and its choice to `choose`; then `act`.
    """

    observe = ("scan", "goal", "odometry")

    def __init__(self, context: PolicyContext) -> None:
        robot = context.robot
        self._limit = min(1.0, TOP_SPEED / robot.max_speed)
        period = float(np.clip(STRIDE / min(robot.max_speed, TOP_SPEED), *PERIODS))
        self._hold = max(1, round(period / context.period))
        self._figures = robot.radius, context.lidar.range_max / 30.0
        super().__init__(context)

    def reset(self, info: Mapping[str, Any]) -> None:
        """Begin an episode."""
        super().reset(info)
        self._left, self._yaw, self._offset = 0, 0.0, math.nan
        self._path: list[tuple[float, float, float]] = []
        self._first = self._least = math.nan
        self._anchor, self._stuck = (math.inf, math.inf), 0.0

    @property
    def due(self) -> bool:
        """Whether the next step needs a choice."""
        return self._left == 0

    def features(self, observation: Mapping[str, Any]) -> Float32Array:
        """Return the network's inputs (`FEATURES`,), and add a place to the path."""
        distance, bearing = (float(value) for value in observation["goal"])
        x, y, yaw = (float(value) for value in observation["odometry"])
        goalward = yaw + bearing
        before = self._path[-1] if self._path else (x, y, 0.0)
        step = math.hypot(x - before[0], y - before[1])
        self._path.append((x, y, before[2] + step))
        if len(self._path) == 1:
            self._first = self._least = distance
        self._least = min(self._least, distance)
        c, s = math.cos(goalward), math.sin(goalward)
        dx, dy = x - before[0], y - before[1]
        chosen = self._yaw - goalward
        scalars = (
            math.cos(bearing),
            math.sin(bearing),
            min(distance / 30.0, 1.0),
            1.0 / (1.0 + distance),
            (c * dx + s * dy) / STRIDE,
            (c * dy - s * dx) / STRIDE,
            0.0 if math.isnan(self._offset) else math.cos(chosen),
            0.0 if math.isnan(self._offset) else math.sin(chosen),
            *self._figures,
            min(self._first / 30.0, 1.0),
            (distance - self._least) / 10.0,
            min(self._path[-1][2] / 60.0, 1.0),
        )
        scan, places = np.asarray(observation["scan"], np.float64), np.array(self._path)
        points = np.minimum(scan, self._range_max)[:, None] * self._beams + self._mount
        old = places[places[-1, 2] - places[:, 2] > OLD_PATH, :2]
        around = _polar(points[scan > 0.0], bearing, SCAN_SECTORS).ravel()
        before_here = _polar(old - places[-1, :2], goalward, PATH_SECTORS)[0]
        return np.concatenate((around, before_here, scalars)).astype(np.float32)

    def choose(self, heading: int, observation: Mapping[str, Any]) -> None:
        """Follow one of the `HEADINGS` until the next choice."""
        bearing, yaw = float(observation["goal"][1]), float(observation["odometry"][2])
        self._offset = (heading - GOALWARD) * math.tau / HEADINGS
        self._yaw = yaw + bearing + self._offset
        self._left = self._hold

    def act(self, observation: Mapping[str, Any]) -> Float32Array:
        """Return the action along the chosen heading."""
        distance, bearing = (float(value) for value in observation["goal"])
        x, y, yaw = (float(value) for value in observation["odometry"])
        self._left = max(0, self._left - 1)
        if math.hypot(x - self._anchor[0], y - self._anchor[1]) > 0.3:
            self._anchor, self._stuck = (x, y), 0.0
        self._stuck += self._period
        if self._offset != 0.0:
            distance, bearing = HORIZON, math.remainder(self._yaw - yaw, math.tau)
        action = super().act({"scan": observation["scan"], "goal": (distance, bearing)})
        action[0] = np.clip(action[0], -self._limit, self._limit)
        return action

    def _must_back_off(self, distance: float) -> bool:
        """Whether the robot is backing off, which it does when it stays in one place."""
        if self._stuck > STUCK and self._backing <= 0:
            self._backing, self._stuck = 1.5, 0.0
            self._side = float(self._rng.choice((-1.0, 1.0)))
        self._backing -= self._period
        return self._backing > 0


@njit
def _polar(points: FloatArray, zero: float, sectors: int) -> FloatArray:
    """Return the least and the largest distance of points (n, 2) in each sector, scaled.

    Row 0 is 1 / (1 + least), row 1 is largest / 8 m, at most 1; without a point both are 0. The first sector
    begins opposite to the direction `zero`.
    """
    found = np.zeros((2, sectors))
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        turn = (math.atan2(y, x) - zero + math.pi) / math.tau
        s = min(int((turn - math.floor(turn)) * sectors), sectors - 1)
        r = math.sqrt(x * x + y * y)
        found[0, s] = max(found[0, s], 1.0 / (1.0 + r))
        found[1, s] = max(found[1, s], min(r / 8.0, 1.0))
    return found


def initial_memory(weights: Weights, count: int) -> Float32Array:
    """Return the memory (count, units) of episodes that begin."""
    return np.zeros((count, weights["memory.weight_hh"].shape[1]), np.float32)


def evaluate(weights: Weights, features: Float32Array, memory: Float32Array) -> tuple[Any, Any]:
    """Return scores (n, `HEADINGS`) of the headings and the next memory (n, units)."""
    x = np.maximum(_linear(weights, "encoder", features), 0.0)
    new = x @ weights["memory.weight_ih"].T + weights["memory.bias_ih"]
    kept = memory @ weights["memory.weight_hh"].T + weights["memory.bias_hh"]
    (r1, z1, n1), (r2, z2, n2) = np.split(new, 3, axis=1), np.split(kept, 3, axis=1)
    reset, update = (0.5 * (1.0 + np.tanh(0.5 * gate)) for gate in (r1 + r2, z1 + z2))  # sigmoids
    memory = (1.0 - update) * np.tanh(n1 + reset * n2) + update * memory
    hidden = np.maximum(_linear(weights, "mixer", np.concatenate((x, memory), axis=1)), 0.0)
    return _linear(weights, "head", hidden), memory


def _linear(weights: Weights, name: str, x: Float32Array) -> Any:
    return x @ weights[f"{name}.weight"].T + weights[f"{name}.bias"]


@cache
def load_weights() -> Weights:
    """Return the weights of this package."""
    with resources.as_file(resources.files("lirs_envs") / "weights" / WEIGHTS) as path:
        return read_weights(path)


def read_weights(path: Path) -> Weights:
    """Return weights of a file that `examples/train_pretrained.py` wrote."""
    try:
        with np.load(path, allow_pickle=False) as held:
            weights = {name: held[name] for name in held}
        evaluate(weights, np.zeros((1, FEATURES), np.float32), initial_memory(weights, 1))
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, IndexError, BadZipFile) as error:
        raise SourceError(f"{path}: not weights of this network: {reason_of(error)}") from error
    return weights


class Pretrained(HeadingSteering):
    """The policy whose weights ship.

    Args:
        weights: a file with other weights; None = those of this package.
    """

    def __init__(self, context: PolicyContext, weights: str | Path | None = None) -> None:
        self._weights = load_weights() if weights is None else read_weights(Path(weights))
        super().__init__(context)

    def reset(self, info: Mapping[str, Any]) -> None:
        """Begin an episode."""
        super().reset(info)
        self._memory = initial_memory(self._weights, 1)

    def act(self, observation: Mapping[str, Any]) -> Float32Array:
        """Return the action; a heading is chosen where a choice is due."""
        if self.due:
            scores, self._memory = evaluate(self._weights, self.features(observation)[None], self._memory)
            self.choose(int(np.argmax(scores)), observation)
        return super().act(observation)
