"""Groups of observations, of N robots at once: row i is robot i's."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces

from lirs_envs.lidar.presets import LidarPreset
from lirs_envs.tasks.task import Stage, Task
from lirs_wct.arrays import BoolArray, ByteArray, Float32Array, FloatArray, IntArray, njit
from lirs_wct.errors import ConfigError, require_known

MAP_CELLS = 64
"""Cells along a side of the seen map, of 0.25 m each."""
HEIGHT_CELLS, HEIGHT_CELL = 32, 0.2
"""Cells along a side of the height map, and their edge in meters."""
NO_GROUND = -1000.0
"""Value of the height map beyond the border and where the world has no ground, meters."""
SECTORS = 36
"""Sectors of equal width around the robot, the first from straight behind it to the right."""
SCANS = 4
"""Scans in a history."""
GOAL_SCALE = 30.0
"""Goal distance that is scaled to 1, meters; larger distances are clipped to 1."""


class Memory(Protocol):
    """State of an observation group, row by row."""

    def begin(self, i: int) -> None:
        """Forget the last episode of robot `i`, which stands at its start."""

    def step(self, ids: IntArray) -> None:
        """Take in a step of robots `ids`."""

    def read(self, ids: IntArray) -> Any:
        """Return values (n, ...) in a new array; reading changes nothing."""


@dataclass(frozen=True)
class Group:
    """A group of observations.

    Attributes:
        space: Function that returns the space of one robot.
        read: Function that returns values (n, ...) of some robots in a new array; None = `memory` does.
        memory: Function that returns the group's state for all robots; None = the group has none. Groups
            with the same function share the state.
        recall: Function that returns values (n, ...) of some robots from the state; None = its `read`.
        privileged: Whether the values are simulator-only data; `bench` marks policies that get them.
    """

    space: Callable[[Stage], spaces.Box]
    read: Callable[[Stage, Task, IntArray], Any] | None = None
    memory: Callable[[Stage, Task], Memory] | None = None
    recall: Callable[[Any, IntArray], Any] | None = None
    privileged: bool = False


class Observations:
    """The groups that a user chose.

    Attributes:
        space: Observation space of one robot.
    """

    def __init__(self, names: Sequence[str], stage: Stage, task: Task) -> None:
        if isinstance(names, str) or not names:
            raise ConfigError(f"observe must be a list of groups ({', '.join(GROUPS)}), got {names!r}")
        for name in names:
            require_known("group of observations", name, GROUPS)
        self._names, self._stage, self._task = tuple(names), stage, task
        self.space = spaces.Dict({name: GROUPS[name].space(stage) for name in self._names})
        makers = {name: make for name in self._names if (make := GROUPS[name].memory) is not None}
        states = {make: make(stage, task) for make in makers.values()}
        self._memories = {name: states[make] for name, make in makers.items()}
        self._states = tuple(states.values())

    def begin(self, i: int) -> None:
        """Begin an episode of robot `i`."""
        for memory in self._states:
            memory.begin(i)

    def step(self, ids: IntArray) -> None:
        """Take in a step of robots `ids`."""
        for memory in self._states:
            memory.step(ids)

    def read(self, ids: IntArray) -> dict[str, Any]:
        """Return new (n, ...) arrays of the chosen groups."""
        values = {}
        for name in self.space.spaces:
            group, memory = GROUPS[name], self._memories.get(name)
            if group.read is not None:
                values[name] = group.read(self._stage, self._task, ids)
            elif memory is not None:
                values[name] = memory.read(ids) if group.recall is None else group.recall(memory, ids)
        return values


def _scan_space(stage: Stage, *steps: int) -> spaces.Box:
    preset = stage.simulation.preset
    return spaces.Box(0.0, np.float32(preset.range_max), (*steps, preset.beams), np.float32)


def _scan(stage: Stage, task: Task, ids: IntArray) -> Float32Array:
    ranges = stage.simulation.ranges[ids]
    make_finite(ranges, np.float32(stage.simulation.preset.range_max))
    return ranges


@njit
def make_finite(ranges: Float32Array, range_max: float) -> None:
    """Replace ranges without hit by `range_max`, and too short or lost ones by 0."""
    for i in range(ranges.shape[0]):
        for k in range(ranges.shape[1]):
            if not ranges[i, k] > 0.0:
                ranges[i, k] = 0.0
            elif ranges[i, k] > range_max:
                ranges[i, k] = range_max


class ScanHistory:
    """Scans of the last steps (N, steps, beams), the newest first."""

    def __init__(self, stage: Stage, task: Task, steps: int = SCANS) -> None:
        self._stage, self._task = stage, task
        self._scans = np.zeros((stage.count, steps, stage.simulation.preset.beams), np.float32)

    def begin(self, i: int) -> None:
        """Fill the history of robot `i` with its first scan."""
        self._scans[i] = _scan(self._stage, self._task, np.array((i,)))

    def step(self, ids: IntArray) -> None:
        """Add the present scans."""
        self._scans[ids, 1:] = self._scans[ids, :-1]
        self._scans[ids, 0] = _scan(self._stage, self._task, ids)

    def read(self, ids: IntArray) -> Float32Array:
        """Return (n, steps, beams) meters."""
        return self._scans[ids]


def scan_history(steps: int) -> Group:
    """Return a group of the last scans, the newest first."""
    if not (isinstance(steps, int) and not isinstance(steps, bool) and steps >= 1):
        raise ConfigError(f"a history of scans needs a whole number of steps from 1 up, got {steps!r}")

    return Group(lambda stage: _scan_space(stage, steps), memory=partial(ScanHistory, steps=steps))


def scan_sectors(ranges: Float32Array, lidar: LidarPreset) -> Float32Array:
    """Return (n, 36) proximities of scans (n, beams) (see `GROUPS`)."""
    proximity = np.empty((len(ranges), SECTORS), np.float32)
    angles = lidar.angle_min + lidar.angle_increment * np.arange(lidar.beams)
    # A beam on the border of two sectors belongs to the left one, whatever the rounding.
    sector_of = np.floor((angles + math.pi) * SECTORS / math.tau + 1e-9).astype(np.int64) % SECTORS
    _find_proximity(ranges, sector_of, lidar.range_max, proximity)
    return proximity


@njit
def _find_proximity(ranges: Float32Array, sector_of: IntArray, range_max: float, out: Float32Array) -> None:
    """Fill the proximity (n, sectors) 1 / (1 + r) of each sector, r meters its least range above 0.

    1 = none of its beams is above 0, 0 = no beam goes there.
    """
    out[:] = 0.0
    for i in range(len(ranges)):
        for k in range(len(sector_of)):
            if ranges[i, k] > 0.0:
                s = sector_of[k]
                out[i, s] = max(out[i, s], np.float32(1.0 / (1.0 + min(ranges[i, k], range_max))))
        for k in range(len(sector_of)):
            if out[i, sector_of[k]] == 0.0:
                out[i, sector_of[k]] = 1.0


def _body(stage: Stage, task: Task, ids: IntArray) -> Float32Array:
    robot = stage.simulation.robot
    row = np.array((robot.radius, robot.max_speed, robot.max_turn_rate), np.float32)
    return np.tile(row, (len(ids), 1))


def _goal(stage: Stage, task: Task, ids: IntArray) -> FloatArray:
    """Return distance, meters, and bearing from the robot's heading, radians."""
    assert task.goals is not None, "only tasks with a goal have it observed"
    ways, yaws = (task.goals[ids] - stage.poses[ids, :2]).tolist(), stage.poses[ids, 3].tolist()
    distances = [math.hypot(dx, dy) for dx, dy in ways]
    bearings = [math.atan2(dy, dx) - yaw for (dx, dy), yaw in zip(ways, yaws, strict=True)]
    return np.column_stack((distances, [math.remainder(bearing, math.tau) for bearing in bearings]))


