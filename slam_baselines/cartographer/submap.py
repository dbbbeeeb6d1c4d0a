"""Submaps: rigid pieces of the map, each drawn from a sequence of scans.

Hess et al. 2016, "Real-time loop closure in 2D LIDAR SLAM", section IV: a scan enters two submaps, the
older of which is matched against; it has seen enough to match well, and when it is finished the
younger has, too. A finished submap is packed; the searched ones that were needed last stay unpacked.
"""

from __future__ import annotations

import math
import zlib
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.geometry import ByteArray, FloatArray, Pose2
from slam_baselines.cartographer.branch_and_bound import BoundGrids
from slam_baselines.cartographer.config import CartographerConfig
from slam_baselines.leveling import ScanPoints
from slam_baselines.occupancy_map import (
    FREE,
    UNKNOWN,
    UNSEEN,
    VALUE,
    Levels,
    MapPyramid,
    OccupancyMap,
    RayTracer,
    Trace,
    bounding_box,
)

TracedScan = tuple[list[Trace], FloatArray]
"""Traces of a scan on all levels, and its (4,) bounding box, meters."""


class Tracers:
    """Trace scans for all submaps, whose levels are parts of the same lattices."""

    def __init__(self, config: CartographerConfig) -> None:
        self._levels = [RayTracer(config.resolution * 2**level) for level in range(config.submap_levels)]

    def trace(self, scan: ScanPoints) -> TracedScan:
        """Return a scan's traces in the local frame on each level; void after the next."""
        box = bounding_box(scan)
        return [level.trace(scan, box) for level in self._levels], box


