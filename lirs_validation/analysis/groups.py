"""Groups of runs that differ only in their seed, and statistics of such repeats."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy  # its modules load on first use

from lirs_envs.robots.robot import make_robot
from lirs_validation.config import RUN_AXES, RunConfig
from lirs_validation.record.metric_catalog import Entry
from lirs_wct.errors import ConfigError
from lirs_wct.option import declared, defaults

FIELDS = ("world", *(name for name in RUN_AXES if name != "seed"), "seconds")
"""Fields of a group: the world's name, and the options of its runs."""
DEFAULTS = defaults(RunConfig)
ORIGINAL = "_original"
"""End of the name of a method as published: `hector_original` beside `hector`."""
CONFIDENCE = 0.95
"""Share of the confidence intervals."""


@dataclass(frozen=True, order=True)
class RunGroup:
    """World and options that the runs of a group share.

    Attributes:
        values: Value of each of FIELDS.
    """

    values: tuple[Any, ...]

    @staticmethod
    def of(entry: Entry) -> RunGroup:
        """Return the group of a record, with the robot's default lidar filled in."""
        given = {"world": entry["world"]["name"], **DEFAULTS, **entry["config"]}
        given |= {"lidar": given["lidar"] or _own_lidar(given["robot"]), "seconds": float(given["seconds"])}
        return RunGroup(tuple(given[name] for name in FIELDS))

    def __getitem__(self, name: str) -> Any:
        return self.values[FIELDS.index(name)]

    def replaced(self, **values: Any) -> RunGroup:
        """Return the group with other values of some fields."""
        return RunGroup(tuple(values.get(name, self[name]) for name in FIELDS))

    def label(self, fields: Iterable[str] = FIELDS) -> str:
        """Return the group's name: its fields, or some of them, in one line."""
        forms = {name: option.shown for name, option in declared(RunConfig).items()}
        wanted = set(fields)
        return ", ".join(forms.get(f, "{}").format(self[f]) for f in FIELDS if f in wanted)


def unusual_fields(groups: Iterable[RunGroup]) -> tuple[str, ...]:
    """Return the axes in which a group differs from the default run."""
    kept = list(groups)
    return tuple(name for name in RUN_AXES if name in FIELDS and any(_is_unusual(g, name) for g in kept))


def _is_unusual(group: RunGroup, name: str) -> bool:
    usual = _own_lidar(group["robot"]) if name == "lidar" else DEFAULTS[name]
    return bool(group[name] != usual)


def by_group(entries: Iterable[Entry]) -> dict[RunGroup, list[Entry]]:
    """Return the records of each group by seed, groups in order of appearance."""
    found: dict[RunGroup, list[Entry]] = {}
    for entry in entries:
        found.setdefault(RunGroup.of(entry), []).append(entry)
    return {group: sorted(runs, key=lambda e: int(e["seed"])) for group, runs in found.items()}


def distinguishing_fields(groups: Iterable[RunGroup]) -> tuple[str, ...]:
    """Return the fields in which groups differ; `world` where they do not differ at all.

    The LRF is left out where each robot has its own.
    """
    kept = list(groups)
    different = [f for f in FIELDS if len({group[f] for group in kept}) > 1]
    if len({(g["robot"], g["lidar"]) for g in kept}) == len({g["robot"] for g in kept}):
        different = [f for f in different if f != "lidar"]
    return tuple(different) or ("world",)


@cache
def _own_lidar(robot: str) -> str:
    try:
        return make_robot(robot).lidar
    except ConfigError:
        return "the robot's own"


@dataclass(frozen=True, kw_only=True)
class Repeats:
    """Mean over repeats with its confidence interval.

    Attributes:
        mean: Mean of the values.
        std: Standard deviation of the sample (n - 1); None of one value.
        half_width: Half width of the mean's 95 % interval, from Student's t; None of one value.
        count: Number of values.
    """

    mean: float
    std: float | None
    half_width: float | None
    count: int


def repeats(values: Sequence[float]) -> Repeats | None:
    """Return mean, standard deviation and 95 % interval of repeats; None of no value."""
    n = len(values)
    if n == 0:
        return None
    mean = float(np.mean(values))
    if n == 1:
        return Repeats(mean=mean, std=None, half_width=None, count=1)
    std = float(np.std(values, ddof=1))
    reach = float(scipy.stats.t.ppf(0.5 + CONFIDENCE / 2, n - 1)) * std / math.sqrt(n)
    return Repeats(mean=mean, std=std, half_width=reach, count=n)
