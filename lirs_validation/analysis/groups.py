"""Groups: runs that differ in nothing but their seed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import astuple, dataclass
from functools import cache

from lirs_envs.robots.catalog import make_robot
from lirs_validation.config import LATER
from lirs_validation.record.formatting import Entry
from lirs_wct.errors import ConfigError

FIELDS = (
    *("world", "robot", "mapper", "terrain", "rays", "lidar", "seconds"),
    *("attitude", "driver", "actors", "threads"),
)


@dataclass(frozen=True, order=True)
class Group:
    """What the runs of a group have in common."""

    world: str
    robot: str
    mapper: str
    terrain: str
    rays: str
    lidar: str
    seconds: float
    attitude: str = LATER["attitude"]
    driver: str = LATER["driver"]
    actors: int = LATER["actors"]
    threads: int = LATER["threads"]

    @staticmethod
    def of(entry: Entry) -> Group:
        """Return the group of a record; without an LRF of its own a config means the robot's."""
        c = entry["config"]
        return Group(
            entry["world"]["name"],
            c["robot"],
            c["mapper"],
            c["terrain"],
            c["rays"],
            c["lidar"] or _own_lidar(c["robot"]),
            float(c["seconds"]),
            *(c.get(name, usual) for name, usual in LATER.items()),
        )

    def named(self, fields: Iterable[str] = FIELDS) -> str:
        """Return the group's name: its fields, or some of them, in one line."""
        texts = {**dict(zip(FIELDS, astuple(self), strict=True)), "seconds": f"{self.seconds:g} s"}
        texts |= {"rays": f"rays: {self.rays}", "attitude": f"attitude: {self.attitude}"}
        texts |= {"driver": f"driver: {self.driver}", "actors": f"{self.actors} walkers"}
        texts |= {"threads": f"{self.threads} thread{'s' * (self.threads > 1)}"}
        return ", ".join(str(texts[field]) for field in FIELDS if field in set(fields))


def by_group(entries: Iterable[Entry]) -> dict[Group, list[Entry]]:
    """Return the records of each group, by seed; groups in the order in which they first come."""
    found: dict[Group, list[Entry]] = {}
    for entry in entries:
        found.setdefault(Group.of(entry), []).append(entry)
    return {group: sorted(runs, key=lambda e: int(e["seed"])) for group, runs in found.items()}


def distinguishing_fields(groups: Iterable[Group]) -> tuple[str, ...]:
    """Return the fields in which groups differ; `world` where they do not differ at all.

    The LRF is left out where each robot has its own.
    """
    kept = list(groups)
    different = [f for f in FIELDS if len({getattr(group, f) for group in kept}) > 1]
    if len({(g.robot, g.lidar) for g in kept}) == len({g.robot for g in kept}):
        different = [f for f in different if f != "lidar"]
    return tuple(different) or ("world",)


@cache
def _own_lidar(robot: str) -> str:
    try:
        return make_robot(robot).lidar
    except ConfigError:
        return "the robot's own"