class Submap:
    """A small map in the local frame, drawn from the scans of its nodes.

    Attributes:
        pose: `T_local_submap`, the pose of its first scan.
        pyramid: Occupancy, finest level first, in the local frame; empty when it is finished.
    """

    def __init__(self, config: CartographerConfig, pose: Pose2) -> None:
        self.pose = pose
        self.nodes: list[int] = []
        self._config = config
        self._wall_slope = 0
        self._packed: tuple[PackedLevel, ...] | None = None
        self._unpacked: Levels | None = None
        self._bounds: BoundGrids | None = None
        sizes = [config.resolution * 2**level for level in range(config.submap_levels)]
        self.pyramid = MapPyramid(tuple(OccupancyMap(size, config) for size in sizes))

    @property
    def finished(self) -> bool:
        """Whether no more scans will enter it."""
        return self._packed is not None

    def finish(self) -> None:
        """Finish the submap: pack the layers that matching needs, drop the others."""
        self._packed = tuple(PackedLevel.of(level) for level in self.pyramid.maps)
        self._drop_layers()

    def drop_grids(self) -> None:
        """Drop the grids; pose and nodes stay."""
        self._packed = ()
        self._drop_layers()

    def _drop_layers(self) -> None:
        self.pyramid = MapPyramid(tuple(OccupancyMap(level.resolution) for level in self.pyramid.maps))
        self.release()

    def release(self) -> None:
        """Drop unpacked levels and bounds, which can be computed again."""
        self._unpacked = self._bounds = None

    @property
    def known_points(self) -> FloatArray:
        """Centers (n, 2) of the known cells of the coarsest level, in the local frame."""
        level = self.coarsest
        if self._packed is None:
            cells = np.argwhere(level.layers.log_odds != UNKNOWN)[:, ::-1] + (
                level.grid.col0,
                level.grid.row0,
            )
        elif self._packed:
            cells = self._packed[-1].known_cells()
        else:
            cells = np.empty((0, 2), np.int64)
        return np.asarray((cells + 0.5) * level.resolution, dtype=np.float64)

    def draw_range_data(
        self,
        node: int,
        scan: ScanPoints,
        min_slopes: ByteArray,
        wall_slope: int,
        traced: TracedScan | None = None,
    ) -> None:
        """Draw a scan in the local frame (see OccupancyMap.update); `traced` saves tracing it."""
        self.set_wall_slope(wall_slope)
        self.nodes.append(node)
        traces, box = traced or Tracers(self._config).trace(scan)
        levels = zip(self.pyramid.maps, traces, strict=True)
        grew = [level.enter(trace, scan, min_slopes, wall_slope, box) for level, trace in levels]
        if any(grew):
            self.pyramid.refresh()

    def set_wall_slope(self, wall_slope: int) -> None:
        """Show to matchers only hits of at least the minimum slope `wall_slope` as walls."""
        if wall_slope == self._wall_slope:
            return
        self._wall_slope = wall_slope
        self.release()
        for level in self.pyramid.maps:
            level.revalue(wall_slope)

    @property
    def coarsest(self) -> OccupancyMap:
        """Coarsest level of an unfinished submap; empty when it is finished."""
        return self.pyramid.maps[-1]

    def reserve(self, box: FloatArray) -> None:
        """Allocate the grids for scans in a box (4,): west, south, east, north, meters."""
        for level in self.pyramid.maps:
            level.reserve(box)
        self.pyramid.refresh()

    @property
    def levels(self) -> Levels:
        """Levels for matching; a finished submap unpacks them when first needed."""
        if self._packed is None:
            return self.pyramid.levels
        if self._unpacked is None:
            frames: FloatArray = np.array([level.frame for level in self._packed], dtype=np.float64)
            self._unpacked = Levels(tuple(k.unpack(self._wall_slope) for k in self._packed), frames)
        return self._unpacked

    @property
    def bounds(self) -> BoundGrids:
        """Upper bounds for the loop search; a finished submap computes them when first needed."""
        if self._bounds is not None:
            return self._bounds
        c, levels = self._config, self.levels
        small = (k for k, value in enumerate(levels.values) if max(value.shape) <= c.max_search_cells)
        k = max(c.search_level, next(small, c.submap_levels - 1))
        row0, col0, resolution = levels.frames[k].tolist()
        bounds = BoundGrids.of_values(
            levels.values[k], (int(row0), int(col0)), resolution, c.branch_and_bound_depth
        )
        if self.finished:
            self._bounds = bounds
        return bounds

    @property
    def unpacked_nbytes(self) -> int:
        """Memory that `release` would free."""
        unpacked = 0 if self._unpacked is None else sum(value.nbytes for value in self._unpacked.values)
        return unpacked + (0 if self._bounds is None else self._bounds.nbytes)

    @property
    def nbytes(self) -> int:
        """Memory of its grids."""
        drawn = sum(level.grid.nbytes for level in self.pyramid.maps)
        return drawn + sum(level.nbytes for level in self._packed or ()) + self.unpacked_nbytes


class Submaps:
    """All submaps; the last two are being drawn."""

    def __init__(self, config: CartographerConfig, tracers: Tracers | None = None) -> None:
        """Start without any; `tracers` may be reused from submaps of the same levels."""
        self._config = config
        self._searched: OrderedDict[int, Submap] = OrderedDict()
        self._tracers = tracers or Tracers(config)
        self._last, self._distance = Pose2(), 0.0
        self.all: list[Submap] = []

    def empty_copy(self, config: CartographerConfig) -> Submaps:
        """Return an empty set with another configuration of the same levels."""
        return Submaps(config, self._tracers)

    @property
    def matching_submap(self) -> Submap:
        """The submap that scans are matched against."""
        return self.all[self.active[0]]

    @property
    def active(self) -> range:
        """Indices of the submaps that are being drawn, the older first."""
        first = len(self.all)
        while first > 0 and not self.all[first - 1].finished:
            first -= 1
        return range(first, len(self.all))

    def insert_range_data(
        self, node: int, pose: Pose2, scan: ScanPoints, min_slopes: ByteArray, wall_slope: int
    ) -> range:
        """Draw a scan at `pose`; return the indices of the submaps that it entered."""
        if not self.all or self._newest_full:
            self._begin(pose)
        self._distance += pose.distance(self._last)
        self._last = pose
        entered, traced = self.active, self._tracers.trace(scan)
        for i in entered:
            self.all[i].draw_range_data(node, scan, min_slopes, wall_slope, traced)
        if len(entered) > 1 and self._newest_full:
            self.all[entered[0]].finish()
        return entered

    def reserve(self, pose: Pose2, box: FloatArray) -> None:
        """Begin the first submap at `pose`, allocated for scans in a box (4,), meters."""
        self._begin(pose)
        self.all[0].reserve(box)

    def _begin(self, pose: Pose2) -> None:
        self.all.append(Submap(self._config, pose))
        self._last, self._distance = pose, 0.0

    @property
    def _newest_full(self) -> bool:
        """Whether the newest submap has enough scans or distance for the next to begin."""
        c = self._config
        return len(self.all[-1].nodes) >= c.num_range_data or self._distance >= c.submap_distance

    def note_search(self, index: int) -> None:
        """Record a search in a finished submap; release those searched longest ago."""
        self._searched[index] = self.all[index]
        self._searched.move_to_end(index)
        held = sum(submap.unpacked_nbytes for submap in self._searched.values())
        while held > self._config.max_unpacked_bytes and len(self._searched) > 1:
            _, oldest = self._searched.popitem(last=False)
            held -= oldest.unpacked_nbytes
            oldest.release()