def goal_direction(polar: FloatArray) -> Float32Array:
    """Return (n, 3) directions and distances of goals (n, 2), distance and bearing: see `GROUPS`."""
    distance, bearing = polar.T
    scaled = np.minimum(distance / GOAL_SCALE, 1.0)
    return np.column_stack((np.cos(bearing), np.sin(bearing), scaled)).astype(np.float32)


def _seen_map(stage: Stage, task: Task, ids: IntArray) -> ByteArray:
    assert stage.seen is not None
    maps = np.empty((len(ids), 1, MAP_CELLS, MAP_CELLS), np.uint8)
    for k, i in enumerate(ids.tolist()):
        x, y, _, yaw = stage.poses[i].tolist()
        stage.seen.local_map(i, x, y, yaw, maps[k, 0])
    return maps


def _height_map(stage: Stage, task: Task, ids: IntArray) -> Float32Array:
    maps = np.empty((len(ids), HEIGHT_CELLS, HEIGHT_CELLS), np.float32)
    for k, i in enumerate(ids.tolist()):
        world, (x, y, z, yaw) = stage.simulation.worlds[i], stage.poses[i].tolist()
        surface, holes = world.surface, world.no_ground
        frame = (*surface.origin, *surface.cell)
        holes = np.zeros((0, 0), np.bool_) if holes is None else holes
        _local_heights(surface.z, holes, frame, (x, y, z, yaw), maps[k])
    return maps


