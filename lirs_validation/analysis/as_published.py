"""Comparison of methods as published, terrain-aware methods and odometry alone, by world.

A run *holds* if it succeeded and its ATE is at most TIMES the odometry's + SLACK: the method is not worse
than its odometry. A method holds in a world if the share MOST of its runs hold, and loses its way if that
share do not. Runs that ended because of the drive, not of the mapper, are not counted.
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
"""Largest ATE of a run that holds: this factor of the odometry's ATE, plus meters."""
MOST = 0.8
"""Share of runs that must hold, or fail, for a verdict on a method in a world."""
CLEARLY = 1.5
"""Smallest ratio of two ATE that a conclusion mentions."""
UNCHECKED = ("cartographer",)
"""Methods whose published version was never compared with runs of the original program."""
OF_THE_DRIVE: tuple[Status, ...] = ("tipped", "stuck", "off world", "diverged")
"""Statuses that do not depend on the mapper."""

Planar = Literal["as published", "without attitude"]


@dataclass(frozen=True, kw_only=True)
class MethodOutcome:
    """Comparison of a method's runs in a world with their odometry.

    Attributes:
        runs: number of counted runs.
        held: number of runs that hold.
        lost: number of runs that the mapper ended as lost.
        ate: median over successful runs, meters; None without any.
        odometry: median of their odometry's ATE, meters; None without any.
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
        """Return the verdict as the end of a sentence; `where` is ` here` or empty."""
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
        how: kind of the planar runs.
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
    """Return each method with runs both as published and terrain-aware, by world."""
    groups = by_group(entries)
    return tuple(
        MethodPair(group=group, planar=tuple(planar), aware=tuple(aware), how="as published")
        for group, aware in groups.items()
        if group["attitude"] == "imu" and (planar := _as_published(group, groups))
    )


def attitude_pairs(entries: Iterable[Entry]) -> tuple[MethodPair, ...]:
    """Return each mapper with runs both without and with attitude, by world.

    Methods as published are left out: they do not use the attitude.
    """
    groups = by_group(entries)
    return tuple(
        MethodPair(group=group, planar=tuple(planar), aware=tuple(aware), how="without attitude")
        for group, aware in groups.items()
        if group["attitude"] == "imu"
        and not group["mapper"].endswith(SUFFIX)
        and (planar := groups.get(group.replaced(attitude="none")))
    )


def outcome_of(entries: Sequence[Entry]) -> MethodOutcome:
    """Compare the runs of one method in one world with their odometry."""
    counted = [entry for entry in entries if entry["status"] not in OF_THE_DRIVE]
    errors = [ate for e in counted if succeeded(e) and (ate := value_at(e, ATE)) is not None]
    reckoned = [ate for e in counted if succeeded(e) and (ate := value_at(e, ODOMETRY_ATE)) is not None]
    return MethodOutcome(
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


def conclusion(planar: MethodOutcome, aware: MethodOutcome, how: Planar) -> str:
    """Return a one-sentence conclusion for users of the method on such ground."""
    first = f"{how.capitalize()} it {planar.clause(' here')}"
    if planar.holds and aware.holds:
        return f"{first}, {_accuracy_clause(planar, aware)}."
    if planar.loses and aware.loses:
        alone = "odometry alone is as good or better"
        if planar.clause() == aware.clause():
            return f"It {planar.clause(' here')}, {how} and with attitude: {alone}."
        return f"{first}, with attitude it {aware.clause()}: {alone}."
    return f"{first}; with attitude it {aware.clause()}{_by_odometry(aware)}."


def _by_odometry(outcome: MethodOutcome) -> str:
    """Return a remark if a method that holds is hardly more accurate than its odometry."""
    ate, odometry = outcome.ate, outcome.odometry
    if not outcome.holds or ate is None or odometry is None or ate * CLEARLY < odometry:
        return ""
    return ", but is not clearly more accurate than its odometry"


def _accuracy_clause(planar: MethodOutcome, aware: MethodOutcome) -> str:
    """Return the accuracy ratio of two methods that both hold, as a clause."""
    if not planar.ate or not aware.ate:
        return "and with attitude"
    ratio = planar.ate / aware.ate
    if ratio >= CLEARLY:
        return f"and with attitude it is {ratio:.1f} times as accurate"
    if ratio <= 1 / CLEARLY:
        return f"and is {1 / ratio:.1f} times as accurate as with attitude"
    return "as well as with attitude"


def _as_published(group: RunGroup, groups: Mapping[RunGroup, list[Entry]]) -> list[Entry] | None:
    """Return the runs of a group's method as published, which get no attitude."""
    original = group.replaced(mapper=group["mapper"] + SUFFIX)
    return groups.get(original) or groups.get(original.replaced(attitude="none"))