ZLIB_LEVEL = 1
"""Level of zlib: a higher one gains little on layers like these."""


@dataclass(frozen=True, slots=True)
class PackedLevel:
    """One level, cropped to its known cells and a margin, compressed by zlib.

    It holds one bit a known cell, the (n,) uint32 numbers of the cells that are more likely occupied than
    not, their layer `value` where every hit is a wall, and their minimum slopes. The frame is lattice row and
    column of cell (0, 0), and the resolution in meters.
    """

    known: bytes
    hits: bytes
    value: bytes
    min_slope: bytes
    shape: tuple[int, int]
    frame: tuple[int, int, float]

    @staticmethod
    def of(level: OccupancyMap) -> PackedLevel:
        """Pack a level of a submap."""
        steps = level.layers.log_odds
        known = steps != UNKNOWN
        rows, cols = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        box = tuple(slice(max(0, k[0] - 1), k[-1] + 2) if len(k) else slice(0, 0) for k in (rows, cols))
        known, steps, min_slope = known[box], steps[box].reshape(-1), level.layers.min_slope[box].reshape(-1)
        hits = np.flatnonzero(steps > 0)
        frame = level.grid.row0 + box[0].start, level.grid.col0 + box[1].start, level.resolution
        return PackedLevel(
            _pack(np.packbits(known)),
            _pack(hits.astype(np.uint32)),
            _pack(VALUE[steps[hits] + np.int16(128)]),
            _pack(min_slope[hits]),
            known.shape,
            frame,
        )

    def unpack(self, wall_slope: int) -> ByteArray:
        """Return the layer `value` for matching; hits below `wall_slope` are no walls."""
        value: ByteArray = self._known() * FREE
        hits = _unpack(self.hits).view(np.uint32)
        walls = _unpack(self.min_slope) >= wall_slope
        value[hits] = np.where(walls, _unpack(self.value), np.uint8(UNSEEN))
        return value.reshape(self.shape)

    def known_cells(self) -> NDArray[np.int64]:
        """Return (n, 2) lattice columns and rows of the known cells."""
        cells: NDArray[np.int64] = np.argwhere(self._known().reshape(self.shape))[:, ::-1]
        cells += np.array((self.frame[1], self.frame[0]))
        return cells

    def _known(self) -> ByteArray:
        """Return (cells,) 1 for known cells."""
        return np.unpackbits(_unpack(self.known), count=math.prod(self.shape))

    @property
    def nbytes(self) -> int:
        """Memory of the packed layers."""
        return len(self.known) + len(self.hits) + len(self.value) + len(self.min_slope)


def _pack(layer: NDArray[Any]) -> bytes:
    return zlib.compress(layer.data, ZLIB_LEVEL)


def _unpack(packed: bytes) -> ByteArray:
    return np.frombuffer(zlib.decompress(packed), np.uint8)
