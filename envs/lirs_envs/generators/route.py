"""Routes across a course from west to east: along gentle ground, and through a maze."""

from __future__ import annotations

import cv2
import numpy as np

from lirs_envs.generators.natural import NODES
from lirs_wct.arrays import BoolArray, Float32Array, FloatArray

CELL = 0.1
"""Spacing of a course's nodes, meters."""
HALF = CELL * (NODES - 1) / 2
"""Half the side of a course, meters."""
ENDS = 10.8
"""Distance of start and goal west and east of the center, meters."""
LEG = 4.32
"""Distance along x between two bends of a route, meters."""
STEEPEST = 1.4
"""Largest slope of a route between two bends, meters north or south per meter east."""
WALL_HEIGHT = 1.0
"""Meters; above the lidar of every ground robot."""
WALL_NODES = 3
"""Nodes across a wall."""
POINTS = 10
"""Points of the route from one room to the next."""
STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0))
"""Row and column from a room to its neighbors."""
Room = tuple[int, int]
"""Row (0 = north) and column of a room."""


def winding_route(rng: np.random.Generator, sway: float) -> FloatArray:
    """Return (n, 2) x, y of a smooth way from west to east, meters.

    Args:
        rng: random generator of its bends.
        sway: most that it is north or south of the middle line, meters.
    """
    x = np.linspace(-ENDS, ENDS, round(2 * ENDS / LEG) + 1)
    y = rng.uniform(-sway, sway, len(x))
    for k in range(1, len(x)):
        y[k] = y[k - 1] + np.clip(y[k] - y[k - 1], -STEEPEST * LEG, STEEPEST * LEG)
    fine = np.linspace(0, len(x) - 1, 20 * (len(x) - 1) + 1)
    leg = np.minimum(fine.astype(np.int64), len(x) - 2)
    blend = (1 - np.cos(np.pi * (fine - leg))) / 2
    return np.column_stack((np.interp(fine, np.arange(len(x)), x), y[leg] + blend * (y[leg + 1] - y[leg])))


def distance_to_route(route: FloatArray) -> Float32Array:
    """Return (n, n) distances in meters from course nodes to a route.

    Row 0 = north; the route is a line of (n, 2) points.
    """
    pixels = np.round(np.column_stack((route[:, 0] + HALF, HALF - route[:, 1])) / CELL).astype(np.int32)
    off_route = np.ones((NODES, NODES), np.uint8)
    cv2.polylines(off_route, [pixels], isClosed=False, color=(0,))
    distance = cv2.distanceTransform(off_route, cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.asarray(distance * CELL, dtype=np.float32)


def maze(rooms: int, open_share: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return maze heights (n, n) in meters and the route (n, 2) through it, x, y.

    Args:
        rooms: along each side.
        open_share: share of the walls that a perfect maze would have which are left out.
        rng: random generator of walls, start and goal.
    """
    start, goal = (int(rng.integers(rooms)), 0), (int(rng.integers(rooms)), rooms - 1)
    parent = _spanning_tree(rooms, start, rng)
    # Walls to the east and to the south of each room.
    east, south = np.ones((rooms, rooms), np.bool_), np.ones((rooms, rooms), np.bool_)
    for room, before in parent.items():
        row, col = min(room, before)
        (east if room[0] == before[0] else south)[row, col] = False
    east &= rng.random(east.shape) >= open_share
    south &= rng.random(south.shape) >= open_share
    chain = [goal]
    while chain[-1] != start:
        chain.append(parent[chain[-1]])
    pitch = 2 * HALF / rooms
    rows, cols = np.array(chain[::-1], dtype=np.float64).T
    fine = np.linspace(0, len(chain) - 1, POINTS * (len(chain) - 1) + 1)
    row, col = (np.interp(fine, np.arange(len(chain)), rooms_of) for rooms_of in (rows, cols))
    return _walls(east, south), np.column_stack(((col + 0.5) * pitch - HALF, HALF - (row + 0.5) * pitch))


def _spanning_tree(rooms: int, root: Room, rng: np.random.Generator) -> dict[Room, Room]:
    """Return each room's neighbor toward the root, from a depth-first search for long routes."""
    parent: dict[Room, Room] = {}
    visited, stack = {root}, [root]
    while stack:
        row, col = stack[-1]
        ahead = [
            (row + i, col + j)
            for i, j in STEPS
            if 0 <= row + i < rooms and 0 <= col + j < rooms and (row + i, col + j) not in visited
        ]
        if not ahead:
            stack.pop()
            continue
        room = ahead[int(rng.integers(len(ahead)))]
        parent[room] = row, col
        visited.add(room)
        stack.append(room)
    return parent


def _walls(east: BoolArray, south: BoolArray) -> FloatArray:
    """Return (n, n) heights of the walls between rooms and of those along the border."""
    rooms = len(east)
    edge = np.round(np.linspace(WALL_NODES // 2, NODES - 1 - WALL_NODES // 2, rooms + 1)).astype(np.int64)
    z = np.zeros((NODES, NODES))
    half = WALL_NODES // 2
    for side in (slice(0, WALL_NODES), slice(NODES - WALL_NODES, NODES)):
        z[side, :] = z[:, side] = WALL_HEIGHT
    for row, col in np.argwhere(east).tolist():
        z[edge[row] - half : edge[row + 1] + half + 1, edge[col + 1] - half : edge[col + 1] + half + 1] = (
            WALL_HEIGHT
        )
    for row, col in np.argwhere(south).tolist():
        z[edge[row + 1] - half : edge[row + 1] + half + 1, edge[col] - half : edge[col + 1] + half + 1] = (
            WALL_HEIGHT
        )
    return z
