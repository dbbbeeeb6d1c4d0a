"""Our traversal against every triangle by brute force, in all the awkward directions."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lirs_envs.lidar.ray_casting import RayCaster
from lirs_wct.geometry import HeightField, WallGrid
from lirs_wct.geometry.pose import Pose2
from tests.reference.triangle_rays import triangle_ranges, triangles_of, wall_ranges

Array = NDArray[np.float64]
Rays = tuple[Array, Array]
EDGE = 1e-9
"""Barycentric width of an edge: a hit within it is a matter of rounding, and either answer is right."""


def rough(rows: int, cols: int, cell: tuple[float, float], seed: int) -> HeightField:
    rng = np.random.default_rng(seed)
    z = rng.uniform(0.0, 1.0, (rows, cols)) + 0.5 * np.sin(np.arange(cols) / 3.0)
    return HeightField(z.astype(np.float32), cell, (-1.7, 2.3))


FIELDS = {
    "cells longer than wide": rough(11, 15, (0.37, 0.21), 1),
    "odd and square": rough(23, 18, (0.25, 0.25), 2),
    "a row of cells": rough(2, 33, (0.1, 0.6), 3),
    "one cell": rough(2, 2, (1.0, 2.0), 4),
    (LARGEST := "more levels than the start"): rough(30, 151, (0.1, 0.15), 5),
}


def unit(d: Array) -> Array:
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def inside(surface: HeightField, n: int, rng: np.random.Generator) -> Array:
    west, south, east, north = surface.bounds
    return np.stack((rng.uniform(west, east, n), rng.uniform(south, north, n)), axis=1)


def nodes(surface: HeightField, n: int, rng: np.random.Generator) -> Array:
    rows, cols = surface.shape
    r, c = rng.integers(0, rows, n), rng.integers(0, cols, n)
    x = surface.origin[0] + surface.cell[0] * c
    y = surface.origin[1] + surface.cell[1] * (rows - 1 - r)
    return np.stack((x, y, surface.z[r, c].astype(np.float64)), axis=1)


def raised(surface: HeightField, xy: Array, gap: Array | float) -> Array:
    return np.column_stack((xy, surface.height_at(xy[:, 0], xy[:, 1]) + gap))


def general(s: HeightField, n: int, rng: np.random.Generator) -> Rays:
    return raised(s, inside(s, n, rng), rng.uniform(0.01, 1.0, n)), unit(rng.standard_normal((n, 3)))


def vertical(s: HeightField, n: int, rng: np.random.Generator) -> Rays:
    xy = np.where(rng.random((n, 1)) < 0.5, inside(s, n, rng), nodes(s, n, rng)[:, :2])
    up = rng.choice((-1.0, 1.0), n)
    return raised(s, xy, rng.uniform(-5, 5, n)), np.column_stack((np.zeros((n, 2)), up))


def along_axes(s: HeightField, n: int, rng: np.random.Generator) -> Rays:
    d = np.zeros((n, 3))
    d[np.arange(n), rng.integers(0, 2, n)] = rng.choice((-1.0, 1.0), n)
    d[:, 2] = rng.choice((0.0, -0.05), n)
    start = nodes(s, n, rng) + np.array((0.0, 0.0, 0.1))
    return np.where(rng.random((n, 1)) < 0.5, start, general(s, n, rng)[0]), unit(d)


def along_diagonals(s: HeightField, n: int, rng: np.random.Generator) -> Rays:
    sign = rng.choice((-1.0, 1.0), n)
    across = rng.choice((-1.0, 1.0), n)
    d = np.stack((sign * s.cell[0], sign * across * s.cell[1], rng.uniform(-0.2, 0.0, n)), axis=1)
    return nodes(s, n, rng) + np.array((0.0, 0.0, 0.15)), unit(d)


def through_nodes(s: HeightField, n: int, rng: np.random.Generator) -> Rays:
    start = general(s, n, rng)[0]
    return start, unit(nodes(s, n, rng) - start)


def grazing(s: HeightField, n: int, rng: np.random.Generator) -> Rays:
    xy = inside(s, n, rng)
    step = 1e-4 * rng.standard_normal((n, 2))
    dz = s.height_at(*(xy + step).T) - s.height_at(*xy.T)
    # Not within 1e-8 of the tangent: there 1e-6 m along the ray are less than rounding across it.
    lean = rng.choice((-1.0, 1.0), n) * 10.0 ** rng.uniform(-8, -2, n) * np.linalg.norm(step, axis=1)
    d = np.column_stack((step, np.where(np.isfinite(dz), dz, 0.0) + lean))
    return raised(s, xy, 10.0 ** rng.uniform(-6, -2, n)), unit(d)


def from_outside(s: HeightField, n: int, rng: np.random.Generator) -> Rays:
    away = unit(rng.standard_normal((n, 3)))
    target = raised(s, inside(s, n, rng), rng.uniform(-0.3, 0.3, n))
    return target + 10.0 * away, -away


def from_below(s: HeightField, n: int, rng: np.random.Generator) -> Rays:
    d = rng.standard_normal((n, 3)) * (1.0, 1.0, 0.4)
    return raised(s, inside(s, n, rng), -rng.uniform(0.001, 2.0, n)), unit(d)


KINDS = (
    general, vertical, along_axes, along_diagonals, through_nodes, grazing, from_outside, from_below,
)  # fmt: skip


def agree(ours: Array, either: Array, other: Array) -> NDArray[np.bool_]:
    with np.errstate(invalid="ignore"):
        return (ours == either) | (ours == other) | (abs(ours - either) < 1e-6) | (abs(ours - other) < 1e-6)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name == LARGEST else name for name in FIELDS]
)
def test_equals_brute_force(name: str, kind) -> None:
    """5 x 8 x 320 = 12,800 rays."""
    surface = FIELDS[name]
    caster = RayCaster(surface)
    origins, directions = kind(surface, 320, np.random.default_rng(7))
    ours = np.concatenate([caster.cast(o, d[None]) for o, d in zip(origins, directions, strict=True)])
    more, less = (
        triangle_ranges(triangles_of(surface), origins, directions, grow=grow) for grow in (EDGE, -EDGE)
    )
    assert not np.isnan(ours).any()
    assert np.isfinite(ours).any()
    wrong = ~agree(ours, more, less)
    assert not wrong.any(), (
        f"{wrong.sum()} rays, the first from {origins[wrong][0]} along {directions[wrong][0]}: "
        f"{ours[wrong][0]} instead of {more[wrong][0]} (edges wide) or {less[wrong][0]} (edges narrow)"
    )


def test_most_rays_are_not_a_matter_of_rounding() -> None:
    """Else the test above would accept anything."""
    surface = FIELDS["odd and square"]
    triangles = triangles_of(surface)
    for kind in (general, from_outside, from_below):
        rays = kind(surface, 320, np.random.default_rng(7))
        more, less = (triangle_ranges(triangles, *rays, grow=grow) for grow in (EDGE, -EDGE))
        assert (more == less).mean() > 0.99


def test_respects_the_largest_range() -> None:
    surface = FIELDS["odd and square"]
    origins, directions = general(surface, 200, np.random.default_rng(3))
    caster = RayCaster(surface)
    for o, d in zip(origins, directions, strict=True):
        full = caster.cast(o, d[None])[0]
        cut = caster.cast(o, d[None], 0.4)[0]
        assert cut == full if full <= 0.4 else cut == np.inf


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_walls_equal_brute_force(yaw: float) -> None:
    rng = np.random.default_rng(5)
    walls = WallGrid(rng.random((40, 31)) < 0.06, 0.05, Pose2(1.0, -2.0, yaw), 0.8)
    floor = HeightField(np.full((2, 2), -50.0, np.float32), (100.0, 100.0), (-50.0, -50.0))
    caster = RayCaster(floor, walls)
    local = rng.uniform((-1.0, -1.0), (2.5, 3.0), (1500, 2))
    origins = np.column_stack((walls.origin.apply(local), rng.uniform(-0.5, 1.2, 1500)))
    directions = rng.standard_normal((1500, 3)) * (1.0, 1.0, 0.2)
    directions[:500, 2] = 0.0
    directions[500:600] = rng.choice((-1.0, 1.0), (100, 1)) * (np.cos(yaw), np.sin(yaw), 0.0)
    directions[600:700] = (0.0, 0.0, -1.0)
    directions = unit(directions)
    ours = np.concatenate([caster.cast(o, d[None], 20.0) for o, d in zip(origins, directions, strict=True)])
    more, less = (wall_ranges(walls, origins, directions, grow=grow) for grow in (1e-9, -1e-9))
    assert agree(ours, more, less).all()
    assert 0.1 < np.isfinite(ours).mean() < 0.95
    assert (ours == 0.0).any(), "some rays start within a wall"


def test_nearer_of_terrain_and_walls() -> None:
    rng = np.random.default_rng(6)
    surface = HeightField(rng.uniform(0, 0.5, (41, 41)).astype(np.float32), (0.1, 0.1), (0.0, 0.0))
    walls = WallGrid(rng.random((40, 40)) < 0.02, 0.1, Pose2(), 0.7)
    both, ground = RayCaster(surface, walls), RayCaster(surface)
    o = np.array((2.02, 2.03, 0.55))
    d = unit(rng.standard_normal((2000, 3)) * (1.0, 1.0, 0.1))
    expected = np.minimum(ground.cast(o, d), wall_ranges(walls, np.tile(o, (2000, 1)), d))
    np.testing.assert_allclose(both.cast(o, d), expected, atol=1e-9)
    assert (both.cast(o, d) < ground.cast(o, d)).any()
