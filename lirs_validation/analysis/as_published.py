"""Methods as published beside terrain-aware ones and odometry alone: who holds in which world.

A run *holds* where it succeeded and its ATE is at most TIMES the odometry's + SLACK: the method did not lose
what the odometry knew. A method holds in a world where the share MOST of its runs do, and loses its way where
that share do not. Runs that ended because of the drive, not of the mapper, are not counted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

from lirs_validation.analysis.groups import RunGroup, by_group
from lirs_validation.record.formatting import Entry, value_at
from lirs_validation.record.metric_catalog import ATE, ODOMETRY_ATE
from lirs_validation.record.run_record import Status, succeeded

SUFFIX = "_original"
"""Ends the name of a method as published: `hector_original` beside `hector`."""
TIMES, SLACK = 1.1, 0.05
"""Of the odometry's ATE, and meters: what a run that holds may be worse."""
MOST = 0.8
"""Share of the runs that decides what a method does in a world."""
CLEARLY = 1.5
"""Times as accurate from which on it is said."""
UNCHECKED = ("cartographer",)
"""Methods whose version as published was never compared with runs of its original."""
OF_THE_DRIVE: tuple[Status, ...] = ("tipped", "stuck", "off world", "diverged")
"""Ends that say nothing of the mapper."""

Planar = Literal["as published", "without attitude"]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How the runs of a method in a world compare with their odometry.

    Attributes:
        runs: that are counted.
        held: of these.
        lost: that ended because the mapper said that it was lost.
        ate: median over those that succeeded, meters; None where none did.
        odometry: median of their odometry's ATE, meters; None where none did.
    """

    runs: int
    held: int
    lost: int
    ate: float | None
    odometry: float | None = None

    @property
    def holds(self) -> bool:
        """Whether the method holds."""
        return self.runs > 0 and self.held >= MOST * self.runs

    @property
    def loses(self) -> bool:
        """Whether the method loses its way."""
        return self.runs > 0 and self.runs - self.held >= MOST * self.runs

    def clause(self, where: str = "") -> str:
        """Return what the method does, as the end of a sentence about it; `where` is ` here` or nothing."""
        if self.runs == 0:
            return f"has no run that counts{where}"
        if self.holds:
            return f"holds{where}"
        says = " and says so" if self.lost == self.runs - self.held else ""
        if self.loses:
            return f"loses its way{where}{says}"
        return f"holds in {self.held} of {self.runs} runs{where}"


@dataclass(frozen=True, kw_only=True)
class MethodPair:
    """The runs of one method in one world, planar and terrain-aware.

    Attributes:
        group: of the terrain-aware runs.
        planar: its runs as published, or without attitude.
        aware: its runs with attitude.
        how: what the planar ones are.
    """

    group: RunGroup
    planar: tuple[Entry, ...]
    aware: tuple[Entry, ...]
    how: Planar

    @property
    def runs(self) -> tuple[Entry, ...]:
        """All of them."""
        return self.planar + self.aware


def published_pairs(entries: Iterable[Entry]) -> tuple[MethodPair, ...]:
    """Return each method of which there are runs both as published and terrain-aware, world by world."""
    groups = by_group(entries)
    return tuple(
        MethodPair(group=group, planar=tuple(planar), aware=tuple(aware), how="as published")
        for group, aware in groups.items()
        if group["attitude"] == "imu" and (planar := _as_published(group, groups))
    )


def attitude_pairs(entries: Iterable[Entry]) -> tuple[MethodPair, ...]:
    """Return each mapper of which there are runs both without attitude and with it, world by world.

    A method as published is left out: it never looks at the attitude.
    """
    groups = by_group(entries)
    return tuple(
        MethodPair(group=group, planar=tuple(planar), aware=tuple(aware), how="without attitude")
        for group, aware in groups.items()
        if group["attitude"] == "imu"
        and not group["mapper"].endswith(SUFFIX)
        and (planar := groups.get(group.replaced(attitude="none")))
    )


def outcome_of(entries: Sequence[Entry]) -> Outcome:
    """Return how runs of one method in one world compare with their odometry."""
    counted = [entry for entry in entries if entry["status"] not in OF_THE_DRIVE]
    errors = [ate for e in counted if succeeded(e) and (ate := value_at(e, ATE)) is not None]
    reckoned = [ate for e in counted if succeeded(e) and (ate := value_at(e, ODOMETRY_ATE)) is not None]
    return Outcome(
        runs=len(counted),
        held=sum(map(holds, counted)),
        lost=sum(entry["status"] == "lost" for entry in counted),
        ate=median(errors) if errors else None,
        odometry=median(reckoned) if reckoned else None,
    )


def holds(entry: Entry) -> bool:
    """Whether a run succeeded, and its ATE is at most TIMES its odometry's + SLACK."""
    ate, odometry = value_at(entry, ATE), value_at(entry, ODOMETRY_ATE)
    return succeeded(entry) and None not in (ate, odometry) and ate <= TIMES * odometry + SLACK


def conclusion(planar: Outcome, aware: Outcome, how: Planar) -> str:
    """Return in one sentence what follows for who runs the method on such ground."""
    first = f"{how.capitalize()} it {planar.clause(' here')}"
    if planar.holds and aware.holds:
        return f"{first}, {_compared(planar, aware)}."
    if planar.loses and aware.loses:
        alone = "odometry alone is as good or better"
        if planar.clause() == aware.clause():
            return f"It {planar.clause(' here')}, {how} and with attitude: {alone}."
        return f"{first}, with attitude it {aware.clause()}: {alone}."
    return f"{first}; with attitude it {aware.clause()}{_by_odometry(aware)}."


def _by_odometry(outcome: Outcome) -> str:
    """Return whether a method that holds adds little to its odometry: it may have found no walls."""
    ate, odometry = outcome.ate, outcome.odometry
    if not outcome.holds or ate is None or odometry is None or ate * CLEARLY < odometry:
        return ""
    return ", but is not clearly more accurate than its odometry"


def _compared(planar: Outcome, aware: Outcome) -> str:
    """Return how accurate two methods are that both hold."""
    if not planar.ate or not aware.ate:
        return "and with attitude"
    ratio = planar.ate / aware.ate
    if ratio >= CLEARLY:
        return f"and with attitude it is {ratio:.1f} times as accurate"
    if ratio <= 1 / CLEARLY:
        return f"and is {1 / ratio:.1f} times as accurate as with attitude"
    return "as well as with attitude"


def _as_published(group: RunGroup, groups: Mapping[RunGroup, list[Entry]]) -> list[Entry] | None:
    """Return the runs of a group's method as published; it gets no attitude, whatever was asked for."""
    original = group.replaced(mapper=group["mapper"] + SUFFIX)
    return groups.get(original) or groups.get(original.replaced(attitude="none"))
