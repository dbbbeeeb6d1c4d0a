"""Pairs of planar and terrain-aware runs of a method, by world."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from lirs_validation.analysis.groups import RunGroup, by_group
from lirs_validation.record.metric_catalog import Entry

SUFFIX = "_original"
"""Ends the name of a method as published: `hector_original` beside `hector`."""

Planar = Literal["as published", "without attitude"]


@dataclass(frozen=True, kw_only=True)
class MethodPair:
    """The runs of one method in one world, planar and terrain-aware.

    Attributes:
        group: Group of the terrain-aware runs.
        planar: Runs as published, or without attitude.
        aware: Runs with attitude.
    """

    group: RunGroup
    planar: tuple[Entry, ...]
    aware: tuple[Entry, ...]

    @property
    def runs(self) -> tuple[Entry, ...]:
        """All of them."""
        return self.planar + self.aware


def method_pairs(entries: Iterable[Entry], kind: Planar) -> tuple[MethodPair, ...]:
    """Return each method with runs both planar and terrain-aware, by world."""
    groups = by_group(entries)
    return tuple(
        MethodPair(group=group, planar=tuple(planar), aware=tuple(aware))
        for group, aware in groups.items()
        if group["attitude"] == "imu" and (planar := _planar_runs(group, groups, kind))
    )


def _planar_runs(group: RunGroup, groups: Mapping[RunGroup, list[Entry]], kind: Planar) -> list[Entry] | None:
    """Return the planar runs beside a terrain-aware group; methods as published use no attitude."""
    mapper = group["mapper"]
    if kind == "as published":
        original = group.replaced(mapper=mapper + SUFFIX)
        return groups.get(original) or groups.get(original.replaced(attitude="none"))
    return None if mapper.endswith(SUFFIX) else groups.get(group.replaced(attitude="none"))
