"""Hits are interpolated along walls, and nowhere else."""

import math

import numpy as np

from slam_baselines.leveling import ScanPoints, interpolate_hits, voxel_filter

SPACING = 0.05


def interpolated(hits, slopes=None):
    hits = np.array([(*hit, 0.5)[:3] for hit in hits], dtype=np.float64).reshape(-1, 3)
    slopes = np.zeros(len(hits), np.uint8) if slopes is None else np.array(slopes, np.uint8)
    scan = ScanPoints(np.zeros(3), hits, np.empty((0, 3)))
    out, found = interpolate_hits(scan, slopes, SPACING)
    return out.hits, found


def wall(angles, x=8.0):
    """Hits of beams on a wall across, at x."""
    return [(x, x * math.tan(a)) for a in np.radians(angles)]


def test_a_wall_has_no_gaps_left():
    hits, slopes = interpolated(wall(range(-20, 21)), slopes=range(41))
    assert len(hits) == len(slopes) > 100
    assert np.allclose(hits[:, 0], 8.0)
    assert (np.diff(hits[:, 1]) > 0).all()
    assert np.diff(hits[:, 1]).max() <= SPACING + 1e-9
    assert (np.diff(slopes.astype(int)) >= 0).all(), "between two hits the smaller of their slopes"


def test_no_wall_is_drawn_across_a_doorway_a_step_or_between_two_things():
    doorway = wall(range(-20, -8)) + wall(range(8, 21))
    hits, _ = interpolated(doorway)
    assert not (abs(hits[:, 1]) < 1.0).any()
    near_and_far = [(8.0, y) for y in (-0.4, -0.2, 0.0)] + [(8.7, y) for y in (0.1, 0.3, 0.5)]
    hits, _ = interpolated(near_and_far)
    assert not ((hits[:, 0] > 8.01) & (hits[:, 0] < 8.69)).any()
    trees = [(8.0, 0.0), (8.6, 0.5), (8.0, 1.0), (8.6, 1.5)]
    assert len(interpolated(trees)[0]) == 4


def test_few_hits_are_no_surface():
    assert len(interpolated([])[0]) == 0
    assert len(interpolated(wall((0, 1)))[0]) == 2


def test_the_voxel_filter_keeps_one_point_a_square() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (500, 3))
    thin = voxel_filter(points, 0.5, 1000)
    cells = {tuple(c) for c in np.floor(thin[:, :2] / 0.5).astype(int).tolist()}
    assert len(thin) == len(cells) == 16
    assert len(voxel_filter(points, 0.05, 40)) <= 40
