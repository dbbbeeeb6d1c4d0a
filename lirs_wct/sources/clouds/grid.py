"""Grid of a point cloud: lowest or mean height per node, and filled gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # its modules load on first use
from numpy.typing import NDArray

from lirs_wct.arrays import BoolArray, FloatArray

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
        """Return the grid that starts at the smallest coordinates of points (n, 2) and covers all."""
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
            np.divide(np.bincount(node, v, size), count, out=np.full(size, np.nan), where=count > 0)
            for v in (
                xyz[:, 2],
                (xyz[:, 0] - self.west) / self.spacing - col,
                (xyz[:, 1] - self.south) / self.spacing - row,
            )
        )
        level = z
        for _ in range(2):
            along_y, along_x = np.gradient(_nearest(level.reshape(self.shape)))
            slope_x, slope_y = (
                scipy.ndimage.gaussian_filter(g, SMOOTH, mode="nearest") for g in (along_x, along_y)
            )
            level = z - slope_x.ravel() * east - slope_y.ravel() * north
        return np.asarray(level.reshape(self.shape), np.float64)

    def sample(self, values: FloatArray, xy: FloatArray) -> FloatArray:
        """Return (n,) values of the grid at points, linearly interpolated."""
        at = ((xy[:, 1] - self.south) / self.spacing, (xy[:, 0] - self.west) / self.spacing)
        found: FloatArray = scipy.ndimage.map_coordinates(values, at, order=1, mode="nearest")
        return found


def _nearest(values: FloatArray) -> FloatArray:
    """Return a copy of the grid with each NaN replaced by its nearest value."""
    missing = np.isnan(values)
    if not missing.any():
        return values.copy()
    nearest = scipy.ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    found: FloatArray = values[tuple(nearest)]
    return found


def fill_gaps(values: FloatArray) -> FloatArray:
    """Return the grid with its gaps (NaN) interpolated linearly over triangles between their rims.

    A plane stays a plane. Outside the rims' hull a node takes its nearest value.
    """
    missing = np.isnan(values)
    if not missing.any():
        return values
    rim = scipy.ndimage.binary_dilation(missing, np.ones((3, 3), np.bool_)) & ~missing
    known, wanted = np.argwhere(rim), np.argwhere(missing)
    out = _nearest(values)
    if np.linalg.matrix_rank(known - known[:1]) == 2:  # not all on a line
        linear = scipy.interpolate.LinearNDInterpolator(known, values[rim])(wanted)
        there = np.isfinite(linear)
        out[tuple(wanted[there].T)] = linear[there]
    return out


def gap_distance(missing: BoolArray, spacing: float) -> FloatArray:
    """Return (rows, cols) distances from each node to the nearest known one, meters."""
    distance: FloatArray = scipy.ndimage.distance_transform_edt(missing) * spacing
    return distance
