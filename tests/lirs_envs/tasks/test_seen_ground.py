"""Seen ground: against beams that are followed centimeter by centimeter."""

import math

import numpy as np
import pytest

from lirs_envs.lidar.ray_casting import RayCaster
from lirs_envs.robots.robot import make_robot
from lirs_envs.tasks.seen_ground import SeenGround
from lirs_envs.tasks.site import SEEN_CELL, make_site, seen_frame
from lirs_wct.geometry.pose import Pose3
from lirs_wct.world import World


def stepped(world: World, T: Pose3, beams: np.ndarray, ranges: np.ndarray, reach: float) -> np.ndarray:
    """Cells that a point on a beam is in while it is low enough, in steps of 2 mm; the clear cases only."""
    frame = seen_frame(world)
    seen = np.zeros(frame.height.shape, np.int64)
    for beam, r in zip(beams @ T.rotation.T, ranges, strict=True):
        t = np.arange(0.0, r, 0.002)[:, None]
        points = T.position + t * beam
        cells = np.floor((points[:, :2] - frame.corner) / SEEN_CELL).astype(int)
        inside = ((cells >= 0) & (cells < seen.shape[::-1])).all(axis=1)
        for i, j in np.unique(cells[inside], axis=0):
            here = inside & (cells[:, 0] == i) & (cells[:, 1] == j)
            z = points[here, 2]
            low = z.mean() - frame.height[j, i] <= reach
            # At a corner, and at the limit's height, either answer is right.
            clear = here.sum() > 3 and abs(z.mean() - frame.height[j, i] - reach) > 0.02
            seen[j, i] = 1 if low and clear else max(seen[j, i], 0 if clear else -1, key=abs)
    return seen


def see(ground: SeenGround, ranges: np.ndarray, range_max: float, T: Pose3) -> None:
    row = np.array([[T.x, T.y, T.z, T.qw, T.qx, T.qy, T.qz]])
    ground.add(np.array((0,)), ranges[None], range_max, row)


@pytest.mark.parametrize("reach", [1.0, 3.0])
def test_against_beams_followed_in_small_steps(rough: World, reach: float) -> None:
    rng = np.random.default_rng(2)
    angle = rng.uniform(-math.pi, math.pi, 40)
    beams = np.stack((np.cos(angle), np.sin(angle), np.zeros(40)), axis=1)
    frame = seen_frame(rough)
    ground = SeenGround(1, frame.height.shape, beams, np.zeros(3), reach)
    ground.begin(0, frame, np.isfinite(frame.height))
    expected = np.zeros(frame.height.shape, np.int64)
    for x, y, roll, pitch in rng.uniform((-6, -6, -0.2, -0.2), (6, 6, 0.2, 0.2), (4, 4)):
        T = Pose3.from_rpy(x, y, float(rough.surface.height_at(x, y)) + 0.4, roll, pitch, x)
        ranges = RayCaster(rough.surface).cast(T.position, beams @ T.rotation.T, 12.0)
        one = stepped(rough, T, beams, np.minimum(ranges, 12.0), reach)
        expected = np.where(one == 0, expected, np.where(expected == 1, 1, one))
        measured = np.where(np.isinf(ranges), np.inf, ranges).astype(np.float32)
        before = ground.cells[0]
        see(ground, measured, 12.0, T)
        again = ground.cells[0]
        see(ground, measured, 12.0, T)
        assert ground.cells[0] == again > before
    seen = ground.seen(0)
    assert seen[expected == 1].all()
    # Corners cut (by less than 2 mm not even noticed) and limits touched are few, and nothing else is seen.
    assert (seen & (expected == 0)).sum() < 0.01 * (expected == 1).sum()
    assert (expected == -1).sum() < 0.15 * (expected == 1).sum()
    assert ground.cells[0] == ground.wanted_cells[0] == seen.sum()


def test_beams_that_are_lost_or_too_near_see_nothing(plane: World) -> None:
    beams = np.array(((1.0, 0, 0), (0, 1.0, 0), (-1.0, 0, 0), (0, -1.0, 0)))
    frame = seen_frame(plane)
    ground = SeenGround(1, frame.height.shape, beams, np.array((0.0, 0.0, 0.2)), 1.0)
    ground.begin(0, frame, np.zeros(frame.height.shape, np.bool_))
    see(ground, np.array((np.nan, -np.inf, np.inf, 2.1), np.float32), 3.0, Pose3(0.1, 0.1, 0.0))
    rows, cols = np.nonzero(ground.seen(0))
    # West 3 m: from cell 40 down to 28; south 2.1 m: rows 40 down to 32.
    assert sorted(set(cols)) == list(range(28, 41))
    assert sorted(set(rows)) == list(range(32, 41))
    assert ground.cells[0] == 13 + 9 - 1
    assert ground.wanted_cells[0] == 0


def test_local_map_turns_with_the_robot(plane: World) -> None:
    beams = np.array(((1.0, 0.0, 0.0),))
    frame = seen_frame(plane)
    for yaw in (0.0, math.pi / 2, 2.5):
        ground = SeenGround(1, frame.height.shape, beams, np.zeros(3), 1.0)
        ground.begin(0, frame, np.isfinite(frame.height))
        see(ground, np.array((5.0,), np.float32), 20.0, Pose3.from_rpy(0.0, 0.0, 0.2, 0.0, 0.0, yaw))
        out = np.zeros((64, 64), np.uint8)
        ground.local_map(0, 0.0, 0.0, yaw, out)
        rows, cols = np.nonzero(out)
        assert 11 <= rows.min() <= 12
        assert rows.max() <= 33
        assert set(cols.tolist()) <= {30, 31, 32, 33}


def test_walls_and_unknown_cells_are_no_ground(walled: World) -> None:
    frame = seen_frame(walled)
    site = make_site(walled, make_robot("husky"))
    x, y = walled.walls.origin.apply((161 * 0.05, 5.0)).tolist()
    assert site.area(x, y) == 0
    # The wall is thinner than a cell: of those in line with it, some have their middle in it.
    along = walled.walls.origin.apply(np.stack((np.full(400, 8.05), np.linspace(0, 10, 400)), axis=1))
    cells = np.floor((along - frame.corner) / SEEN_CELL).astype(int)
    assert 0.2 < np.isinf(frame.height[cells[:, 1], cells[:, 0]]).mean() < 1.0
    wanted = site.reachable(site.largest)
    assert 0 < wanted.sum() < np.isfinite(frame.height).sum()
    for seed in range(20):
        start = site.draw_start(np.random.default_rng(seed))
        assert site.area(start.x, start.y) == site.largest
