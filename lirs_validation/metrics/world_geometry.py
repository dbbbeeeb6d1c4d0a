"""World geometry for metrics: obstacles near points, errors of meshes, walls in sight."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from lirs_envs.lidar.presets import LidarPreset, make_lidar_preset
from lirs_envs.lidar.ray_casting import Caster, MeshCaster, RayCaster
from lirs_envs.robots.robot import Robot
from lirs_wct import HeightField, LaserScan, Pose2, Pose3, TriangleMesh, WallGrid, World
from lirs_wct.arrays import BoolArray, FloatArray, njit
from lirs_wct.geometry.mesh import rasterize_heights

STEEP = math.radians(45)
"""Faces steeper than this are obstacles, radians."""
POSES = 300
"""Places at which a scan is cast."""
CELLS = 2000
"""Cells along the longer side, at most, of the grid on which drivable ground is looked for."""
STREAM = 31
"""Random stream of the seed from which they are drawn."""
WALL_DISTANCE = 0.10
"""Meters from a steep face or wall cell within which a hit is one of a wall, as in `map.false_occupied`."""

ENOUGH_WALLS = 0.05
"""Share of a scan's beams on walls above which planar mapping is expected to work."""


def near_obstacle(
    points: FloatArray, surface: HeightField, walls: WallGrid | None, distance: float, steep: float = STEEP
) -> BoolArray:
    """Return (n,) whether points (n, 2) are near an obstacle.

    An obstacle is a steep face's footprint or a wall cell.

    Args:
        points: world frame, meters.
        surface: the ground; each of its cells is two triangles.
        walls: wall cells, or None.
        distance: meters in the plane, 0 inside the footprint.
        steep: a face counts above this angle, radians.
    """
    xy = np.ascontiguousarray(points, dtype=np.float64)
    near: BoolArray = _near_steep(
        xy, surface.south_up, surface.cell, surface.origin, distance, math.tan(steep)
    )
    if walls is not None:
        local = walls.origin.inverse().apply(xy)
        near |= _near_wall(local, walls.solid, walls.resolution, distance)
    return near


@njit
def _near_steep(
    points: FloatArray, z: Any, cell: Any, origin: Any, distance: float, rise: float
) -> BoolArray:
    """Search the cells in a square around each point.

    Half side `distance`; z has row 0 = south.
    """
    rows, cols = z.shape
    cx, cy = cell
    near = np.zeros(len(points), np.bool_)
    for k in range(len(points)):
        # In meters from the south-west node.
        x, y = points[k, 0] - origin[0], points[k, 1] - origin[1]
        # A cell holds both of its edges: a point on the line between two is on either.
        i0, i1 = max(0, math.ceil((x - distance) / cx) - 1), min(cols - 2, math.floor((x + distance) / cx))
        j0, j1 = max(0, math.ceil((y - distance) / cy) - 1), min(rows - 2, math.floor((y + distance) / cy))
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                if near[k]:
                    break
                sw, se = float(z[j, i]), float(z[j, i + 1])
                nw, ne = float(z[j + 1, i]), float(z[j + 1, i + 1])
                west, south = i * cx, j * cy
                east, north = west + cx, south + cy
                if math.hypot((se - sw) / cx, (ne - se) / cy) > rise:
                    near[k] = _to_triangle(x, y, west, south, east, south, east, north) <= distance
                if not near[k] and math.hypot((ne - nw) / cx, (nw - sw) / cy) > rise:
                    near[k] = _to_triangle(x, y, west, south, east, north, west, north) <= distance
    return near


@njit
def _near_wall(points: FloatArray, solid: BoolArray, resolution: float, distance: float) -> BoolArray:
    """Search the wall cells round points given in the wall grid's frame."""
    rows, cols = solid.shape
    near = np.zeros(len(points), np.bool_)
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        i0, i1 = math.ceil((x - distance) / resolution) - 1, math.floor((x + distance) / resolution)
        j0, j1 = math.ceil((y - distance) / resolution) - 1, math.floor((y + distance) / resolution)
        for j in range(max(0, j0), min(rows - 1, j1) + 1):
            for i in range(max(0, i0), min(cols - 1, i1) + 1):
                if solid[j, i]:
                    dx = max(i * resolution - x, 0.0, x - (i + 1) * resolution)
                    dy = max(j * resolution - y, 0.0, y - (j + 1) * resolution)
                    near[k] |= math.hypot(dx, dy) <= distance
    return near


