"""Reader of mesh files as sources: heights from above, and the mesh itself if closed."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.meshes.reader import read_upright
from lirs_wct.geometry import BoolArray, FloatArray, HeightField
from lirs_wct.geometry.geodesy import CoordinateSystem, Place
from lirs_wct.geometry.mesh import Grid, TriangleMesh, layers, rasterize_heights
from lirs_wct.ground import Ground, MeshGround, Terrain, Window, leveled
from lirs_wct.sources.source import BuildOptions, Reading, Source, local_origin

NODES = 1025
"""Default number of nodes along the longer side."""
MIN_SPACING, COARSE_SPACING = 0.02, 0.25
"""Smallest default node spacing, meters: finer detail does not affect a wheel; one that misses walls."""
UNITLESS = (".stl", ".obj", ".ply")
"""Files that do not state their unit; some name it in their first bytes, as those of this program do."""
OPENING, OPENING_SHARE = 0.3, 0.25
"""Height of an opening that rays and robots pass, meters, or share of the mesh's height if that is less."""
WALL_NORMAL, WALL_SHARE = 0.1, 0.01
"""Vertical component of a wall's unit normal, at most; area of walls that heights lack, share of all."""
NEIGHBORS = np.ones((3, 3), np.uint8)
"""A node and its neighbors."""
TALL_SHARE = 0.1
"""Height of a large mesh from a file with a unit, share of its width, from which millimeters are likely."""
LOW_SHARE = 0.5
"""Depth along y of a relief with y up, share of its shorter other side."""
SLOPE_COSINE, LEVEL_COSINE = 0.5, 0.9999
"""Cosines to y between which a face is a slope: below is a wall, above a floor."""
RELIEF_SHARE = 0.35
"""Share of slopes in the area of a relief with y up."""
HEAD_BYTES = 80
"""Bytes of a file that may name its unit."""
UNIT = re.compile(rb"\b(?:(mm|millimet(?:er|re)s?)|met(?:er|re)s?)\b", re.IGNORECASE)
"""Unit in these bytes; the group holds millimeters."""
MAX_METERS = 1000.0
"""Longest side from which coordinates without a unit are likely millimeters."""
MAX_RISE, STEEP_SHARE = 100.0, 0.25
"""Height (meters, share of the longest side) above which they are, too: robots on wheels climb no tower."""


def read_mesh_source(source: Source, options: BuildOptions) -> Reading:
    """Read a mesh as heights from above, and itself if closed or with overhangs.

    The mesh keeps its own frame, meters and z up; far from its origin, its center becomes the world's. An
    open mesh without overhangs, or one cut by a window, becomes its heights from above.
    """
    path = source.path
    mesh = read_upright(path, options.up)
    if mesh.is_watertight and mesh.volume < 0:  # some programs write solids inside out
        mesh = TriangleMesh(mesh.vertices, np.ascontiguousarray(mesh.faces[:, ::-1]))
    mesh, (sx, sy, _) = _scale(mesh, options)
    low, high = mesh.bounds
    if not (high[:2] - low[:2] > 0).all():
        hint = "; is y up? --up y" if options.up is None and high[2] > low[2] else ""
        raise SourceError(
            f"{path}: a terrain needs an extent along x and y, this is {_size(low, high)} m{hint}"
        )
    _warn_of_units(path, mesh, options)
    place = None
    x, y = local_origin(path, low[:2], high[:2])
    if (x, y) != (0.0, 0.0):
        mesh = replace(mesh, vertices=mesh.vertices - (x, y, low[2]))
        place = Place(CoordinateSystem(), (1 / sx, 0.0, x / sx, 0.0, 1 / sy, y / sy), float(low[2]))
    surface, overhangs, no_ground = _surface(path, mesh, options)
    is_solid = mesh.is_watertight or overhangs
    if not mesh.is_watertight:
        way = "contact is one-sided: on the front of its faces"
        way = way if overhangs else "its world is made from its heights seen from above"
        warnings.warn(f"{path}: is not closed, {way}", stacklevel=3)
    if options.window is not None:
        if overhangs:
            raise ConfigError(f"{path}: has overhangs, --window cannot cut it")
        surface, lift = leveled(surface)
        place = place and place.raised(lift)
    if no_ground.any():
        warnings.warn(
            f"{path}: {int(no_ground.sum())} of {no_ground.size} nodes have no ground, "
            "set to the lowest height",
            stacklevel=3,
        )
    gaps = no_ground if is_solid and no_ground.any() else None
    ground: Ground = Terrain(surface, gaps)
    if is_solid and options.window is None:
        ground = MeshGround(surface, mesh, overhangs, gaps)
    scaled = options.size or options.height or options.scale or options.z_scale
    return ground, "as given" if scaled else "the file's own", place


