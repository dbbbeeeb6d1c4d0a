"""Wall surfaces as lines, fitted to end points.

Each cell has a line per viewing direction. Lines are more exact than the faces of cells.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from lirs_envs.lidar.noise import LidarNoise, draw_noise, measure
from lirs_envs.lidar.ray_casting import RayCaster
from lirs_wct.arrays import BoolArray, Float32Array, FloatArray, Int32Array, IntArray, njit
from lirs_wct.geometry import LaserScan, OccupancyGrid, Pose2, Trajectory
from lirs_wct.sources.laser_map import level_floor, walls_of
from slam_baselines.front_end import KnownPoseMapper

CELL = 0.05
"""Edge of a cell of the map and of the surfaces, meters."""
REACH = 6
"""Cells around a cell whose end points its line is fitted to."""
HALO = 2
"""Cells around an end point that have lines."""
SECTORS = 8
"""Viewing directions of a cell: the two sides of a thin wall have different lines."""
SIDE = math.cos(math.radians(80))
"""Cosine of the largest angle between the beams of a line and its viewing direction."""
FLATNESS = 0.35
"""Largest ratio of a line's thickness to its length, both standard deviations."""
POINTS, BLOCKS = 8, 2
"""Fewest end points of a line, and fewest blocks of the log that they come from."""
EDGE, PARALLEL = 0.03, math.cos(math.radians(10))
"""Largest distance of the neighbors' end points from a beam's line, meters, and least cosine between them."""
GRAZING = math.cos(math.radians(70))
"""Cosine of the largest incidence of a compared beam."""
TIGHT = 0.15
"""Width within which beams count as on a line, meters."""
HEIGHT = 0.5
"""Height of the rays above the floor, meters; walls are twice as high."""


@dataclass(frozen=True)
class LogScans:
    """Scans of a log as arrays.

    Attributes:
        ranges: (n, beams) meters; not finite where nothing was measured.
        angles: (beams,) angles of the beams about the laser's z, radians.
        poses: (n, 3) x, y, yaw of the laser in the map, meters and radians.
        block: (n,) block of the log, counted along the path.
        range_max: largest range of the laser, meters.
    """

    ranges: FloatArray
    angles: FloatArray
    poses: FloatArray
    block: IntArray
    range_max: float

    @property
    def even(self) -> BoolArray:
        """(n,) whether a scan is in an even block, which the map is made of."""
        even: BoolArray = self.block % 2 == 0
        return even

    @property
    def directions(self) -> FloatArray:
        """(n, beams, 2) unit vectors of the beams in the map."""
        angles = self.poses[:, 2:] + self.angles
        return np.stack((np.cos(angles), np.sin(angles)), axis=-1)


class Surfaces(NamedTuple):
    """Lines of the walls.

    Attributes:
        slot: (rows, cols) row of `lines` of a cell; -1 = none.
        lines: (slots, SECTORS, 4) unit normal x, y, offset from the cell's center along it, meters, and
            number of end points; 0 where no line can be fitted.
        low: (2,) corner of cell (0, 0), meters.
    """

    slot: Int32Array
    lines: Float32Array
    low: FloatArray


class Expected(NamedTuple):
    """Beams as the map lets expect them.

    Attributes:
        ranges: (n, beams) meters; inf where the map holds no wall.
        cosine: (n, beams) cosine of the incidence; 0 where no line is known.
        flat: (n, beams) whether a beam and both its neighbors meet one line of at least two blocks.
    """

    ranges: FloatArray
    cosine: FloatArray
    flat: BoolArray


def fit_surfaces(scans: LogScans) -> Surfaces:
    """Fit lines to the end points of the even blocks' scans."""
    use = np.isfinite(scans.ranges) & scans.even[:, None]
    n, _ = np.nonzero(use)
    view = scans.directions[use]
    points = scans.poses[n, :2] + scans.ranges[use][:, None] * view
    low = (np.floor(points.min(axis=0) / CELL) - REACH) * CELL
    cols, rows = (np.floor((points.max(axis=0) - low) / CELL).astype(int) + REACH + 1).tolist()
    cell = np.floor((points - low) / CELL).astype(np.int64)
    key = cell[:, 1] * cols + cell[:, 0]
    order = np.argsort(key, kind="stable")
    first = np.searchsorted(key[order], np.arange(rows * cols + 1))
    near = np.zeros((rows, cols), np.bool_)
    for down in range(-HALO, HALO + 1):
        for right in range(-HALO, HALO + 1):
            near[cell[:, 1] + down, cell[:, 0] + right] = True
    slot = np.full((rows, cols), -1, np.int32)
    slot[near] = np.arange(int(near.sum()), dtype=np.int32)
    lines = np.zeros((int(near.sum()), SECTORS, 4), np.float32)
    blocks = scans.block[n][order]
    _fit_lines(points[order] - low, view[order], blocks, first, slot, lines)
    return Surfaces(slot, lines, low)


