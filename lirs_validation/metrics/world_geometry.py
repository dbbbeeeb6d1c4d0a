"""World geometry before any run: errors of meshes, walls in sight, facts in words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from lirs_envs.lidar.presets import LidarPreset, make_lidar_preset
from lirs_envs.lidar.ray_casting import Caster, MeshCaster, RayCaster
from lirs_envs.robots.robot import ROBOTS, Robot, make_robot
from lirs_validation.metrics.map import count_hits
from lirs_wct import BoolArray, Float32Array, FloatArray, HeightField, Pose2, Pose3, TriangleMesh, World
from lirs_wct.geometry.mesh import rasterize_heights

POSES = 300
"""Places at which a scan is cast."""
CELLS = 2000
"""Cells along the longer side, at most, of the grid on which drivable ground is looked for."""
TERRAIN_CELLS = 1000
"""The same of the grid on which it is counted on terrain, which has no thin walls."""
STREAM = 31
"""Random stream of the seed from which they are drawn."""

ENOUGH_WALLS = 0.05
"""Share of a scan's beams on walls above which planar mapping is expected to work."""
Facts = tuple[tuple[str, str], ...]
"""Names and values, to be shown as a table."""
STRIP = 256
"""Rows of nodes whose slopes are computed together."""


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


def ground_facts(world: World) -> Iterator[tuple[str, str]]:
    """Yield extent and heights of a world."""
    surface, walls = world.surface, world.walls
    (width, depth), (nodes_north, nodes_east), (across, along) = surface.size, surface.shape, surface.cell
    yield "size", f"{width:g} x {depth:g} m"
    if world.place is not None:
        yield "place on earth", world.place.label()
    apart = f"{across:.4g}" if math.isclose(across, along) else f"{across:.4g} and {along:.4g}"
    yield "surface", f"{nodes_east} x {nodes_north} nodes, {apart} m apart"
    if walls is not None:
        cells = f"{walls.solid.sum()} of {walls.solid.size} cells of {walls.resolution:g} m"
        yield "walls", f"{cells}, {walls.height:g} m high"
    yield "heights", f"{surface.z.min():.3f} to {surface.z.max():.3f} m"


def measured_facts(world: World, robot: str = "husky") -> Iterator[tuple[str, str]]:
    """Yield slopes, drivable ground, a scanner's view, start poses and mesh of a world."""
    median, p95 = np.percentile(_slopes(world.surface), (50, 95), overwrite_input=True).tolist()
    yield "slopes", f"median {median:.1f} deg, 95 % below {p95:.1f} deg"
    yield from _drivable(world)
    support, hits = scan_support(world, make_robot(robot)), "-"
    if support.poses:
        hits = (
            f"{support.wall_median:.0f} of {support.beams} beams a scan, {support.wall_p10:.0f} in the worst "
            f"tenth of places; {support.ground_median:.0f} meet other ground"
        )
    yield f"walls in sight, {support.robot}", hits
    yield "expectation", support.expectation
    yield "start poses", _starts(world)
    mesh, error = world.file_mesh, "exact"
    yield "triangles", f"{len(mesh.faces)}"
    yield "watertight", f"{'yes' if mesh.is_watertight_as_written else 'no'}, {mesh.volume:.6g} m3"
    if world.walls is None:
        error = f"{mesh_error(world, mesh):.6f} m at the nodes"
        # Without a budget the mesh has every node and the field's diagonals; a closed mesh stays itself.
        budget = world.file_options.max_error
        error += f", at most {budget:.6f} m between them" if budget else ""
    yield "mesh error", error


def unresolved_robots(world: World) -> tuple[str, ...]:
    """Return the robots for which the samples of a source are too far apart."""
    spacing = world.sample_spacing or 0.0
    return tuple(name for name, robot in ROBOTS.items() if spacing > 2 * robot.radius)


def _starts(world: World) -> str:
    """Return how many there are, and for whom if the source's samples resolve that robot."""
    if not world.spawn_poses:
        return "none: no robot on wheels fits"
    if world.spawn_for in unresolved_robots(world):
        return f"{len(world.spawn_poses)}, unknown whether {world.spawn_for} can stand between the samples"
    whom = f", for {world.spawn_for} and smaller robots" if world.spawn_for else ""
    return f"{len(world.spawn_poses)}{whom}"


def _slopes(surface: HeightField) -> Float32Array:
    """Return (rows, cols) slopes at the nodes, degrees, computed in strips to save memory."""
    slopes = np.empty(surface.shape, np.float32)
    for start in range(0, len(slopes), STRIP):
        strip, above = slopes[start : start + STRIP], min(start, 1)
        z = surface.z[start - above : start + STRIP + 1]
        strip[:] = np.degrees(replace(surface, z=z).slope()[above : above + len(strip)])
    return slopes


def _drivable(world: World) -> Iterator[tuple[str, str]]:
    """Yield the share of the ground where each robot's center may be."""
    cells = TERRAIN_CELLS if world.walls is None else CELLS
    resolution = max(0.1, max(world.surface.size) / cells)
    limits = [(robot.radius, robot.max_slope) for robot in ROBOTS.values()]
    grids = world.traversable_by(limits, resolution)
    for (name, robot), grid in zip(ROBOTS.items(), grids, strict=True):
        text = f"{100 * float(grid.free.mean()):.1f} %, up to {math.degrees(robot.max_slope):.0f} deg"
        if name in unresolved_robots(world):
            length = f"{2 * robot.radius:.2g} m"
            text = f"unknown: samples {world.sample_spacing:.3g} m apart do not resolve {length}"
        yield f"drivable, {name}", text
