"""Monitor of large errors of any SLAM method, by its poses alone.

The path of a robot is smooth, and wheels do not move sideways. Steps of the path that leave the velocity
around them, and sideways motion beyond the slip of turns, are errors. Both become an absolute trajectory
error (ATE) over the last meters: the one that they would cause if the rest of the path were right.

Limits: a slow error along the path is not seen, nor are errors at fewer than about four poses a second.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lirs_wct.arrays import FloatArray, njit
from lirs_wct.errors import Checked, limited
from lirs_wct.geometry import Pose2

STEPS, MIDDLE = 15, 7
"""Steps whose median velocity the middle one is compared with: the delay is 7 poses."""
LONG_STEP = 0.25
"""Seconds of a step from which on its sideways motion does not count: the robot may have turned."""
ROUNDING = 0.005
"""Difference from the expected step that is no jump, meters and radians."""
ACCELERATION = 10.0
"""Largest plausible change of the velocity within a step, m/s²; of the rate of turn, 20 rad/s²."""
LENGTH, MIN_LENGTH = 5.0, 1.0
"""Path over which the error is estimated, and from which on there is an estimate, meters."""
CLEAR, HOLD = 0.5, 5.0
"""Share of the limit below which an alarm ends, and its shortest time, seconds."""
SPACING, CAPACITY = 0.01, 2048
"""Meters between two stored poses, and number of stored poses."""
DRIVEN, ESTIMATE, SMOOTH, WHEELED, COLUMNS = 0, 1, 3, 5, 7
"""Columns of the window: meters driven; x, y of the estimate, of the smooth path, of the wheeled path."""
FIRST, END, PATHS, STATE = 0, 1, 2, 8
"""Numbers of its state: first and end row; x, y, yaw of the smooth path and of the wheeled path."""


@dataclass(frozen=True, kw_only=True)
class WatchConfig(Checked):
    """Conditions of an alarm.

    Attributes:
        error: Estimated error above which an alarm begins, meters; it ends below `CLEAR` times that.
        slip: ATE by sideways motion that wheels have in turns and on slopes, meters; inf = the robot can move
            sideways.

    Raises:
        ConfigError: a value is not legal.
    """

    error: float = limited(0.11, "(0, inf)", "m")
    slip: float = limited(0.05, "[0, inf]", "m")


class Watch:
    """Monitor that gives an alarm while a path is implausible.

    >>> watch = Watch()
    >>> for k in range(100):  # a meter aside within a step, at 1 m/s
    ...     alarm = watch.update(Pose2(0.1 * k, 1.0 if k > 50 else 0.0), 0.1 * k)
    >>> [round(stamp, 1) for stamp in watch.alarms]
    [5.8]

    Attributes:
        error: Estimated ATE over the last meters, meters; NaN before enough is driven.
        alarm: Whether the path is implausible at present.
        alarms: Stamps at which alarms began, seconds.
    """

    def __init__(self, config: WatchConfig | None = None) -> None:
        self.error, self.alarm, self.alarms = math.nan, False, list[float]()
        config = config or WatchConfig()
        self._limit, self._slip = config.error, config.slip
        self._poses, self._stamps = np.empty((STEPS + 1, 3)), np.empty(STEPS + 1)
        self._window, self._state = np.empty((CAPACITY, COLUMNS)), np.zeros(STATE)
        self._received, self._exceeded = 0, -math.inf

    def update(self, T_map_base: Pose2, stamp: float) -> bool:
        """Take in the method's online pose of a scan; return whether there is an alarm.

        Args:
            T_map_base: Pose as the method gave it at the time, not as it was corrected later.
            stamp: Time of the scan, seconds.
        """
        self._poses[:-1], self._stamps[:-1] = self._poses[1:], self._stamps[1:]
        self._poses[-1], self._stamps[-1] = T_map_base.as_array(), stamp
        self._received += 1
        if self._received > STEPS:
            self.error = float(_advance(self._poses, self._stamps, self._window, self._state, self._slip))
        if self.error > self._limit:
            self.alarms += [] if self.alarm else [stamp]
            self.alarm, self._exceeded = True, stamp
        elif not self.error > CLEAR * self._limit and stamp - self._exceeded > HOLD:
            self.alarm = False
        return self.alarm


@njit
def _advance(
    poses: FloatArray, stamps: FloatArray, window: FloatArray, state: FloatArray, slip: float
) -> float:
    """Take in the middle step; return the ATE by jumps or by sideways motion.

    The larger one counts, the latter less the slip; NaN where too little is driven. The smooth path makes the
    expected step where the estimate jumps, and the wheeled one none sideways.
    """
    along, across, turn = _plausible_step(poses, stamps)
    sideways = across if stamps[MIDDLE + 1] - stamps[MIDDLE] > LONG_STEP else 0.0
    for path, shift in ((PATHS, across), (PATHS + 3, sideways)):
        heading = state[path + 2] + turn / 2
        c, s = math.cos(heading), math.sin(heading)
        state[path] += c * along - s * shift
        state[path + 1] += s * along + c * shift
        state[path + 2] += turn
    _store(window, state, poses[MIDDLE + 1], math.hypot(along, across))
    rows = window[int(state[FIRST]) : int(state[END])]
    if rows[-1, DRIVEN] - rows[0, DRIVEN] < MIN_LENGTH:
        return math.nan
    error: float = max(_aligned_rms(rows, ESTIMATE, SMOOTH), _aligned_rms(rows, SMOOTH, WHEELED) - slip)
    return error


@njit
def _plausible_step(poses: FloatArray, stamps: FloatArray) -> tuple[float, float, float]:
    """Return the middle step, along and across its mean heading and its turn.

    If it jumps, that is, differs from the step by the median velocity by more than an acceleration explains,
    it is that step.
    """
    times = np.maximum(np.diff(stamps), 1e-3)
    velocities = np.empty((3, STEPS))
    for k in range(STEPS):
        turn = (poses[k + 1, 2] - poses[k, 2] + math.pi) % math.tau - math.pi
        heading = poses[k, 2] + turn / 2
        c, s = math.cos(heading), math.sin(heading)
        dx, dy = poses[k + 1, 0] - poses[k, 0], poses[k + 1, 1] - poses[k, 1]
        velocities[0, k] = (c * dx + s * dy) / times[k]
        velocities[1, k] = (c * dy - s * dx) / times[k]
        velocities[2, k] = turn / times[k]
    limit = ACCELERATION * times[MIDDLE] * times[MIDDLE - 1 : MIDDLE + 2].max() + ROUNDING
    expected = (np.median(velocities[0]), np.median(velocities[1]), np.median(velocities[2]))
    jumps = False
    for k in range(3):
        off = abs(velocities[k, MIDDLE] - expected[k]) * times[MIDDLE]
        jumps |= off > (limit if k < 2 else 2 * limit)
    if not jumps:
        expected = (velocities[0, MIDDLE], velocities[1, MIDDLE], velocities[2, MIDDLE])
    return expected[0] * times[MIDDLE], expected[1] * times[MIDDLE], expected[2] * times[MIDDLE]


@njit
def _store(window: FloatArray, state: FloatArray, pose: FloatArray, step: float) -> None:
    """Add the paths' points to the window, which keeps the last meters."""
    first, end = int(state[FIRST]), int(state[END])
    driven = step if end == first else window[end - 1, DRIVEN] + step
    if end > first + 1:
        last = window[end - 2]
        moved = math.hypot(pose[0] - last[ESTIMATE], pose[1] - last[ESTIMATE + 1])
        if driven - last[DRIVEN] < SPACING and moved < SPACING:
            end -= 1  # the newest row is replaced until it is far enough from the one before
    while first < end - 1 and driven - window[first + 1, DRIVEN] >= LENGTH:
        first += 1
    if end == len(window):  # move the window to the front; of one that fills it, leave out the older half
        first = max(first, end // 2)
        window[: end - first] = window[first:end].copy()
        first, end = 0, end - first
    row = window[end]
    row[DRIVEN] = driven
    row[ESTIMATE], row[ESTIMATE + 1] = pose[0], pose[1]
    row[SMOOTH], row[SMOOTH + 1] = state[PATHS], state[PATHS + 1]
    row[WHEELED], row[WHEELED + 1] = state[PATHS + 3], state[PATHS + 4]
    state[FIRST], state[END] = first, end + 1


@njit
def _aligned_rms(rows: FloatArray, a: int, b: int) -> float:
    """Return the ATE between two columns of points after rigid alignment.

    With points p and q centered, it is sqrt((sum |p|² + |q|² - 2 |sum conj(p) q|) / n) (Umeyama, PAMI 1991).
    """
    n, px, py, qx, qy = len(rows), 0.0, 0.0, 0.0, 0.0
    for row in rows:
        px, py, qx, qy = px + row[a], py + row[a + 1], qx + row[b], qy + row[b + 1]
    px, py, qx, qy = px / n, py / n, qx / n, qy / n
    squares = dot = cross = 0.0
    for row in rows:
        ax, ay, bx, by = row[a] - px, row[a + 1] - py, row[b] - qx, row[b + 1] - qy
        squares += ax * ax + ay * ay + bx * bx + by * by
        dot += ax * bx + ay * by
        cross += ax * by - ay * bx
    return math.sqrt(max(0.0, squares - 2 * math.hypot(dot, cross)) / n)