@njit
def _to_triangle(
    x: float, y: float, ax: float, ay: float, bx: float, by: float, cx: float, cy: float
) -> float:
    """Return the distance of a point to a triangle given counter-clockwise; 0 inside."""
    inside = (
        (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0
        and (cx - bx) * (y - by) - (cy - by) * (x - bx) >= 0
        and (ax - cx) * (y - cy) - (ay - cy) * (x - cx) >= 0
    )
    if inside:
        return 0.0
    nearest: float = min(
        _to_segment(x, y, ax, ay, bx, by),
        _to_segment(x, y, bx, by, cx, cy),
        _to_segment(x, y, cx, cy, ax, ay),
    )
    return nearest


@njit
def _to_segment(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Return the distance of a point to a segment."""
    dx, dy = bx - ax, by - ay
    t = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy)
    t = min(1.0, max(0.0, t))
    return math.hypot(x - ax - t * dx, y - ay - t * dy)


def mesh_error(world: World, mesh: TriangleMesh | None = None) -> float:
    """Return the largest vertical error of the world's mesh, or another, at the nodes, meters."""
    surface = world.surface
    chosen = world.mesh if mesh is None else mesh
    top = rasterize_heights(chosen, (*surface.origin, *surface.cell), surface.shape)
    top -= surface.z[::-1]
    return float(np.nanmax(np.abs(top, out=top))) if np.isfinite(top).any() else 0.0


@dataclass(frozen=True, kw_only=True)
class ScanSupport:
    """Hits of single scans over the drivable ground; the other beams return nothing.

    Attributes:
        robot: Robot with the lidar.
        beams: Beams in a scan.
        poses: Number of scans; 0 = the robot can stand nowhere.
        wall_median: Hits of faces steeper than 45 deg and of wall cells, median over the poses.
        wall_p10: Hits of walls, 10th percentile: in a tenth of the places there are fewer.
        ground_median: Hits of other ground, median over the poses.
        ground_p10: Hits of other ground, 10th percentile.
        wall_share: Share of walls among all hits of all scans; 0 without a hit.
    """

    robot: str
    beams: int
    poses: int
    wall_median: float = 0.0
    wall_p10: float = 0.0
    ground_median: float = 0.0
    ground_p10: float = 0.0
    wall_share: float = 0.0

    @property
    def expectation(self) -> str:
        """Forecast for a planar mapper, in words; docs/results.md says how often it came true."""
        if not self.poses:
            return "the robot can stand nowhere"
        least, median = f"{self.wall_p10:.0f}", f"{self.wall_median:.0f}"
        walls = f"walls on {least if least == median else f'{least} to {median}'} of {self.beams} beams"
        if self.wall_p10 >= ENOUGH_WALLS * self.beams:
            return f"{walls}: enough for planar mapping nearly everywhere"
        if self.wall_median >= ENOUGH_WALLS * self.beams:
            return f"{walls}: too few for planar mapping in some places"
        return f"{walls}: too few for planar mapping"


def scan_support(world: World, robot: Robot, *, seed: int = 0) -> ScanSupport:
    """Cast noise-free scans over the drivable ground; count walls and ground.

    The robot stands as the ground under its footprint lies; one that flies is level.
    """
    preset = make_lidar_preset(robot.lidar)
    poses = _poses(world, robot, np.random.default_rng((seed, STREAM)))
    caster: Caster = MeshCaster(world.mesh) if world.overhangs else RayCaster(world.surface, world.walls)
    hits: list[FloatArray] = []
    for pose in poses:
        laser = standing_on(world, robot, pose) @ robot.T_base_laser
        points, hit = cast_beams(caster, preset, laser, preset.directions)
        hits.append(laser.position[:2] + points[hit, :2])
    if not hits:
        return ScanSupport(robot=robot.name, beams=preset.beams, poses=0)
    wall, ground = count_hits(world, hits)
    return ScanSupport(
        robot=robot.name,
        beams=preset.beams,
        poses=len(hits),
        wall_median=float(np.median(wall)),
        wall_p10=float(np.percentile(wall, 10)),
        ground_median=float(np.median(ground)),
        ground_p10=float(np.percentile(ground, 10)),
        wall_share=float(wall.sum() / max(1.0, wall.sum() + ground.sum())),
    )


def cast_beams(
    caster: Caster, preset: LidarPreset, laser: Pose3, directions: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return end points (n, 3) of beams relative to the sensor, and which hit.

    Axes are those of the world; the points of the others are NaN.
    """
    turned = np.ascontiguousarray(directions @ laser.rotation.T)
    ranges = caster.ranges(laser.position, turned, preset.range_max)
    hit = (ranges >= preset.range_min) & (ranges < preset.range_max)
    return np.where(hit, ranges, np.nan)[:, None] * turned, hit


def count_hits(world: World, hits: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return (n,) hits on walls and on other ground of scans with hits (k, 2)."""
    # All scans together: each call copies the surface.
    near = near_obstacle(np.concatenate(hits), world.surface, world.walls, WALL_DISTANCE)
    scan = np.repeat(np.arange(len(hits)), [len(points) for points in hits])
    walls, ground = (np.bincount(scan[each], minlength=len(hits)) for each in (near, ~near))
    return walls.astype(np.float64), ground.astype(np.float64)


def observed_support(world: World, scans: Sequence[LaserScan], poses: Sequence[Pose3]) -> dict[str, float]:
    """Count returns and hits on walls of recorded scans at poses `T_world_base`.

    Returns:
        beams, range_max (meters), returns_median and walls_median per scan.
    """
    points = [
        (pose @ scan.T_base_laser).apply(scan.points)[:, :2] for scan, pose in zip(scans, poses, strict=True)
    ]
    walls, _ = count_hits(world, points)
    return {
        "beams": len(scans[0].ranges),
        "range_max": scans[0].range_max,
        "returns_median": float(np.median([len(each) for each in points])),
        "walls_median": float(np.median(walls)),
    }


def standing_on(world: World, robot: Robot, pose: Pose2) -> Pose3:
    """Return base_link's pose on the ground ahead, behind, left and right of it."""
    if robot.flies:
        z = float(np.nan_to_num(world.surface.height_at(pose.x, pose.y)))
        return Pose3.from_pose2(pose, z + robot.base_height)
    reach = robot.radius / 2
    ends = pose.apply(np.array([(reach, 0.0), (-reach, 0.0), (0.0, reach), (0.0, -reach)]))
    ahead, behind, left, right = np.nan_to_num(world.surface.height_at(ends[:, 0], ends[:, 1])).tolist()
    pitch = -math.atan2(ahead - behind, 2 * reach)
    roll = math.atan2(left - right, 2 * reach)
    z = (ahead + behind + left + right) / 4 + robot.base_height
    return Pose3.from_rpy(pose.x, pose.y, z, roll, pitch, pose.yaw)


def _poses(world: World, robot: Robot, rng: np.random.Generator) -> list[Pose2]:
    """Return poses drawn evenly over the drivable ground that a start pose reaches, facing anywhere."""
    resolution = max(0.1, max(world.surface.size) / CELLS)
    free = world.traversable(clearance=robot.radius, max_slope=robot.max_slope, resolution=resolution)
    _, areas = cv2.connectedComponents(free.free.astype(np.uint8), connectivity=4)
    starts = free.cells(np.array([(pose.x, pose.y) for pose in world.spawn_poses]).reshape(-1, 2))
    begun = np.setdiff1d(areas[tuple(np.clip(starts, 0, np.array(areas.shape) - 1).T)], 0)
    cells = np.argwhere(np.isin(areas, begun) if len(begun) else free.free)
    if not len(cells):
        return []
    points: FloatArray = free.centers(cells[rng.integers(len(cells), size=POSES)])
    yaws = rng.uniform(-math.pi, math.pi, POSES)
    return [Pose2(x, y, yaw) for (x, y), yaw in zip(points.tolist(), yaws.tolist(), strict=True)]
