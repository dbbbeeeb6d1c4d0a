"""Monitor of large errors of any SLAM method, by its poses and, if there is any, the odometry.

The path of a robot is smooth. Steps of the path that leave the velocity around them are errors. They become
an absolute trajectory error (ATE) over the last meters: the one that they would cause if the rest of the path
were right. A path that is worse than the odometry is also apart from it, by the triangle inequality.

Limits: a slow error is not seen, nor are jumps below `MOST_CHANGE` at ten poses a second or less, nor any at
fewer than four.
"""

from __future__ import annotations

import math

import numpy as np

from lirs_wct.errors import ConfigError
from lirs_wct.geometry import FloatArray, Pose2, njit

STEPS, MIDDLE = 15, 7
"""Steps whose median velocity the middle one is compared with: the delay is 7 poses."""
ROUNDING = 0.005
"""Difference from the expected step that is no jump, meters and radians."""
ACCELERATION, MOST_CHANGE = 30.0, 0.3
"""Largest plausible change of the velocity, m/s², and of a step by it, meters; of turns twice that in rad."""
MAX_STEP = 0.25
"""Step beyond which the robot may have done anything, seconds."""
LENGTH, MIN_LENGTH = 5.0, 1.0
"""Path over which the error is estimated, and from which on there is an estimate, meters."""
BEGINNING = 2.5
"""Path over which the odometry counts alone, since it has hardly drifted, meters."""
LIMIT, AT_START = 0.13, 0.5
"""Estimated error over `LENGTH` above which an alarm begins, meters; the share of it at the start."""
HOLD = 10.0
"""Time for which an alarm goes on below the limit, seconds."""
SPACING, CAPACITY = 0.01, 2048
"""Meters between two stored poses, and number of stored poses."""
DRIVEN, ESTIMATE, SMOOTH, ODOMETRY, COLUMNS = 0, 1, 3, 5, 7
"""Columns of the window: meters driven; x, y of the estimate, of the smooth path, of the odometry."""
FIRST, END, PATH, STATE = 0, 1, 2, 5
"""Numbers of its state: first and end row; x, y, yaw of the smooth path."""


class Watch:
    """Monitor that gives an alarm while a path is implausible.

    >>> watch = Watch()
    >>> for k in range(100):  # a meter aside within a step, at 1 m/s
    ...     alarm = watch.update(Pose2(0.1 * k, 1.0 if k > 50 else 0.0), 0.1 * k)
    >>> [round(stamp, 1) for stamp in watch.alarms]
    [5.8]

    Args:
        limit: Estimated error over 5 m above which an alarm begins, meters. It grows with the driven distance
            from half of that.

    Attributes:
        error: Estimated ATE over the last meters, meters; NaN before enough is driven.
        alarm: Whether the path is implausible at present.
        alarms: Stamps at which alarms began, seconds.

    Raises:
        ConfigError: `limit` is not positive.
    """

    def __init__(self, limit: float = LIMIT) -> None:
        if not limit > 0:
            raise ConfigError(f"limit: must be above 0 m, got {limit:g}")
        self.error, self.alarm, self.alarms = math.nan, False, list[float]()
        self._limit = limit
        self._poses, self._stamps = np.empty((STEPS + 1, 5)), np.empty(STEPS + 1)
        self._window, self._state = np.empty((CAPACITY, COLUMNS)), np.zeros(STATE)
        self._received, self._exceeded = 0, -math.inf

    def update(self, T_map_base: Pose2, stamp: float, T_odom_base: Pose2 | None = None) -> bool:
        """Take in the method's online pose of a scan; return whether there is an alarm.

        Args:
            T_map_base: Pose as the method gave it at the time, not as it was corrected later.
            stamp: Time of the scan, seconds.
            T_odom_base: Pose by the odometry, which keeps some false alarms away; None without.
        """
        self._poses[:-1], self._stamps[:-1] = self._poses[1:], self._stamps[1:]
        self._poses[-1, :3], self._stamps[-1] = T_map_base.as_array(), stamp
        self._poses[-1, 3:] = math.nan if T_odom_base is None else (T_odom_base.x, T_odom_base.y)
        self._received += 1
        if self._received > STEPS:
            self.error, driven = _advance(self._poses, self._stamps, self._window, self._state)
            limit = self._limit * (AT_START + (1 - AT_START) * driven / LENGTH)
            if self.error > limit:
                self.alarms += [] if self.alarm else [stamp]
                self.alarm, self._exceeded = True, stamp
            elif stamp - self._exceeded > HOLD:
                self.alarm = False
        return self.alarm


