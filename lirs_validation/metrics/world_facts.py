"""Facts of a world in words, as `info` and the live page show them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from lirs_envs.robots.robot import ROBOTS, make_robot
from lirs_validation.metrics.world_geometry import mesh_error, scan_support
from lirs_wct import Float32Array, HeightField, World

Facts = tuple[tuple[str, str], ...]
"""Names and values, to be shown as a table."""
CELLS, MAP_CELLS = 1000, 2000
"""Cells along the longer side, at most, of the grid on which drivable ground is counted: of a terrain, and of
a laser map, whose walls are thin."""
STRIP = 256
"""Rows of nodes whose slopes are computed together."""


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
    cells = CELLS if world.walls is None else MAP_CELLS
    resolution = max(0.1, max(world.surface.size) / cells)
    limits = [(robot.radius, robot.max_slope) for robot in ROBOTS.values()]
    grids = world.traversable_by(limits, resolution)
    for (name, robot), grid in zip(ROBOTS.items(), grids, strict=True):
        text = f"{100 * float(grid.free.mean()):.1f} %, up to {math.degrees(robot.max_slope):.0f} deg"
        if name in unresolved_robots(world):
            length = f"{2 * robot.radius:.2g} m"
            text = f"unknown: samples {world.sample_spacing:.3g} m apart do not resolve {length}"
        yield f"drivable, {name}", text
