"""Build a world of any source: load or read its ground, then find spawn poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from lirs_wct.errors import ConfigError, LogSourceError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import Ground, LaserMap, Terrain
from lirs_wct.meshing.ground_texture import checked_texture
from lirs_wct.navigation.spawn_poses import FOOTPRINTS
from lirs_wct.sources.clouds.source import read_point_cloud
from lirs_wct.sources.laser_map import read_laser_map
from lirs_wct.sources.mesh_source import read_mesh_source
from lirs_wct.sources.options import BuildOptions, SourceKind
from lirs_wct.sources.pictures.picture import read_terrain
from lirs_wct.sources.result_check import warn_of_result
from lirs_wct.sources.source import Source, find_source, warn_of_shape, warn_of_useless
from lirs_wct.sources.window import Window, cut_nodes, cut_surface, leveled, sample_spacing
from lirs_wct.world import World

SPAWN_AREA = 200.0
"""Side of the square at the center of a larger terrain where spawn poses are searched, meters."""
SPAWN_CELLS = 1000
"""Limit of cells along a terrain's side in the grid of this search."""


def build_world(source: str | Path, options: BuildOptions | None = None) -> World:
    """Build a world of a source.

    A source is a bundled name, a built folder, a picture, a laser map, a mesh or a point cloud.

    Raises:
        SourceError: the source cannot be used.
        LogSourceError: the source is a laser log, which must be mapped first.
        ConfigError: an option does not fit the source.
    """
    options = options or BuildOptions()
    found = find_source(source, options)
    if found.kind is SourceKind.LOG:
        raise LogSourceError(f"{found.path}: a log is mapped before it is a world")
    warn_of_useless(found, options)
    world = _build_from(found, options)
    exact = world.walls is not None or world.overhangs
    warn_of_shape(found, options, world.surface.size, exact)
    warn_of_result(found, world)
    for texture in (options.texture, options.wall_texture):
        checked_texture(texture, options.max_pixels)
    return world.with_export(options)


def _build_from(found: Source, options: BuildOptions) -> World:
    if found.kind is SourceKind.FOLDER:
        return _load_world(found, options)
    ground: Ground
    place = None
    if found.kind is SourceKind.MESH:
        ground, scale, place = read_mesh_source(found.path, options)
    elif found.kind is SourceKind.CLOUD:
        ground, scale, place = read_point_cloud(found.path, options)
    elif found.kind in (SourceKind.MAP, SourceKind.MAP_PICTURE):
        ground, scale, place = read_laser_map(found, options)
    else:
        ground, scale, place = read_terrain(found, options)
    world = World(found.name, ground, scale=scale, source=found.identity, start=options.start, place=place)
    return _with_spawn_poses(world)


def _load_world(source: Source, options: BuildOptions) -> World:
    world = World.load(source.path)
    if options.name is not None:
        world = replace(world, name=source.name)
    if options.start is not None:
        world = replace(world, start=options.start)
    if options.window is None:
        return world if options.start is None else _with_spawn_poses(world)
    if isinstance(world.ground, LaserMap) or world.overhangs:
        raise ConfigError(f"{source.path}: --window cuts a built terrain only; give the world's own source")
    ground, lift = _cut(world.ground, options.window)
    return _with_spawn_poses(replace(world, ground=ground, place=world.place and world.place.raised(lift)))


def _cut(ground: Ground, window: Window) -> tuple[Terrain, float]:
    """Return a square of a ground with its lowest point at z = 0, and the height subtracted, meters."""
    surface, lift = leveled(cut_surface(ground.surface, window))
    spacing = sample_spacing(ground.surface, surface)
    return Terrain(surface, cut_nodes(ground.no_ground, ground.surface, surface), spacing), lift


def _with_spawn_poses(world: World) -> World:
    """Return the world with spawn poses for the largest robot that fits; a requested start comes first.

    On a terrain of kilometers the search covers only the center or the neighborhood of the requested start,
    because it has a resolution of decimeters.

    Raises:
        ConfigError: no robot can stand at the requested start, or it is outside the world.
    """
    place = world
    if not isinstance(world.ground, LaserMap) and max(world.surface.size) > SPAWN_AREA:
        west, south, east, north = world.surface.bounds
        middle = world.start or Pose2((west + east) / 2, (south + north) / 2)
        x, y = min(max(middle.x, west), east), min(max(middle.y, south), north)
        place = replace(world, ground=_cut(world.ground, (x, y, SPAWN_AREA))[0])
    resolution = 0.1 if world.walls is not None else max(0.1, max(place.surface.size) / SPAWN_CELLS)
    tried = [(footprint.robot, limits) for footprint in FOOTPRINTS for limits in footprint.limits]
    grids = place.traversable_by([limits for _, limits in tried], resolution)
    for (robot, _), free in zip(tried, grids, strict=True):
        if world.start is not None and not free.free_at(world.start.x, world.start.y):
            continue
        found = place.starts(free)
        if found:
            first = () if world.start is None else (world.start,)
            return replace(world, spawn_poses=(*first, *found)[: len(found)], spawn_for=robot)
    if world.start is not None:
        raise _refused_start(world, place, world.start, resolution)
    return replace(world, spawn_poses=(), spawn_for="")


def _refused_start(world: World, place: World, start: Pose2, resolution: float) -> ConfigError:
    """Return the error for a start where no robot can stand, with its cause.

    The cause is that of the smallest robot, or of the best climber if the smallest fails only by slope.

    Args:
        world: the whole world.
        place: part of the world around the start.
        start: requested start pose.
        resolution: cell size of the search, meters.
    """
    where = f"{world.name}: no robot can start at {start.x:g},{start.y:g}: "
    smallest, climber = FOOTPRINTS[-1], max(FOOTPRINTS, key=lambda footprint: footprint.max_slope)
    for footprint in (smallest, climber):
        clearance, slope = footprint.limits[-1]
        cause, nearest = place.refusal(
            (start.x, start.y), clearance=clearance, max_slope=slope, resolution=resolution
        )
        if " deg (limit" not in cause:
            break
    if not world.surface.contains(start.x, start.y):
        west, south, east, north = world.surface.bounds
        cause = (
            f"that is outside the world, whose x is {west:.5g} to {east:.5g} m and y {south:.5g} to "
            f"{north:.5g} m"
        )
    found = f"nearest place: {nearest}" if nearest else "no place is free"
    return ConfigError(f"{where}{cause}; {found} ({footprint.robot})")
