"""Cells: runs that differ in nothing but their seed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass
from functools import cache
from typing import Any

from lirs_envs.robots.catalog import make_robot
from lirs_wct.errors import ConfigError

Entry = Mapping[str, Any]
FIELDS = ("world", "robot", "mapper", "terrain", "rays", "lidar", "seconds")


@dataclass(frozen=True, order=True)
class Cell:
    """What the runs of a cell have in common."""

    world: str
    robot: str
    mapper: str
    terrain: str
    rays: str
    lidar: str
    seconds: float

    @staticmethod
    def of(entry: Entry) -> Cell:
        """Return the cell of a record; without an LRF of its own a config means the robot's."""
        c = entry["config"]
        return Cell(
            entry["world"]["name"],
            c["robot"],
            c["mapper"],
            c["terrain"],
            c["rays"],
            c["lidar"] or _own_lidar(c["robot"]),
            float(c["seconds"]),
        )

    def named(self, fields: Iterable[str] = FIELDS) -> str:
        """Return the cell in words, or some of its fields."""
        words = {**dict(zip(FIELDS, astuple(self), strict=True)), "seconds": f"{self.seconds:g} s"}
        words["rays"] = f"rays: {self.rays}"
        return ", ".join(str(words[field]) for field in FIELDS if field in set(fields))


def by_cell(entries: Iterable[Entry]) -> dict[Cell, list[Entry]]:
    """Return the records of each cell, by seed; cells in the order in which they first come."""
    found: dict[Cell, list[Entry]] = {}
    for entry in entries:
        found.setdefault(Cell.of(entry), []).append(entry)
    return {cell: sorted(runs, key=lambda e: int(e["seed"])) for cell, runs in found.items()}


def telling(cells: Iterable[Cell]) -> tuple[str, ...]:
    """Return the fields in which cells differ; `world` where they do not differ at all.

    The LRF is left out where each robot has its own.
    """
    kept = list(cells)
    different = [f for f in FIELDS if len({getattr(cell, f) for cell in kept}) > 1]
    if len({(c.robot, c.lidar) for c in kept}) == len({c.robot for c in kept}):
        different = [f for f in different if f != "lidar"]
    return tuple(different) or ("world",)


@cache
def _own_lidar(robot: str) -> str:
    try:
        return make_robot(robot).lidar
    except ConfigError:
        return "the robot's own"