@njit
def _fit_lines(points: Any, view: Any, block: Any, first: Any, slot: Any, lines: Any) -> None:
    """Fill the lines of all slots.

    Points (n, 2) are sorted by cell, in meters from the corner.
    """
    rows, cols = slot.shape
    near = np.empty(len(points), np.int64)
    for r in range(REACH, rows - REACH):
        for c in range(REACH, cols - REACH):
            if slot[r, c] < 0:
                continue
            x, y = (c + 0.5) * CELL, (r + 0.5) * CELL
            count = 0
            for row in range(r - REACH, r + REACH + 1):
                for i in range(first[row * cols + c - REACH], first[row * cols + c + REACH + 1]):
                    if (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2 < (REACH * CELL) ** 2:
                        near[count] = i
                        count += 1
            if count >= POINTS:
                for sector in range(SECTORS):
                    _fit_line(points, view, block, near[:count], sector, x, y, lines[slot[r, c], sector])


@njit
def _fit_line(
    points: Any, view: Any, block: Any, near: Any, sector: int, x: float, y: float, line: Any
) -> None:
    """Fill one line by principal components, a second time without points off the first line."""
    angle = sector * 2 * np.pi / SECTORS
    ux, uy = np.cos(angle), np.sin(angle)
    nx = ny = offset = 0.0
    limit = 1e9
    for attempt in range(2):
        count = blocks = 0
        last = -1
        sx = sy = sxx = sxy = syy = 0.0
        for i in near:
            if view[i, 0] * ux + view[i, 1] * uy < SIDE:
                continue
            px, py = points[i, 0] - x, points[i, 1] - y
            if attempt > 0 and abs(nx * px + ny * py - offset) > limit:
                continue
            count += 1
            if block[i] != last:
                blocks += last >= 0
                last = block[i]
            sx, sy = sx + px, sy + py
            sxx, sxy, syy = sxx + px * px, sxy + px * py, syy + py * py
        if count < POINTS or blocks < BLOCKS - 1:
            return
        mx, my = sx / count, sy / count
        a, b, c = sxx / count - mx * mx, sxy / count - mx * my, syy / count - my * my
        middle, radius = (a + c) / 2, np.hypot((a - c) / 2, b)
        thin, long = max(middle - radius, 0.0), middle + radius
        if thin > FLATNESS**2 * long:
            return
        tangent = np.arctan2(2 * b, a - c) / 2
        nx, ny = -np.sin(tangent), np.cos(tangent)
        offset = nx * mx + ny * my
        limit = 3 * np.sqrt(thin) + 1e-4
    line[0], line[1], line[2], line[3] = nx, ny, offset, count


@njit(inline="always")
def _line_at(surfaces: Any, x: float, y: float, dx: float, dy: float) -> Any:
    """Return the line of a cell by viewing direction: normal, distance from the origin, points."""
    slot, lines, low = surfaces
    c, r = int(np.floor((x - low[0]) / CELL)), int(np.floor((y - low[1]) / CELL))
    if not (0 <= r < slot.shape[0] and 0 <= c < slot.shape[1]) or slot[r, c] < 0:
        return 0.0, 0.0, 0.0, 0.0
    sector = int(np.floor(np.arctan2(dy, dx) * SECTORS / (2 * np.pi) + 0.5)) % SECTORS
    line = lines[slot[r, c], sector]
    nx, ny = np.float64(line[0]), np.float64(line[1])
    center = nx * (low[0] + (c + 0.5) * CELL) + ny * (low[1] + (r + 0.5) * CELL)
    return nx, ny, np.float64(line[2]) + center, np.float64(line[3])


@njit
def align(surfaces: Any, ranges: Any, angles: Any, start: Any, width: float, poses: Any, share: Any) -> None:
    """Fill `poses` (n, 3) with the scans' poses by point-to-line matching.

    Args:
        surfaces: Lines of the map.
        ranges: (n, beams) meters.
        angles: (beams,) radians.
        start: (n, 3) first poses.
        width: distance from a line at which a beam has half its weight, meters.
        poses: (n, 3) to be filled.
        share: (n,) to be filled: share of the beams with a return that lie within `TIGHT` of a line.
    """
    for k in range(len(ranges)):
        pose = start[k].copy()
        for _ in range(20):
            H, g = np.zeros((3, 3)), np.zeros(3)
            hits = inside = 0
            for b in range(len(angles)):
                if not np.isfinite(ranges[k, b]):
                    continue
                hits += 1
                dx, dy = np.cos(pose[2] + angles[b]), np.sin(pose[2] + angles[b])
                lx, ly = ranges[k, b] * dx, ranges[k, b] * dy
                nx, ny, distance, count = _line_at(surfaces, pose[0] + lx, pose[1] + ly, dx, dy)
                if count == 0:
                    continue
                e = nx * (pose[0] + lx) + ny * (pose[1] + ly) - distance
                inside += abs(e) < TIGHT
                w = 1 / (1 + (e / width) ** 2) ** 2
                J = np.array((nx, ny, ny * lx - nx * ly))
                for i in range(3):
                    g[i] += w * J[i] * e
                    for j in range(3):
                        H[i, j] += w * J[i] * J[j]
            share[k] = inside / max(hits, 1)
            for i in range(3):
                H[i, i] += 0.1
            step = np.linalg.solve(H, g)
            pose -= step
            if np.hypot(step[0], step[1]) < 1e-5 and abs(step[2]) < 1e-5:
                break
        poses[k] = pose


def map_of(scans: LogScans) -> OccupancyGrid:
    """Return the occupancy map of the even blocks' scans at their poses."""
    mapper = KnownPoseMapper(resolution=CELL)
    step = float(scans.angles[1] - scans.angles[0])
    for k in np.flatnonzero(scans.even).tolist():
        ranges = scans.ranges[k].astype(np.float32)
        scan = LaserScan(ranges, float(scans.angles[0]), step, 0.0, scans.range_max, float(k))
        mapper.update(scan, Pose2(*scans.poses[k].tolist()), None)
    return mapper.map()


def expected_beams(grid: OccupancyGrid, surfaces: Surfaces, scans: LogScans) -> Expected:
    """Cast all beams against the map's walls; a wall's surface is its cell's line."""
    walls = walls_of(grid, 2 * HEIGHT)
    n, beams = scans.ranges.shape
    directions = scans.directions
    rays = np.concatenate((directions, np.zeros((n, beams, 1))), axis=-1).reshape(-1, 3)
    origins = np.column_stack((scans.poses[:, :2], np.full(n, HEIGHT))).repeat(beams, axis=0)
    ranges = RayCaster(level_floor(walls), walls).ranges(origins, rays, scans.range_max).reshape(n, beams)
    cosine, flat = np.zeros((n, beams)), np.zeros((n, beams), np.bool_)
    _meet_lines(surfaces, scans.poses, directions, ranges, cosine, flat)
    return Expected(ranges, cosine, flat)


@njit
def _meet_lines(surfaces: Any, poses: Any, directions: Any, ranges: Any, cosine: Any, flat: Any) -> None:
    """Move ranges (n, beams) from the cells' faces to their lines; fill `cosine` and `flat`."""
    for k in range(len(ranges)):
        x, y = poses[k, 0], poses[k, 1]
        lines = np.zeros((ranges.shape[1], 3))
        for b in range(ranges.shape[1]):
            face = ranges[k, b] + 1e-6
            if not np.isfinite(face):
                continue
            dx, dy = directions[k, b]
            nx, ny, distance, count = _line_at(surfaces, x + face * dx, y + face * dy, dx, dy)
            c = nx * dx + ny * dy
            met = (distance - nx * x - ny * y) / c if count > 0 and abs(c) >= GRAZING / 2 else np.inf
            if abs(met - face) * abs(c) < 2 * CELL:
                ranges[k, b], cosine[k, b] = met, abs(c)
                lines[b] = nx, ny, distance
            else:
                # A wall without a line lies in the middle of its cell.
                ranges[k, b] += CELL / 2
        for b in range(1, ranges.shape[1] - 1):
            flat[k, b] = cosine[k, b] >= GRAZING
            for other in (b - 1, b + 1):
                px = x + ranges[k, other] * directions[k, other, 0]
                py = y + ranges[k, other] * directions[k, other, 1]
                off = abs(lines[b, 0] * px + lines[b, 1] * py - lines[b, 2])
                parallel = abs(lines[b, 0] * lines[other, 0] + lines[b, 1] * lines[other, 1]) > PARALLEL
                flat[k, b] &= cosine[k, other] > 0 and off < EDGE and parallel


BLOCK = 2.5
"""Length of a block along the path, meters."""
REFINEMENTS = (0.15, 0.08, 0.05)
"""Widths of the matching of the even blocks' scans to their own surfaces, meters."""
WIDTH = 0.05
"""Width of the matching of the odd blocks' scans, meters."""
GATE = 0.25
"""Largest residual that counts as noise; beyond it a beam met something else, meters."""
LOCALIZED = 1 / 3
"""Smallest share of a scan's beams on the map's lines; others are not compared."""
CLUSTER = 3
"""Fewest neighboring beams of an object that the map lacks."""


@dataclass(frozen=True)
class LogComparison:
    """Beams of the odd blocks against the map of the even ones.

    Attributes:
        scans: all scans at their matched poses.
        beams: expected beams of all scans.
        used: (n,) scans that are compared: in odd blocks, and localized.
        compared: (n, beams) beams that are compared.
        residual: (n, beams) measured less expected range, meters; not finite where nothing was measured.
    """

    scans: LogScans
    beams: Expected
    used: BoolArray
    compared: BoolArray
    residual: FloatArray

    def residuals(self) -> tuple[FloatArray, FloatArray, IntArray]:
        """Return residual, expected range and block of the noise's beams, (m,)."""
        some = self.compared & (np.abs(self.residual) <= GATE)
        rows, _ = np.nonzero(some)
        return self.residual[some], self.beams.ranges[some], self.scans.block[rows]


def compare(scans: LogScans) -> LogComparison:
    """Map the even blocks, localize the odd ones there, and compare their beams."""
    even = scans.even
    poses, share = scans.poses.copy(), np.zeros(len(scans.poses))
    for width in REFINEMENTS:
        surfaces = fit_surfaces(replace(scans, poses=poses))
        moved = np.empty_like(poses[even])
        align(surfaces, scans.ranges[even], scans.angles, poses[even], width, moved, np.empty(len(moved)))
        poses[even] = moved
    placed = replace(scans, poses=poses)
    surfaces = fit_surfaces(placed)
    for width in (*REFINEMENTS[:-1], WIDTH):
        moved, found = np.empty_like(poses[~even]), np.empty(int((~even).sum()))
        align(surfaces, scans.ranges[~even], scans.angles, poses[~even], width, moved, found)
        poses[~even], share[~even] = moved, found
    used = ~even & (share >= LOCALIZED)
    poses[~even & ~used] = scans.poses[~even & ~used]  # the mapper's, rather than a wrong match
    placed = replace(scans, poses=poses)
    beams = expected_beams(map_of(placed), surfaces, placed)
    with np.errstate(invalid="ignore"):
        residual = scans.ranges - beams.ranges
    return LogComparison(placed, beams, used, beams.flat & used[:, None], residual)


def simulate_scans(real: LogComparison, start: FloatArray, noise: LidarNoise, seed: int) -> LogScans:
    """Return the scans that a lidar with `noise` measures at the matched poses.

    Their matching begins at the log's first poses (n, 3).
    """
    drawn = noisy_ranges(real.beams.ranges, real.scans.range_max, noise, seed)
    return replace(real.scans, ranges=drawn.astype(np.float64), poses=start)


def noisy_ranges(exact: FloatArray, range_max: float, noise: LidarNoise, seed: int) -> Float32Array:
    """Return exact ranges (n, beams) as a lidar measures them, meters; inf = no wall."""
    rng = np.random.default_rng(seed)
    ranges = np.empty(exact.shape, np.float32)
    for k, row in enumerate(exact):
        measure(row, *draw_noise(noise, len(row), rng), (0.0, range_max), noise.parameters, ranges[k])
    return ranges


def blocks_of(poses: FloatArray) -> IntArray:
    """Return (n,) the block of each pose (n, 3) along the path."""
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    along = np.concatenate(([0.0], np.cumsum(steps)))
    blocks: IntArray = np.floor(along / BLOCK).astype(np.int64)
    return blocks


def scan_arrays(scans: Sequence[LaserScan], trajectory: Trajectory) -> LogScans:
    """Return scans of one laser as arrays, at the mapper's poses."""
    stamps = np.array([scan.stamp for scan in scans])
    x, y, yaw = trajectory.planar_at(stamps).T
    base = Trajectory.from_poses(stamps, map(Pose2, x.tolist(), y.tolist(), yaw.tolist()))
    poses = laser_poses(base, scans)
    ranges = np.stack([np.where(scan.hits, scan.ranges.astype(np.float64), np.inf) for scan in scans])
    reach = max(scan.limits[1] for scan in scans)
    return LogScans(ranges, scans[0].angles, poses, blocks_of(poses), reach)


def laser_poses(base: Trajectory, scans: Sequence[LaserScan]) -> FloatArray:
    """Return (n, 3) planar poses of the laser from those of the base."""
    mounts = (Pose2(s.T_base_laser.x, s.T_base_laser.y, s.T_base_laser.yaw) for s in scans)
    return np.array([(base.pose2(k) @ mount).as_array() for k, mount in enumerate(mounts)])
