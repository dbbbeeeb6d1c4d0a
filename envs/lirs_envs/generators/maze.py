"""Mazes: walls between square rooms, with a route from the west to the east side."""

from __future__ import annotations

import numpy as np

from lirs_envs.generators.natural import NODES
from lirs_envs.generators.route import HALF
from lirs_wct.arrays import BoolArray, FloatArray

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
