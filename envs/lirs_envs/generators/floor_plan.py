"""Floor plans from a seed: rooms of a rectangular building, doors between them, furniture."""

from __future__ import annotations

import numpy as np

from lirs_wct import BoolArray, HeightField, Pose2, WallGrid
from lirs_wct.ground import LaserMap

CELL = 0.05
"""Edge of a cell, meters."""
SIZE = (24.0, 16.0)
"""Extent of the building, meters."""
LEAST_ROOM = 3.6
"""Shortest side of a room, meters."""
WALL = 0.15
"""Thickness of a wall, meters."""
DOOR = 1.4
"""Width of a door, meters."""
SECOND_DOORS = 0.3
"""Share of walls with an extra door between rooms that are already connected."""
FURNITURE = 3
"""Most pieces of furniture in a room."""
FURNITURE_SIZE = (0.4, 1.6)
"""Shortest and longest side of a piece of furniture, meters."""
BESIDE_DOOR = 1.0
"""Meters around a door without furniture."""
Room = tuple[float, float, float, float]
"""West, south, east, north, meters from the building's corner."""
Door = tuple[int, int, float, float]
"""Two rooms, and x and y of the center of the door between them."""


def floor_plan(rng: np.random.Generator) -> LaserMap:
    """Return a building of 24 x 16 m with connected rooms, centered on the origin."""
    rooms = _rooms((0.0, 0.0, *SIZE), rng)
    doors = _chosen(_possible_doors(rooms, rng), len(rooms), rng)
    solid = np.zeros((round(SIZE[1] / CELL), round(SIZE[0] / CELL)), np.bool_)
    for west, south, east, north in rooms:
        for wall in (
            (west - WALL / 2, south, west + WALL / 2, north),
            (east - WALL / 2, south, east + WALL / 2, north),
            (west, south - WALL / 2, east, south + WALL / 2),
            (west, north - WALL / 2, east, north + WALL / 2),
        ):
            _fill(solid, wall, True)
    for _, _, x, y in doors:
        _fill(solid, (x - DOOR / 2, y - DOOR / 2, x + DOOR / 2, y + DOOR / 2), False)
    for room in rooms:
        for piece in _furniture(room, doors, rng):
            _fill(solid, piece, True)
    solid[[0, 1, -2, -1], :] = solid[:, [0, 1, -2, -1]] = True
    corner = (-SIZE[0] / 2, -SIZE[1] / 2)
    return LaserMap(
        HeightField(np.zeros((2, 2), np.float32), SIZE, corner), WallGrid(solid, CELL, Pose2(*corner))
    )


def _rooms(room: Room, rng: np.random.Generator) -> list[Room]:
    """Divide a rectangle into rooms, each across its longer side."""
    west, south, east, north = room
    across = east - west >= north - south
    low, high = (west, east) if across else (south, north)
    if high - low < 2 * LEAST_ROOM or (high - low < 3 * LEAST_ROOM and rng.random() < 0.3):
        return [room]
    at = float(rng.uniform(low + LEAST_ROOM, high - LEAST_ROOM))
    halves = (
        ((west, south, at, north), (at, south, east, north))
        if across
        else ((west, south, east, at), (west, at, east, north))
    )
    return [part for half in halves for part in _rooms(half, rng)]


def _possible_doors(rooms: list[Room], rng: np.random.Generator) -> list[Door]:
    """Return a door for each two rooms with enough of a wall in common."""
    doors: list[Door] = []
    room_for_door = DOOR + 2 * WALL
    for a, (west, south, east, north) in enumerate(rooms):
        for b, other in enumerate(rooms):
            low, high = max(south, other[1]), min(north, other[3])
            if east == other[0] and high - low >= room_for_door:
                doors.append((a, b, east, float(rng.uniform(low, high - room_for_door)) + room_for_door / 2))
            low, high = max(west, other[0]), min(east, other[2])
            if north == other[1] and high - low >= room_for_door:
                doors.append((a, b, float(rng.uniform(low, high - room_for_door)) + room_for_door / 2, north))
    return doors


def _chosen(doors: list[Door], rooms: int, rng: np.random.Generator) -> list[Door]:
    """Return doors that join all rooms (Kruskal 1956, in random order), and some more."""
    group = list(range(rooms))
    chosen = []
    for k in rng.permutation(len(doors)).tolist():
        a, b = group[doors[k][0]], group[doors[k][1]]
        if a != b or rng.random() < SECOND_DOORS:
            chosen.append(doors[k])
            group = [a if g == b else g for g in group]
    return chosen


def _furniture(room: Room, doors: list[Door], rng: np.random.Generator) -> list[Room]:
    """Return rectangles in a room, away from its doors."""
    west, south, east, north = room
    pieces = []
    for _ in range(int(rng.integers(FURNITURE + 1))):
        width, depth = rng.uniform(*FURNITURE_SIZE, 2).tolist()
        x = float(rng.uniform(west, east - width))
        y = float(rng.uniform(south, north - depth))
        reach = DOOR / 2 + BESIDE_DOOR
        if not any(
            x - reach < door_x < x + width + reach and y - reach < door_y < y + depth + reach
            for _, _, door_x, door_y in doors
        ):
            pieces.append((x, y, x + width, y + depth))
    return pieces


def _fill(solid: BoolArray, rectangle: Room, value: bool) -> None:
    col0, row0, col1, row1 = (max(0, round(edge / CELL)) for edge in rectangle)
    solid[row0:row1, col0:col1] = value
