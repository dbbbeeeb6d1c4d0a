"""Reader of point clouds as terrain: ground or top as heights on a grid."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np
import scipy  # its modules load on first use

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats import elevation, point_clouds
from lirs_wct.geometry import BoolArray, FloatArray, HeightField
from lirs_wct.geometry.geodesy import Place
from lirs_wct.ground import Terrain
from lirs_wct.sources.frame import Reading, leveled, local_origin
from lirs_wct.sources.smrf import NodeGrid, Smrf, fill_gaps, ground_points
from lirs_wct.sources.source import BuildOptions, Source

NODES = 1025
"""Limit of nodes along the longer side for the default resolution."""
POINTS_PER_NODE = 4.0
"""Points per node for the default resolution."""
MIN_SPACING = 0.05
NARROW_SHARE, THIN_SHEET = 0.003, 0.05
"""Width in plan of a line or sheet: share of its length, and meters (or share of one below 1 m)."""
BRIDGED_NODES = 5
"""Distance from the nearest point up to which a gap counts as ground, nodes."""
MOUNTAIN_SHARE = 0.01
"""Share of mountain area above which a warning appears."""
MAX_EMPTY = 0.9
"""Share of nodes without a point above which a cloud is refused."""


def read_point_cloud(source: Source, options: BuildOptions) -> Reading:
    """Read a point cloud as terrain.

    A cloud near its own origin keeps its frame. For a farther one, in coordinates of a country, the center
    becomes the origin, and the lowest ground, or the options' `zero`, becomes z = 0.

    Raises:
        SourceError: the file cannot be used.
        ConfigError: an option does not fit the cloud.
    """
    path, cloud = source.path, point_clouds.read_points(source.path)
    xyz, middle, (sx, sy) = _in_meters(path, cloud, options.z_scale or 1.0)
    kept = _within(path, xyz, options)
    xyz, known = xyz[kept], None if cloud.ground is None else cloud.ground[kept]
    _check_plan(path, xyz)
    grid = _grid(path, xyz, options)
    count = np.bincount(grid.node_of(xyz), minlength=math.prod(grid.shape))
    _require_points(path, count == 0, grid.spacing)  # the ground filter takes long on empty ground
    if options.cloud_surface == "top":
        heights, method = -grid.lowest(xyz * (1.0, 1.0, -1.0)), "the highest points"
    else:
        chosen, method = _ground(path, xyz, known, options)
        heights = grid.mean(xyz[chosen])
    far_from_points = _far_nodes(path, np.isnan(heights), grid.spacing)
    base = options.zero or 0.0
    z = np.ascontiguousarray((fill_gaps(heights) - base)[::-1].astype(np.float32))
    surface = HeightField(z, (grid.spacing,) * 2, (grid.west, grid.south))
    if options.zero is None and middle != (0.0, 0.0):
        surface, base = leveled(surface)
    place = None
    if cloud.system.form != "unknown" or middle != (0.0, 0.0):
        place = Place(cloud.system, (1 / sx, 0.0, middle[0], 0.0, 1 / sy, middle[1]), base)
    no_ground = far_from_points[::-1] if far_from_points.any() else None
    scale = f"the file's own, {grid.spacing:.3g} m a node, {method}"
    return Reading(Terrain(surface, no_ground), scale, place)


def _in_meters(
    path: Path, cloud: point_clouds.PointFile, z_scale: float
) -> tuple[FloatArray, tuple[float, float], tuple[float, float]]:
    """Return points in the world's frame (meters), its origin, and its units.

    The origin is in the file's coordinates; the units are meters per coordinate.
    """
    system, xyz = cloud.system, cloud.xyz
    if system.form == "geographic":
        raise SourceError(
            f"{path}: is in degrees, meters are needed; PDAL's filters.reprojection projects it"
        )
    x, y = local_origin(path, xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0), system.unit)
    sx, sy = system.unit, system.unit
    if system.form != "unknown":
        sx, sy = elevation.georeference_raster(path, system, (1.0, 0.0, x, 0.0, -1.0, y), (1, 1)).pixel
    unit = elevation.height_unit(path, system, cloud.height_unit) * z_scale
    return (xyz - (x, y, 0.0)) * (sx, sy, unit), (x, y), (sx, sy)


def _check_plan(path: Path, xyz: FloatArray) -> None:
    """Refuse a cloud without area in plan."""
    # Sides of a uniform rectangle of these variances: a single stray point hardly changes them.
    narrow, wide = np.sqrt(12 * np.linalg.eigvalsh(np.cov(xyz[:, :2].T)).clip(0)).tolist()
    if narrow <= max(NARROW_SHARE * wide, min(THIN_SHEET, THIN_SHEET * wide)):
        raise SourceError(
            f"{path}: a terrain needs an extent along x and y: its {len(xyz)} points, {narrow:.3g} m wide on "
            f"{wide:.4g} m, are a line or a vertical sheet in plan"
        )


def _within(path: Path, xyz: FloatArray, options: BuildOptions) -> BoolArray:
    """Return (n,) whether a point is in the window."""
    if options.window is None:
        return np.ones(len(xyz), np.bool_)
    x, y, side = options.window
    kept = np.asarray((np.abs(xyz[:, :2] - (x, y)) <= side / 2).all(axis=1))
    if kept.sum() < 3:
        (west, south), (east, north) = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
        raise ConfigError(
            f"{path}: window {x:g},{y:g},{side:g} holds {int(kept.sum())} points; the cloud has "
            f"x {west:.4g} to {east:.4g}, y {south:.4g} to {north:.4g} m"
        )
    return kept


def _ground(
    path: Path, xyz: FloatArray, known: BoolArray | None, options: BuildOptions
) -> tuple[BoolArray, str]:
    """Return (n,) whether a point is on the ground, and the method as text."""
    if known is not None and known.sum() >= 3:
        return known, "the ground by the file's classes"
    filtering = Smrf()
    if options.ground_slope is not None:
        filtering = Smrf(slope=options.ground_slope, mountain=math.inf)
    on_ground, mountains = ground_points(xyz, filtering)
    if mountains > MOUNTAIN_SHARE:
        warnings.warn(
            f"{path}: {mountains:.0%} of the area is steeper than {filtering.mountain:g}; its own slope "
            "tells ground from objects there; the option ground-slope sets one for all",
            stacklevel=4,
        )
    return on_ground, "the ground by SMRF (Pingel 2013)"


def _grid(path: Path, xyz: FloatArray, options: BuildOptions) -> NodeGrid:
    sides = np.ptp(xyz[:, :2], axis=0)
    spacing = options.resolution
    if spacing is None:
        dense = math.sqrt(POINTS_PER_NODE * float(sides.prod()) / len(xyz))
        spacing = max(dense, float(sides.max()) / (NODES - 1), MIN_SPACING)
    grid = NodeGrid.over(xyz[:, :2], spacing)
    rows, cols = grid.shape
    if rows * cols > options.max_pixels:
        raise ConfigError(
            f"{path}: {cols}x{rows} nodes at {spacing:g} m, at most {options.max_pixels} are legal; "
            "give a coarser --resolution or a larger --option max-pixels=N"
        )
    return grid


def _far_nodes(path: Path, missing: BoolArray, spacing: float) -> BoolArray:
    """Warn of nodes without a point; return those too far from any."""
    _require_points(path, missing, spacing)
    distance = scipy.ndimage.distance_transform_edt(missing) * spacing
    far: BoolArray = distance > BRIDGED_NODES * spacing
    if missing.any():
        left = (
            f"; {int(far.sum())} of them, over {BRIDGED_NODES * spacing:.3g} m from any point, are no ground"
        )
        more = left if far.any() else ""
        warnings.warn(
            f"{path}: {int(missing.sum())} of {missing.size} nodes at {spacing:.3g} m have no point of the "
            f"surface and are interpolated, the widest gap is {2 * distance.max():.3g} m{more}",
            stacklevel=4,
        )
    return far


def _require_points(path: Path, missing: BoolArray, spacing: float) -> None:
    if (share := float(missing.mean())) > MAX_EMPTY:
        raise SourceError(
            f"{path}: {share:.1%} of the nodes at {spacing:.3g} m have no point: give a coarser "
            "--resolution, or --window X,Y,SIDE where some points are stray"
        )
