"""Comparison of methods as published, terrain-aware methods and odometry alone, by world.

A method has a class in a world if the share MOST of its runs has this verdict. Runs with the verdict
`not evaluated` are not counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

from lirs_validation.analysis.groups import RunGroup, by_group
from lirs_validation.metrics.verdict import VerdictClass
from lirs_validation.record.formatting import Entry, value_at
from lirs_validation.record.metric_catalog import ATE
from lirs_validation.record.run_record import succeeded
from lirs_validation.record.verdict import Verdict, class_counts, judge

SUFFIX = "_original"
"""Ends the name of a method as published: `hector_original` beside `hector`."""
MOST = 0.8
"""Share of runs that must have a verdict for a method to have it in a world."""
CLEARLY = 1.5
"""Smallest ratio of two ATE that a conclusion mentions."""

Planar = Literal["as published", "without attitude"]


@dataclass(frozen=True, kw_only=True)
class MethodOutcome:
    """Verdicts and accuracy of a method's runs in a world.

    Attributes:
        verdicts: of the counted runs.
        ate: median over successful runs, meters; None without any.
    """

    verdicts: tuple[Verdict, ...]
    ate: float | None = None

    @property
    def shared(self) -> VerdictClass | None:
        """Class of the share MOST of the runs; None if there is none."""
        for kind, count in Counter(verdict.kind for verdict in self.verdicts).most_common(1):
            if count >= MOST * len(self.verdicts):
                return kind
        return None

    def __str__(self) -> str:
        return class_counts(self.verdicts) or "not evaluated"


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
    """Return verdicts and accuracy of the runs of one method in one world."""
    judged = [(entry, judge(entry)) for entry in entries]
    counted = [(entry, verdict) for entry, verdict in judged if verdict.kind != "not evaluated"]
    errors = [ate for e, _ in counted if succeeded(e) and (ate := value_at(e, ATE)) is not None]
    verdicts = tuple(verdict for _, verdict in counted)
    return MethodOutcome(verdicts=verdicts, ate=median(errors) if errors else None)


def conclusion(planar: MethodOutcome, aware: MethodOutcome, how: Planar) -> str:
    """Return a one-sentence conclusion for users of the method on such ground."""
    kinds = [outcome.shared or "mixed" for outcome in (planar, aware)]
    if kinds == ["works", "works"]:
        return f"Works {how} and with attitude{_accuracy_clause(planar, aware)}."
    if kinds[0] == kinds[1]:
        return f"{kinds[0].capitalize()}, {how} and with attitude."
    return f"{how.capitalize()}: {kinds[0]}. With attitude: {kinds[1]}."


def _accuracy_clause(planar: MethodOutcome, aware: MethodOutcome) -> str:
    """Return the accuracy ratio of two methods that both work, as a clause."""
    if not planar.ate or not aware.ate:
        return ""
    ratio = planar.ate / aware.ate
    if ratio >= CLEARLY:
        return f"; {ratio:.1f} times as accurate with attitude"
    if ratio <= 1 / CLEARLY:
        return f"; {1 / ratio:.1f} times less accurate with attitude"
    return ""


def _as_published(group: RunGroup, groups: Mapping[RunGroup, list[Entry]]) -> list[Entry] | None:
    """Return the runs of a group's method as published, which get no attitude."""
    original = group.replaced(mapper=group["mapper"] + SUFFIX)
    return groups.get(original) or groups.get(original.replaced(attitude="none"))