@njit
def _advance(
    poses: FloatArray, stamps: FloatArray, window: FloatArray, state: FloatArray
) -> tuple[float, float]:
    """Take in the middle step; return the error, and the driven meters of the window.

    The smooth path makes the expected step where the estimate jumps. The error is its ATE to the estimate, or
    that of the odometry if it is less or little is driven; NaN where too little is driven.
    """
    along, across, turn = _plausible_step(poses, stamps)
    heading = state[PATH + 2] + turn / 2
    c, s = math.cos(heading), math.sin(heading)
    state[PATH] += c * along - s * across
    state[PATH + 1] += s * along + c * across
    state[PATH + 2] += turn
    _store(window, state, poses[MIDDLE + 1], math.hypot(along, across))
    rows = window[int(state[FIRST]) : int(state[END])]
    driven: float = rows[-1, DRIVEN] - rows[0, DRIVEN]
    if driven < MIN_LENGTH:
        return math.nan, driven
    error, apart = _aligned_rms(rows, ESTIMATE, SMOOTH), _aligned_rms(rows, ESTIMATE, ODOMETRY)
    if apart < error or (driven < BEGINNING and not math.isnan(apart)):
        error = apart
    return error, driven


@njit
def _plausible_step(poses: FloatArray, stamps: FloatArray) -> tuple[float, float, float]:
    """Return the middle step: along and across its mean heading, and its turn.

    A step is a jump if no acceleration explains how it differs from the median velocity. The step by the
    median velocity then replaces it.
    """
    times, velocities = np.empty(STEPS), np.empty((3, STEPS))
    for k in range(STEPS):
        times[k] = max(stamps[k + 1] - stamps[k], 1e-3)
        turn = (poses[k + 1, 2] - poses[k, 2] + math.pi) % math.tau - math.pi
        heading = poses[k, 2] + turn / 2
        c, s = math.cos(heading), math.sin(heading)
        dx, dy = poses[k + 1, 0] - poses[k, 0], poses[k + 1, 1] - poses[k, 1]
        velocities[0, k] = (c * dx + s * dy) / times[k]
        velocities[1, k] = (c * dy - s * dx) / times[k]
        velocities[2, k] = turn / times[k]
    longest = max(times[MIDDLE - 1], times[MIDDLE], times[MIDDLE + 1])
    limit = min(ACCELERATION * times[MIDDLE] * longest, MOST_CHANGE) + ROUNDING
    expected = (_median(velocities[0]), _median(velocities[1]), _median(velocities[2]))
    jumps = False
    for k in range(3):
        off = abs(velocities[k, MIDDLE] - expected[k]) * times[MIDDLE]
        jumps |= longest <= MAX_STEP and off > (limit if k < 2 else 2 * limit)
    if not jumps:
        expected = (velocities[0, MIDDLE], velocities[1, MIDDLE], velocities[2, MIDDLE])
    return expected[0] * times[MIDDLE], expected[1] * times[MIDDLE], expected[2] * times[MIDDLE]


@njit
def _median(values: FloatArray) -> float:
    """Return the median of an odd number of values; NumPy's takes the compiler seconds."""
    for value in values:
        below, not_above = 0, 0
        for other in values:
            below += other < value
            not_above += other <= value
        if below <= len(values) // 2 < not_above:
            return float(value)
    return math.nan


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
        for k in range(first, end):
            for column in range(COLUMNS):
                window[k - first, column] = window[k, column]
        first, end = 0, end - first
    row = window[end]
    row[DRIVEN] = driven
    row[ESTIMATE], row[ESTIMATE + 1] = pose[0], pose[1]
    row[SMOOTH], row[SMOOTH + 1] = state[PATH], state[PATH + 1]
    row[ODOMETRY], row[ODOMETRY + 1] = pose[3], pose[4]
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
    return math.sqrt(np.maximum(0.0, squares - 2 * math.hypot(dot, cross)) / n)  # NaN stays NaN