def _warn_of_units(path: Path, mesh: TriangleMesh, options: BuildOptions) -> None:
    """Warn of a mesh that seems to be in millimeters, or to have y up."""
    width, depth, height = np.ptp(mesh.bounds, axis=0).tolist()
    side = max(width, depth)
    if path.suffix.lower() in UNITLESS:
        is_large = side >= MAX_METERS or height > max(MAX_RISE, STEEP_SHARE * side)
    else:
        is_large = side >= MAX_METERS and height > max(MAX_METERS, TALL_SHARE * side)
    with path.open("rb") as file:
        named = UNIT.search(file.read(HEAD_BYTES))
    if (named[1] if named else is_large) and not (options.size or options.scale):
        warnings.warn(
            f"{path}: is {_size(*mesh.bounds)} m, as its unit counts as the meter; "
            f"{'it names' if named else 'if it is'} the millimeter, give --option scale=0.001",
            stacklevel=4,
        )
    area, along = mesh.face_areas, np.abs(mesh.face_normals[:, 1])
    sloped = area[(along > SLOPE_COSINE) & (along < LEVEL_COSINE)].sum()
    is_upright = depth < LOW_SHARE * min(width, height) and sloped > RELIEF_SHARE * area.sum()
    if options.up is None and is_upright:
        up = "z" if path.suffix.lower() == ".glb" else "y"  # y is up in a GLB
        warnings.warn(
            f"{path}: is {_size(*mesh.bounds)} m and most of its faces look along y: "
            f"{up.upper()} up? --up {up}",
            stacklevel=4,
        )


def _surface(path: Path, mesh: TriangleMesh, options: BuildOptions) -> tuple[HeightField, bool, BoolArray]:
    """Return the heights from above, whether there are overhangs, and the nodes without ground."""
    (west, south), (east, north) = _extent(mesh, options.window)
    spacing = options.resolution or max(max(east - west, north - south) / (NODES - 1), MIN_SPACING)
    cols, rows = (max(2, round(side / spacing) + 1) for side in (east - west, north - south))
    if rows * cols > options.max_pixels:
        raise ConfigError(
            f"{path}: {cols}x{rows} nodes at {spacing:g} m, at most {options.max_pixels} are legal; "
            "give a coarser --resolution or a larger --option max-pixels=N"
        )
    if options.resolution is None and spacing > COARSE_SPACING:
        warnings.warn(
            f"{path}: drivable ground and walls are found at nodes {spacing:.2g} m apart; "
            "--option resolution=METERS sets them closer",
            stacklevel=4,
        )
    grid = (west, south, (east - west) / (cols - 1), (north - south) / (rows - 1))
    top = rasterize_heights(mesh, grid, (rows, cols))
    no_ground = np.isnan(top)
    if no_ground.all():
        raise SourceError(f"{path}: has no face that is seen from above")
    overhangs = bool((layers(mesh, grid, (rows, cols)) > (2 if mesh.is_watertight else 1)).any())
    overhangs = overhangs and not _is_stacked(mesh)
    has_more = _has_openings if mesh.is_watertight else _has_thin_walls
    overhangs = overhangs or has_more(mesh, grid, top)
    if no_ground.any():
        top[no_ground] = mesh.bounds[0, 2]
    z = np.ascontiguousarray(top[::-1].astype(np.float32))
    return HeightField(z, grid[2:], grid[:2]), overhangs, no_ground[::-1]


