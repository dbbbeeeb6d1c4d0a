"""Build a world of any source: read its ground, find spawn poses, check the result."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from lirs_wct.errors import ConfigError, LogSourceError, SourceError
from lirs_wct.formats.elevation import MAX_RELIEF, MIN_RELIEF
from lirs_wct.formats.picture import read_picture
from lirs_wct.geometry import Float32Array, Pose2, fewer_nodes
from lirs_wct.ground import LaserMap, Terrain, cut_terrain
from lirs_wct.navigation import FOOTPRINTS
from lirs_wct.sources.laser_map import read_laser_map
from lirs_wct.sources.mesh_source import read_mesh_source
from lirs_wct.sources.picture import read_terrain
from lirs_wct.sources.point_cloud import read_point_cloud
from lirs_wct.sources.source import (
    BuildOptions,
    Reading,
    Source,
    SourceKind,
    find_source,
    warn_without_effect,
)
from lirs_wct.world import World

TEXTURES = (".png", ".jpg", ".jpeg")
"""Texture formats that both Gazebo and the MuJoCo viewer support."""
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
    return _build(source, options or BuildOptions())


def preview_world(source: str | Path, options: BuildOptions) -> World:
    """Build a world without start poses; its warnings are those of `build_world`."""
    return _build(source, options, with_starts=False)


def coarser(world: World, nodes: int) -> World:
    """Return a terrain on at most so many nodes a side; others stay."""
    if not isinstance(world.ground, Terrain) or world.ground.no_ground is not None:
        return world
    return replace(world, ground=Terrain(fewer_nodes(world.surface, nodes)), scale="preview")


def _build(source: str | Path, options: BuildOptions, *, with_starts: bool = True) -> World:
    site = find_source(source, options)
    if site.kind is SourceKind.LOG:
        raise LogSourceError(f"{site.path}: a log is mapped before it is a world")
    warn_without_effect(site, options)
    if site.kind is SourceKind.FOLDER:
        world = _load_world(site, options)
    else:
        ground, scale, place = READERS[site.kind](site, options)
        world = World(site.name, ground, scale=scale, source=site.identity, start=options.start, place=place)
        world = _with_spawn_poses(world) if with_starts else world
    warn_of_result(site, options, world)
    for path in filter(None, (options.texture, options.wall_texture)):
        if path.suffix.lower() not in TEXTURES:
            raise SourceError(f"{path}: a texture must be a PNG or JPEG picture ({', '.join(TEXTURES)})")
        read_picture(path, options.max_pixels, alpha=True)
    return world.with_export(options)


READERS: dict[SourceKind, Callable[[Source, BuildOptions], Reading]] = {
    SourceKind.BUNDLED: read_terrain,
    SourceKind.PICTURE: read_terrain,
    SourceKind.MAP: read_laser_map,
    SourceKind.MAP_PICTURE: read_laser_map,
    SourceKind.MESH: read_mesh_source,
    SourceKind.CLOUD: read_point_cloud,
}
"""Readers of the sources that are files, and of bundled worlds."""


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
    ground, lift = cut_terrain(world.ground, options.window)
    return _with_spawn_poses(replace(world, ground=ground, place=world.place and world.place.raised(lift)))


def _with_spawn_poses(world: World) -> World:
    """Return the world with spawn poses for the largest robot that fits.

    On a terrain of kilometers the search covers only the center or the neighborhood of the requested start,
    because it has a resolution of decimeters.
    """
    place = world
    if not isinstance(world.ground, LaserMap) and max(world.surface.size) > SPAWN_AREA:
        west, south, east, north = world.surface.bounds
        middle = world.start or Pose2((west + east) / 2, (south + north) / 2)
        x, y = min(max(middle.x, west), east), min(max(middle.y, south), north)
        place = replace(world, ground=cut_terrain(world.ground, (x, y, SPAWN_AREA))[0])
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

    The cause is that of the smallest robot, or of the best climber if the smallest fails only by slope. The
    place is the part of the world around the start, the resolution the cell size of the search, meters.
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


WINDOW_SHARE = 0.98
"""Share of a window's side above which it counts as inside the world: windows are cut at nodes."""
MAX_WALLS = 0.5
"""Usual share of wall cells in a map, at most."""
MIN_WIDTH, MAX_WIDTH = 1.0, 100_000.0
"""Usual width, meters."""
END_SHARE = 0.05
"""Share of the range at both ends outside which an isolated level leaves no height."""
LEVEL_GAP = 20.0
"""Distance of an isolated level from the other heights, multiple of their range."""