@njit
def _local_heights(
    z: Float32Array,
    holes: BoolArray,
    frame: tuple[float, float, float, float],
    pose: tuple[float, float, float, float],
    out: Float32Array,
) -> None:
    """Fill (n, n) heights above base_link, meters, or `NO_GROUND`. Row 0 = ahead, column 0 = left."""
    rows, cols = z.shape
    n = len(out)
    cos, sin = math.cos(pose[3]), math.sin(pose[3])
    for r in range(n):
        ahead = ((n - 1) / 2 - r) * HEIGHT_CELL
        for c in range(n):
            left = ((n - 1) / 2 - c) * HEIGHT_CELL
            u = (pose[0] + cos * ahead - sin * left - frame[0]) / frame[2]
            v = (pose[1] + sin * ahead + cos * left - frame[1]) / frame[3]
            out[r, c] = NO_GROUND
            inside = 0 <= u <= cols - 1 and 0 <= v <= rows - 1
            if inside and not (holes.size and holes[rows - 1 - round(v), round(u)]):
                i, j = min(int(u), cols - 2), min(int(v), rows - 2)
                a, b = u - i, v - j
                sw, se = z[rows - 1 - j, i], z[rows - 1 - j, i + 1]
                nw, ne = z[rows - 2 - j, i], z[rows - 2 - j, i + 1]
                if a >= b:
                    out[r, c] = sw + a * (se - sw) + b * (ne - se) - pose[2]
                else:
                    out[r, c] = sw + a * (ne - nw) + b * (nw - sw) - pose[2]


GROUPS: dict[str, Group] = {
    "scan": Group(_scan_space, _scan),
    "scans": Group(lambda stage: _scan_space(stage, SCANS), memory=ScanHistory),
    "sectors": Group(
        lambda stage: spaces.Box(0.0, 1.0, (SECTORS,), np.float32),
        lambda stage, task, ids: scan_sectors(stage.simulation.ranges[ids], stage.simulation.preset),
    ),
    "body": Group(lambda stage: spaces.Box(0.0, np.inf, (3,), np.float32), _body),
    "odometry": Group(
        lambda stage: spaces.Box(-np.inf, np.inf, (3,), np.float64),
        lambda stage, task, ids: stage.simulation.odometry[ids],
    ),
    "attitude": Group(
        lambda stage: spaces.Box(-np.pi, np.pi, (2,), np.float64),
        lambda stage, task, ids: stage.simulation.attitude[ids],
    ),
    "goal": Group(
        lambda stage: spaces.Box(np.array((0.0, -np.pi)), np.array((np.inf, np.pi)), dtype=np.float64), _goal
    ),
    "goal_direction": Group(
        lambda stage: spaces.Box(np.array((-1, -1, 0), np.float32), np.ones(3, np.float32), dtype=np.float32),
        lambda stage, task, ids: goal_direction(_goal(stage, task, ids)),
    ),
    "seen_map": Group(
        lambda stage: spaces.Box(0, 255, (1, MAP_CELLS, MAP_CELLS), np.uint8), _seen_map, privileged=True
    ),
    "height_map": Group(
        lambda stage: spaces.Box(-np.inf, np.inf, (HEIGHT_CELLS, HEIGHT_CELLS), np.float32),
        _height_map,
        privileged=True,
    ),
}
"""Groups by name; more may be added before an environment is made.

scan: (beams,) meters; nothing in range is `range_max`, too near or lost is 0.
scans: (4, beams) scans of the last four steps, the newest first; at the start all are the first scan. For
    another number of steps, add `scan_history(steps)` under a name.
sectors: (36,) proximity 1 / (1 + r), r meters the least range in each of 36 sectors of 10 degrees around
    the robot, from straight behind over right, ahead and left; 1 = all its beams are too near or lost, 0 = no
    beam goes there. A scan for small networks, the same for every planar lidar.
body: (3,) radius of the robot, top speed and turn rate; meters, m/s, rad/s. For a policy of several robots.
odometry: (3,) x, y, yaw of `T_odom_base`; meters, radians.
attitude: (2,) measured roll and pitch, radians.
goal: (2,) straight distance, meters, and bearing, radians, from the true pose.
goal_direction: (3,) cosine and sine of the goal's bearing, and its distance over 30 m, at most 1. A goal for
    networks: without a jump where it is behind.
seen_map: (1, 64, 64) 255 = seen ground; cells of 0.25 m around the true pose, row 0 = ahead, column 0 = left.
height_map: (32, 32) heights of the ground above base_link, meters, cells of 0.2 m laid out in the same way;
    -1000 = no ground there, or beyond the border: clip it for a network.
"""
