"""Polygons of any shape become triangles of their area, with their edges."""

from collections import Counter

import numpy as np
from hypothesis import given, strategies as st

from lirs_wct.formats.meshes import cut_polygons


def star(rng: np.random.Generator, n: int, low: float, high: float) -> np.ndarray:
    """Return a polygon around the origin with corners on straight edges."""
    angle, radius = (np.arange(n) + rng.uniform(0, 0.8, n)) * 2 * np.pi / n, rng.uniform(low, high, n)
    corners = np.column_stack((np.cos(angle), np.sin(angle))) * radius[:, None]
    parts = [
        a + (b - a) * np.linspace(0, 1, rng.integers(1, 4), endpoint=False)[:, None]
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
    ]
    return np.concatenate(parts)


def newell(ring: np.ndarray) -> float:
    x, y = ring.T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


def area_of(points: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2


@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.booleans())
def test_a_concave_polygon_with_a_hole_keeps_its_area_and_edges(seed: int, far: int, hole: bool) -> None:
    rng = np.random.default_rng(seed)
    rings = [star(rng, int(rng.integers(6, 14)), 5, 12)]
    rings += [star(rng, int(rng.integers(3, 9)), 0.2, 1)[:: int(rng.choice((-1, 1)))]] if hole else []
    ends = np.cumsum([len(ring) for ring in rings]).tolist()
    plane, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    points = np.concatenate(rings) @ plane[:2] + rng.uniform(-1, 1, 3) * 10**far
    triangles = cut_polygons(
        points, np.arange(len(points)), np.array([len(points)]), {0: ends} if hole else None
    )
    area = newell(rings[0]) - sum(map(newell, rings[1:]))
    assert np.isclose(area_of(points, triangles), area, rtol=1e-6)
    edges = Counter((int(t[k]), int(t[k - 2])) for t in triangles for k in range(3))
    assert max(edges.values()) == 1
    border = {frozenset(edge) for edge in edges if edge[::-1] not in edges}
    spans = zip([0, *ends], ends, strict=False)
    assert border == {frozenset((i, i + 1 if i + 1 < b else a)) for a, b in spans for i in range(a, b)}


@given(st.lists(st.integers(3, 9), min_size=1, max_size=8), st.integers(0, 2**32 - 1))
def test_convex_polygons_stay_fans(counts: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = np.concatenate([np.sort(rng.permutation(24)[:n]) * np.pi / 12 for n in counts])
    points = np.column_stack(
        (np.cos(angles), np.sin(angles), np.repeat(rng.uniform(-9, 9, len(counts)), counts))
    )
    triangles = cut_polygons(points, np.arange(len(points)), np.array(counts))
    starts = np.cumsum(counts) - counts
    fans = [(a, a + k, a + k + 1) for a, n in zip(starts, counts, strict=True) for k in range(1, n - 1)]
    assert triangles.tolist() == [list(map(int, fan)) for fan in fans]


def test_a_slit_to_a_hole_is_no_part_of_the_border_of_the_hole() -> None:
    """Programs without holes write the outline, go over to the hole, and back on the same edge."""
    outline, hole = [(0, 0), (4, 0), (4, 3), (0, 3)], [(1, 1), (1, 2), (2, 2), (2, 1)]
    ring = [*outline, outline[0], *hole, hole[0]]
    points = np.array([(x, 5.0, y) for x, y in ring])
    triangles = cut_polygons(points, np.arange(10), np.array([10]))
    assert np.isclose(area_of(points, triangles), 11)