def warn_of_result(source: Source, options: BuildOptions, world: World) -> None:
    """Warn of each unusual figure of a world, and of options without effect."""
    lines, size = list(unusual_figures(world, source.kind)), world.surface.size
    if options.window is not None and min(size) < WINDOW_SHARE * options.window[2]:
        x, y, side = options.window
        window = f"--window {x:g},{y:g},{side:g} reaches beyond the world"
        lines.insert(0, f"{window}, {size[0]:.4g} x {size[1]:.4g} m of it are left")
    if options.max_error and (world.walls is not None or world.overhangs):
        lines.insert(0, "--max-error has no effect: walls and overhangs are written as they are")
    for line in lines:
        warnings.warn(f"{source.path}: {line}", stacklevel=3)


def unusual_figures(world: World, kind: SourceKind) -> Iterator[str]:
    """Yield each unusual figure of a world with its likely cause."""
    width, is_picture = max(world.surface.size), kind is SourceKind.PICTURE
    change = " --size and --scale change it" if kind in (SourceKind.PICTURE, SourceKind.MESH) else ""
    if not MIN_WIDTH <= width <= MAX_WIDTH:
        yield (
            f"the world is {width:.4g} m wide, usual are {MIN_WIDTH:g} m to {MAX_WIDTH / 1000:g} km: "
            f"is the {'resolution' if isinstance(world.ground, LaserMap) else 'unit'} right?{change}"
        )
    if isinstance(world.ground, LaserMap):
        yield from _unusual_map(world.ground)
        return
    relief = world.surface.relief if world.solid is None else float(np.ptp(world.solid.vertices[:, 2]))
    if relief > MAX_RELIEF * width:
        codes = ', or do some values mean "no height" (--option nodata=VALUE)' if is_picture else ""
        times = f"{relief / width:.3g} x the width of {width:.4g} m"
        yield f"the relief of {relief:.4g} m is {times}: is a unit wrong{codes}?"
    if relief < MIN_RELIEF * width:
        place = ": are its heights in another band, or in the alpha channel?" if is_picture else ""
        yield f"the ground is flat, {relief:.3g} m of relief on {width:.4g} m{place}"
    if isinstance(world.ground, Terrain) and world.ground.no_ground is None:
        says = " --option nodata=VALUE says so" if is_picture else ""
        yield from _isolated_level(world.surface.z, says)


def _unusual_map(ground: LaserMap) -> Iterator[str]:
    if (grid := ground.truth) is None:
        return
    walls = float(grid.occupied.mean())
    causes = "occupied_thresh, free_thresh, negate, mode and transparency decide"
    if walls == 0 or walls > MAX_WALLS:
        yield f"{walls:.1%} of its cells are walls, usual are above 0 and up to {MAX_WALLS:.0%}: {causes}"
    if not grid.free.any():
        yield f"none of its {grid.occupied.size} cells is free: {causes}"


def _isolated_level(z: Float32Array, says: str) -> Iterator[str]:
    """Yield the heights far outside all others, with a hint."""
    low, high = float(z.min()), float(z.max())
    margin = END_SHARE * (high - low)
    below, above = z < low + margin, z > high - margin
    if low == high or int(below.sum()) + int(above.sum()) < z.size:
        return
    few, others = (below, above) if below.sum() < above.sum() else (above, below)
    part, rest = z[few], z[others]
    gap = max(float(rest.min() - part.max()), float(part.min() - rest.max()))
    if np.ptp(rest) > 0 and gap > LEVEL_GAP * np.ptp(rest):
        side = "below" if few is below else "above"
        yield (
            f"{part.size} of {z.size} heights lie {gap:.4g} m {side} all others, "
            f'which span {np.ptp(rest):.3g} m: do they mean "no height"?{says}'
        )
