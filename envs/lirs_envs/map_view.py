"""Snapshots of a simulation, and maps of them from above: ground, walls, robot, path, scan and goal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_envs.walkers import RADIUS
from lirs_wct import ByteArray, FloatArray, Int32Array, LaserScan, Pose2, Pose3, World
from lirs_wct.export.appearance import ground_texture


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """A moment of a simulation.

    Attributes:
        world: World of the robot.
        config: Robot, props and number of walkers.
        qpos: (nq,) MuJoCo's positions of robot and props.
        walkers: (n, 3) middles of the walkers, meters.
        goal: Goal to mark; None = none.
    """

    world: World
    config: SimulationConfig
    qpos: FloatArray
    walkers: FloatArray
    goal: Pose2 | None = None

    @staticmethod
    def of(simulation: Simulation, i: int = 0, goal: Pose2 | None = None) -> Snapshot:
        """Return the present state of robot `i`."""
        return Snapshot(
            world=simulation.worlds[i],
            config=simulation.config,
            qpos=simulation.states[i].qpos.copy(),
            walkers=simulation.walkers(i),
            goal=goal,
        )

    @property
    def T_world_base(self) -> Pose3:  # noqa: N802  a frame pair
        """Pose of base_link."""
        x, y, z, qw, qx, qy, qz = self.qpos[:7].tolist()
        return Pose3(x, y, z, qw, qx, qy, qz)


PIXELS = 640
"""Longer side of a picture."""
ROBOT, OUTLINE = (30, 30, 35), (255, 255, 255)
PATH, SCAN, GOAL, WALKER = (20, 80, 200), (200, 40, 40), (215, 25, 60), (60, 90, 150)
"""Colors: red, green, blue."""
MIN_RADIUS = 5
"""A robot is drawn at least this large, pixels."""
FRACTION = 4
"""Number of fractional bits of OpenCV's pixel coordinates."""


class MapView:
    """Pictures of a world from above, row 0 = north. The ground is drawn once per world."""

    def __init__(self, pixels: int = PIXELS) -> None:
        self._pixels = pixels
        self._world: World | None = None

    def picture(
        self, snapshot: Snapshot, *, path: Sequence[Pose2] = (), scan: LaserScan | None = None
    ) -> ByteArray:
        """Return a picture (rows, cols, 3) of the whole world, with the path until now and a scan's hits."""
        if self._world is not snapshot.world:
            self._world, self._ground = snapshot.world, self._draw_ground(snapshot.world)
        picture = self._ground.copy()
        if len(path) > 1:
            points = self._pixel(np.array([(pose.x, pose.y) for pose in path]))
            cv2.polylines(picture, [points], False, PATH, 2, cv2.LINE_AA, FRACTION)
        for x, y in self._pixel(snapshot.walkers[:, :2]).tolist():
            radius = round(2**FRACTION * max(RADIUS * self._per_meter, 2.5))
            cv2.circle(picture, (x, y), radius, WALKER, cv2.FILLED, cv2.LINE_AA, FRACTION)
        if scan is not None:
            hits = (snapshot.T_world_base @ scan.T_base_laser).apply(scan.points)
            for x, y in self._pixel(hits[:, :2]).tolist():
                cv2.circle(picture, (x, y), 2**FRACTION, SCAN, cv2.FILLED, cv2.LINE_AA, FRACTION)
        if snapshot.goal is not None:
            x, y = self._pixel(np.array(((snapshot.goal.x, snapshot.goal.y),)))[0].tolist()
            for radius, width in ((9, 2), (3, cv2.FILLED)):
                cv2.circle(picture, (x, y), radius << FRACTION, GOAL, width, cv2.LINE_AA, FRACTION)
        self._draw_robot(picture, snapshot)
        return picture

    def _draw_ground(self, world: World) -> ByteArray:
        """Return the ground's picture, and note its scale."""
        width, depth = world.surface.size
        self._per_meter = self._pixels / max(width, depth)
        west, _, _, north = world.surface.bounds
        self._corner = np.array((west, north))
        above = ground_texture(world.surface, world.walls)[..., ::-1]
        rows, cols = (max(1, round(side * self._per_meter)) for side in (depth, width))
        return np.ascontiguousarray(cv2.resize(above, (cols, rows), interpolation=cv2.INTER_AREA), np.uint8)

    def _pixel(self, points: FloatArray) -> Int32Array:
        """Return (n, 2) column and row of world points (n, 2), in fractions of a pixel."""
        pixels = (points - self._corner) * (self._per_meter, -self._per_meter)
        fractions: Int32Array = np.round(np.clip(pixels, -1e4, 1e4) * 2**FRACTION).astype(np.int32)
        return fractions

    def _draw_robot(self, picture: ByteArray, snapshot: Snapshot) -> None:
        """Draw an arrowhead as long as the robot."""
        here = snapshot.T_world_base.to_pose2()
        radius = max(snapshot.config.robot.radius, MIN_RADIUS / self._per_meter)
        turns = np.array((0.0, 2.5, math.pi, -2.5)) + here.yaw
        reach = radius * np.array((1.3, 1.1, 0.4, 1.1))
        corners = np.column_stack((here.x + reach * np.cos(turns), here.y + reach * np.sin(turns)))
        outline: NDArray[np.int32] = self._pixel(corners)
        cv2.fillPoly(picture, [outline], ROBOT, cv2.LINE_AA, FRACTION)
        cv2.polylines(picture, [outline], True, OUTLINE, 1, cv2.LINE_AA, FRACTION)
