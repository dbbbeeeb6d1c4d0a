"""Reader of point clouds as terrain: ground or top as heights on a grid.

The ground is that of the simple morphological filter (SMRF): T. J. Pingel, K. C. Clarke, W. A. McBride: An
improved simple morphological filter for the terrain classification of airborne LIDAR data. ISPRS Journal of
Photogrammetry and Remote Sensing 77 (2013), 21-30. Here gaps are filled linearly, in the paper by springs.

The paper's best slope grows with the terrain's own slope (section 4.3). With one slope for all sites, summits
and ridges of mountains count as objects. Here the slope limit follows the terrain where that is steep.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import scipy  # its modules load on first use
from numpy.typing import NDArray

from lirs_wct.errors import Checked, ConfigError, SourceError, limited
from lirs_wct.formats import elevation, point_clouds
from lirs_wct.geometry import BoolArray, FloatArray, HeightField, nearest_values
from lirs_wct.geometry.geodesy import Place
from lirs_wct.ground import Terrain, leveled
from lirs_wct.sources.source import BuildOptions, Reading, Source, local_origin

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
    return Terrain(surface, no_ground), scale, place


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
            "tells ground from objects there; --option ground-slope sets one for all",
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


SMOOTH = 2.0
"""Standard deviation of the Gaussian that smooths slopes, nodes."""


@dataclass(frozen=True, slots=True)
class NodeGrid:
    """Nodes over an extent in the plane; row 0 = south.

    Attributes:
        west: x of the first column, meters.
        south: y of the first row, meters.
        spacing: distance of adjacent nodes, meters.
        shape: rows and columns.
    """

    west: float
    south: float
    spacing: float
    shape: tuple[int, int]

    @staticmethod
    def over(xy: FloatArray, spacing: float) -> NodeGrid:
        """Return the grid over all points (n, 2), from their smallest coordinates."""
        (west, south), (east, north) = xy.min(axis=0).tolist(), xy.max(axis=0).tolist()
        rows, cols = (
            max(2, int(np.ceil(side / spacing - 1e-9)) + 1) for side in (north - south, east - west)
        )
        return NodeGrid(west, south, spacing, (rows, cols))

    def node_of(self, xy: FloatArray) -> NDArray[np.int64]:
        """Return (n,) the nearest node of each point, as an index into the flat grid."""
        col = np.rint((xy[:, 0] - self.west) / self.spacing).astype(np.int64)
        row = np.rint((xy[:, 1] - self.south) / self.spacing).astype(np.int64)
        rows, cols = self.shape
        return np.clip(row, 0, rows - 1) * cols + np.clip(col, 0, cols - 1)

    def lowest(self, xyz: FloatArray) -> FloatArray:
        """Return (rows, cols) heights of the lowest point at each node; NaN without a point."""
        z = np.full(self.shape, np.inf)
        np.minimum.at(z.ravel(), self.node_of(xyz), xyz[:, 2])
        return np.where(np.isfinite(z), z, np.nan)

    def mean(self, xyz: FloatArray) -> FloatArray:
        """Return (rows, cols) mean heights of the points at each node; NaN without a point.

        The points' centroid differs from the node: the local slope moves their mean height to the node.
        """
        node, size = self.node_of(xyz), self.shape[0] * self.shape[1]
        row, col = np.divmod(node, self.shape[1])
        count = np.bincount(node, minlength=size)
        z, east, north = (
            np.divide(np.bincount(node, v, size), count, out=np.full(size, np.nan), where=count > 0).reshape(
                self.shape
            )
            for v in (
                xyz[:, 2],
                (xyz[:, 0] - self.west) / self.spacing - col,
                (xyz[:, 1] - self.south) / self.spacing - row,
            )
        )
        level: FloatArray = z
        for _ in range(2):
            gradient = np.gradient(nearest_values(level, np.isnan(level)))
            slope_y, slope_x = (scipy.ndimage.gaussian_filter(g, SMOOTH, mode="nearest") for g in gradient)
            level = z - slope_x * east - slope_y * north
        return level

    def sample(self, values: FloatArray, xy: FloatArray) -> FloatArray:
        """Return (n,) values of the grid at points, linearly interpolated."""
        at = ((xy[:, 1] - self.south) / self.spacing, (xy[:, 0] - self.west) / self.spacing)
        sampled: FloatArray = scipy.ndimage.map_coordinates(values, at, order=1, mode="nearest")
        return sampled


def fill_gaps(values: FloatArray) -> FloatArray:
    """Return the grid with its gaps (NaN) interpolated linearly over triangles between their rims.

    A plane stays a plane. Outside the rims' hull a node takes its nearest value.
    """
    missing = np.isnan(values)
    if not missing.any():
        return values
    rim = scipy.ndimage.binary_dilation(missing, np.ones((3, 3), np.bool_)) & ~missing
    known, wanted = np.argwhere(rim), np.argwhere(missing)
    out = nearest_values(values, missing)
    if np.linalg.matrix_rank(known - known[:1]) == 2:  # not all on a line
        linear = scipy.interpolate.LinearNDInterpolator(known, values[rim])(wanted)
        there = np.isfinite(linear)
        out[tuple(wanted[there].T)] = linear[there]
    return out


MAX_CELLS, CELLS_PER_POINT = 1e7, 1000.0
"""Cells of the grid, and cells per point, one of which may be exceeded."""
MAX_SLOPE = 5.0
"""Slope limit for low outliers, rise over run (section 2.2)."""


@dataclass(frozen=True, kw_only=True)
class Smrf(Checked):
    """Parameters of SMRF, by default the paper's values for all sites (section 4.2).

    Attributes:
        slope: steepest ground, rise over run.
        mountain: mean slope around a cell above which this mean replaces `slope`; inf = nowhere.
        window: radius of the largest object, meters.
        threshold: largest height of a ground point over the provisional ground, meters, on level ground.
        scaling: increase of `threshold` per unit of slope, meters.
        cell: smallest cell of the grid on which objects are found, meters.
    """

    slope: float = limited(0.15, "(0, inf]")
    mountain: float = limited(0.4, "(0, inf]")
    window: float = limited(18.0, "(0, inf]")
    threshold: float = limited(0.5, "(0, inf]")
    scaling: float = limited(1.25, "(0, inf]")
    cell: float = limited(1.0, "(0, inf]")


def ground_points(xyz: FloatArray, options: Smrf) -> tuple[BoolArray, float]:
    """Return the mask (n,) of ground points, and the share of mountains.

    The grid of lowest points is opened by growing disks. A cell that an opening lowers by more than the slope
    allows is an object. The other cells, with filled gaps, are the provisional ground; the points near it are
    the ground (the paper's steps 1 to 4).
    """
    grid, window = node_grid(xyz, options)
    lowest = grid.lowest(xyz)
    empty = np.isnan(lowest)
    surface = fill_gaps(lowest)
    wrong = empty | _objects(-surface, MAX_SLOPE, grid.spacing, grid.spacing)
    surface = fill_gaps(np.where(wrong, np.nan, surface))
    objects = _objects(surface, options.slope, window, grid.spacing)
    provisional = fill_gaps(np.where(wrong | objects, np.nan, surface))
    # The mean slope by a Gaussian of half a window: a crest has the slope of its flanks.
    smooth = scipy.ndimage.gaussian_filter(provisional, SMOOTH, mode="nearest")
    steepness = np.hypot(*np.gradient(smooth, grid.spacing))
    around = scipy.ndimage.gaussian_filter(steepness, window / 2 / grid.spacing, mode="nearest")
    mountains = around > options.mountain
    if mountains.any():
        limits = np.where(mountains, around, options.slope)
        objects = _objects(surface, limits, window, grid.spacing)
        provisional = fill_gaps(np.where(wrong | objects, np.nan, surface))
    north, east = np.gradient(provisional, grid.spacing)
    limit = options.threshold + options.scaling * np.hypot(north, east)
    off = np.abs(xyz[:, 2] - grid.sample(provisional, xyz[:, :2]))
    return off <= grid.sample(limit, xyz[:, :2]), float(mountains.mean())


def node_grid(xyz: FloatArray, options: Smrf) -> tuple[NodeGrid, float]:
    """Return the grid on which objects are found, and the radius of the largest, meters."""
    sides = np.ptp(xyz[:, :2], axis=0)
    extent = float(sides.min())
    window = min(options.window, extent / 3)
    coarsest = math.sqrt(float(sides.prod()) / max(MAX_CELLS, CELLS_PER_POINT * len(xyz)))
    return NodeGrid.over(xyz[:, :2], max(min(options.cell, extent / 30), window / 36, coarsest)), window


def _objects(surface: FloatArray, slope: float | FloatArray, window: float, cell: float) -> BoolArray:
    """Return (rows, cols) whether openings by disks up to `window` lower cells too much."""
    last = surface.astype(np.float32)
    found = np.zeros(surface.shape, np.bool_)
    for radius in range(1, max(1, round(window / cell)) + 1):
        disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
        # Padded with its border values: an opening at the border sees no lower ground outside.
        wide = cv2.copyMakeBorder(last, *(2 * radius,) * 4, cv2.BORDER_REPLICATE)
        opened = cv2.morphologyEx(wide, cv2.MORPH_OPEN, disk)
        inner = (slice(2 * radius, -2 * radius),) * 2
        following = np.asarray(opened[inner], np.float32)
        found |= last - following > slope * cell * radius
        last = following
    return found
