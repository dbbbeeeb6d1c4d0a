"""Tables of `info`: facts of a world, and of a log."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from rich.table import Table

from lirs_envs.robots.robot import ROBOTS, make_robot
from lirs_validation.logs.preflight import Preflight
from lirs_validation.metrics.scan_support import ScanSupport, scan_support
from lirs_validation.metrics.world_geometry import mesh_error
from lirs_wct import HeightField, World
from lirs_wct.arrays import Float32Array

CELLS, MAP_CELLS = 1000, 2000
"""Cells along the longer side, at most, of the grid on which drivable ground is counted: of a terrain, and of
a laser map, whose walls are thin."""


STRIP = 256
"""Rows of nodes whose slopes are computed together."""


@dataclass(frozen=True, kw_only=True)
class WorldFacts:
    """Figures of a world.

    Attributes:
        size: eastward and northward, meters.
        nodes: rows and columns of the surface.
        heights: lowest and highest ground, meters.
        slopes: median and 95th percentile at the nodes, degrees.
        drivable: percent of the ground where a robot's center may be, by robot.
        walls: wall cells, cells, resolution in meters, height in meters; None without a laser map.
        triangles: of the mesh that is written.
        watertight: whether a reader of its STL finds it closed.
        volume: enclosed, cubic meters.
        support: walls in sight of a robot's planar scanner.
        error: largest vertical distance of the mesh from the surface at its nodes, meters; None for the
            walls of a laser map, which are exact.
    """

    size: tuple[float, float]
    nodes: tuple[int, int]
    heights: tuple[float, float]
    slopes: tuple[float, float]
    drivable: dict[str, float]
    walls: tuple[int, int, float, float] | None
    triangles: int
    watertight: bool
    volume: float
    support: ScanSupport
    error: float | None


def world_facts(world: World, robot: str = "husky") -> WorldFacts:
    """Measure a world, and the view of a robot's scanner.

    Raises:
        ConfigError: there is no such robot.
    """
    surface, walls, mesh = world.surface, world.walls, world.file_mesh
    median, p95 = np.percentile(_slopes(surface), (50, 95), overwrite_input=True).tolist()
    return WorldFacts(
        size=surface.size,
        nodes=surface.shape,
        heights=(float(surface.z.min()), float(surface.z.max())),
        slopes=(median, p95),
        drivable=_drivable(world),
        walls=None
        if walls is None
        else (int(walls.solid.sum()), walls.solid.size, walls.resolution, walls.height),
        triangles=len(mesh.faces),
        watertight=mesh.is_watertight_as_written,
        volume=mesh.volume,
        support=scan_support(world, make_robot(robot)),
        error=None if walls is not None else mesh_error(world, mesh),
    )


def facts_table(world: World, facts: WorldFacts) -> Table:
    """Return the facts as a table to print."""
    table = Table(title=f"{world.name}: {world.kind}, {world.scale}", show_header=False, title_justify="left")
    rows = [
        ("size", f"{facts.size[0]:g} x {facts.size[1]:g} m"),
        ("surface", f"{facts.nodes[1]} x {facts.nodes[0]} nodes, {_cells(world)} m apart"),
        ("heights", f"{facts.heights[0]:.3f} to {facts.heights[1]:.3f} m"),
        ("slopes", f"median {facts.slopes[0]:.1f} deg, 95 % below {facts.slopes[1]:.1f} deg"),
        *(
            (f"drivable, {robot}", _drivable_text(world, robot, share))
            for robot, share in facts.drivable.items()
        ),
        (f"walls in sight, {facts.support.robot}", _support(facts.support)),
        ("expectation", facts.support.expectation),
        ("start poses", _starts(world)),
        ("triangles", f"{facts.triangles}"),
        ("watertight", f"{'yes' if facts.watertight else 'no'}, {facts.volume:.6g} m3"),
        ("mesh error", _mesh_error(world, facts)),
    ]
    if facts.walls is not None:
        solid, cells, resolution, height = facts.walls
        rows.insert(2, ("walls", f"{solid} of {cells} cells of {resolution:g} m, {height:g} m high"))
    if world.place is not None:
        rows.insert(1, ("place on earth", world.place.label()))
    for row in rows:
        table.add_row(*row)
    return table


def preflight_table(log: str, found: Preflight) -> Table:
    """Return the facts of a log and its deviations as a table to print."""
    table = Table(title=log, show_header=False, title_justify="left")
    for name, value in found.facts:
        table.add_row(name, value)
    for finding in found.findings:
        table.add_row("deviation", str(finding), style="yellow")
    for repair in found.repairs:
        table.add_row("put right", repair, style="yellow")
    return table


def _drivable_text(world: World, robot: str, share: float) -> str:
    """Return the drivable share, unless the source's samples do not resolve the robot."""
    if not _resolves(world, robot):
        length = 2 * ROBOTS[robot].radius
        return f"unknown: samples {world.sample_spacing:.3g} m apart do not resolve {length:.2g} m"
    return f"{share:.1f} %, up to {math.degrees(ROBOTS[robot].max_slope):.0f} deg"


def _resolves(world: World, robot: str) -> bool:
    return world.sample_spacing is None or world.sample_spacing <= 2 * ROBOTS[robot].radius


def _mesh_error(world: World, facts: WorldFacts) -> str:
    if facts.error is None:
        return "exact"
    at_nodes = f"{facts.error:.6f} m at the nodes"
    budget = world.file_options.max_error
    # Without a budget the mesh has every node and the height field's diagonals; a closed mesh stays itself.
    return f"{at_nodes}, at most {budget:.6f} m between them" if budget else at_nodes


def _support(found: ScanSupport) -> str:
    """Return the hits of a scan's beams in words."""
    if not found.poses:
        return "-"
    return (
        f"{found.wall_median:.0f} of {found.beams} beams a scan, {found.wall_p10:.0f} in the worst tenth of "
        f"places; {found.ground_median:.0f} meet other ground"
    )


def _starts(world: World) -> str:
    """Return how many there are, and for whom if the source's samples resolve that robot."""
    if not world.spawn_poses:
        return "none: no robot on wheels fits"
    if world.spawn_for and not _resolves(world, world.spawn_for):
        return f"{len(world.spawn_poses)}, unknown whether {world.spawn_for} can stand between the samples"
    whom = f", for {world.spawn_for} and smaller robots" if world.spawn_for else ""
    return f"{len(world.spawn_poses)}{whom}"


def _cells(world: World) -> str:
    across, along = world.surface.cell
    return f"{across:.4g}" if math.isclose(across, along) else f"{across:.4g} and {along:.4g}"


def _slopes(surface: HeightField) -> Float32Array:
    """Return (rows, cols) slopes at the nodes, degrees, computed in strips to save memory."""
    slopes = np.empty(surface.shape, np.float32)
    for start in range(0, len(slopes), STRIP):
        strip, above = slopes[start : start + STRIP], min(start, 1)
        z = surface.z[start - above : start + STRIP + 1]
        strip[:] = np.degrees(replace(surface, z=z).slope()[above : above + len(strip)])
    return slopes


def _drivable(world: World) -> dict[str, float]:
    cells = CELLS if world.walls is None else MAP_CELLS
    resolution = max(0.1, max(world.surface.size) / cells)
    limits = [(robot.radius, robot.max_slope) for robot in ROBOTS.values()]
    grids = world.traversable_by(limits, resolution)
    return {name: 100 * float(grid.free.mean()) for name, grid in zip(ROBOTS, grids, strict=True)}