def _has_openings(mesh: TriangleMesh, grid: Grid, top: FloatArray) -> bool:
    """Whether space below a closed mesh is open to the side, as in a door."""
    low, high = mesh.bounds[:, 2]
    least = min(OPENING, OPENING_SHARE * (high - low))
    below = -rasterize_heights(TriangleMesh(mesh.vertices * (1.0, 1.0, -1.0), mesh.faces), grid, top.shape)
    no_ground = np.isnan(top)
    # A node on a side of the mesh sees any height of that side, its neighbors do not.
    below, top = (cv2.erode(np.nan_to_num(heights, nan=high), NEIGHBORS) for heights in (below, top))
    below[no_ground] = np.nan
    # A sheet of constant thickness steps on both sides.
    steps = (np.abs(np.diff(below, axis=k)) - np.abs(np.diff(top, axis=k)) > least for k in (0, 1))
    beside_no_ground = cv2.dilate(no_ground.astype(np.uint8), NEIGHBORS) > 0
    return any(step.any() for step in steps) or bool((beside_no_ground & (below - low > least)).any())


def _has_thin_walls(mesh: TriangleMesh, grid: Grid, top: FloatArray) -> bool:
    """Whether an open mesh has walls of a single face, hidden from above."""
    west, south, *spacing = grid
    columns, rows = np.rint((mesh.vertices[:, :2] - (west, south)) / spacing).astype(int).T
    inside = (columns >= 0) & (columns < top.shape[1]) & (rows >= 0) & (rows < top.shape[0])
    around = cv2.dilate(np.nan_to_num(top, nan=mesh.bounds[0, 2]), NEIGHBORS)
    hidden = np.zeros(len(mesh.vertices), bool)
    hidden[inside] = mesh.vertices[inside, 2] > around[rows[inside], columns[inside]] + OPENING
    walls = hidden[mesh.faces].any(axis=1) & (np.abs(mesh.face_normals[:, 2]) < WALL_NORMAL)
    return bool(mesh.face_areas[walls].sum() > WALL_SHARE * mesh.face_areas.sum())


def _is_stacked(mesh: TriangleMesh) -> bool:
    """Whether an open mesh has only tops and bottoms: adjacent bodies that share faces."""
    f, up = mesh.faces, mesh.face_normals[:, 2]
    edges = np.sort(np.concatenate((f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]])), axis=1)
    _, count = np.unique(edges[:, 0].astype(np.int64) * len(mesh.vertices) + edges[:, 1], return_counts=True)
    tops, bottoms = (mesh.vertices[f[faces]][..., 2] for faces in (up > 1e-9, up < -1e-9))
    if mesh.is_watertight or (count % 2).any() or not (tops.size and bottoms.size):
        return False
    return float(bottoms.max()) <= float(tops.min())


def _extent(mesh: TriangleMesh, window: Window | None) -> tuple[tuple[float, float], tuple[float, float]]:
    low, high = mesh.bounds[0, :2], mesh.bounds[1, :2]
    if window is not None:
        x, y, side = window
        center = np.array((x, y))
        low, high = np.maximum(low, center - side / 2), np.minimum(high, center + side / 2)
        if not (high - low > 0).all():
            raise ConfigError(f"window {x:g},{y:g},{side:g} lies outside the mesh: {_size(*mesh.bounds)} m")
    return (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))


def _scale(mesh: TriangleMesh, options: BuildOptions) -> tuple[TriangleMesh, FloatArray]:
    """Return the mesh scaled to the options' meters, and the three factors."""
    extent = np.ptp(mesh.bounds, axis=0)
    factor = np.ones(3)
    if isinstance(options.size, tuple):
        factor[:2] = np.array(options.size) / np.where(extent[:2] > 0, extent[:2], 1.0)
    elif options.size is not None:
        factor[:2] = options.size / max(float(extent[:2].max()), 1e-12)
    if options.height is not None and extent[2] > 0:
        factor[2] = options.height / extent[2]
    factor *= options.scale or (1.0, 1.0, 1.0)
    factor[2] *= options.z_scale or 1.0
    return TriangleMesh(mesh.vertices * factor, mesh.faces), factor


def _size(low: FloatArray, high: FloatArray) -> str:
    return " x ".join(f"{side:g}" for side in high - low)
