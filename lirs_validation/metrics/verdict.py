"""Verdict on a result: limits, rules for failed results, and the class of every run.

The same rules hold for runs, mapped logs and scores; only mapped logs are tested for scans that contradict
each other (`lirs_validation.metrics.consistency`): a run knows the truth, and its hillsides contradict.
`classify` returns the class. Every limit is a constant or a field of `VerdictLimits` in this file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

LEAST_COVERAGE = 0.95
"""Share of the scans that need a pose: a few poses alone can be aligned with any truth."""
LOST_SECONDS = 5.0
LOST_SCANS = 10
"""A mapper that does not know its place for so long, and during so many scans in a row, has lost it ..."""
LOST_SHARE = 0.05
"""... and so has one that does not know it for more than this share of the scans, or whose trajectory puts
more than this share of them where they contradict other passes."""
AGREEING, DISAGREEING = 0.25, 0.4
"""Revisit residuals of a mapped log up to which passes agree, and above which they disagree, meters
(docs/measured.md)."""
VISIBLE = 0.0005
"""Meters that an ATE must exceed the odometry's to be visibly worse."""


class LostRule:
    """Rule that decides scan by scan whether a mapper is lost."""

    def __init__(self) -> None:
        self._scans = self._lost = 0
        self._begun = 0.0
        self._in_a_row = 0
        self._too_long: tuple[float, float] | None = None

    def observe(self, stamp: float, lost: bool) -> None:
        """Take in whether the mapper knew its place after the scan of a stamp, seconds."""
        self._scans += 1
        if not lost:
            self._in_a_row = 0
            return
        self._lost += 1
        self._begun = self._begun if self._in_a_row else stamp
        self._in_a_row += 1
        seconds = stamp - self._begun
        longest = 0.0 if self._too_long is None else self._too_long[0]
        if self._in_a_row >= LOST_SCANS and seconds >= max(LOST_SECONDS, longest):
            self._too_long = seconds, self._begun

    @property
    def too_long(self) -> str | None:
        """Message about the longest loss; None below 5 s or 10 scans."""
        if self._too_long is None:
            return None
        seconds, begun = self._too_long
        return f"the mapper lost its place at {begun:.1f} s for {seconds:.1f} s"

    def reason(self) -> str | None:
        """Return why the mapper is lost; None if it is not.

        The time and the share of all scans so far count.
        """
        share = self._lost / self._scans if self._scans else 0.0
        if self.too_long is None and share <= LOST_SHARE:
            return None
        counted = f"{self._lost} of {self._scans} scans ({100 * share:.1f} %)"
        if self.too_long is None:
            return f"the mapper did not know its place during {counted}"
        return f"{self.too_long}; it did not know it during {counted}"


def incompleteness(coverage: float) -> str | None:
    """Return why a trajectory's scan coverage is too low; None if it suffices."""
    if coverage >= LEAST_COVERAGE:
        return None
    return (
        f"the trajectory has a pose for {100 * coverage:.1f} % of the scans, "
        f"at least {100 * LEAST_COVERAGE:g} % are required"
    )


def inconsistency(contradicted: float | None) -> str | None:
    """Return why the share of contradicting scans is too high; None if acceptable."""
    if contradicted is None or contradicted <= LOST_SHARE:
        return None
    return (
        f"{100 * contradicted:.1f} % of the scans end in space that other passes saw free, "
        f"at most {100 * LOST_SHARE:g} % may"
    )


def revisit_agreement(residual: float) -> str:
    """Return the agreement of passes in words, by the revisit residual in meters."""
    if residual <= AGREEING:
        return "the passes agree"
    return "the passes agree in part" if residual <= DISAGREEING else "the passes disagree"


def is_worse(ate: float | None, odometry: float | None) -> bool:
    """Return whether an ATE is visibly larger than the odometry's; False if one is None."""
    return ate is not None and odometry is not None and ate > odometry + VISIBLE


VerdictClass = Literal[
    "failed", "no reference", "not evaluated", "loses its way", "adds nothing", "path only", "works"
]
DRIVE_ENDED = ("tipped", "stuck", "off world")
"""Statuses of a drive that could not go on; the driver's source of poses decides whose fault that is."""


@dataclass(frozen=True, kw_only=True)
class VerdictLimits:
    """Limits between the classes of a verdict.

    Attributes:
        robot_lengths: shortest evaluated drive of a simulated run, robot lengths.
        times_odometry: factor of the odometry's error above which a method loses its way.
        over_odometry: meters added to that limit.
        drift: share of the distance above which a method without odometry loses its way.
        gain: factor of the odometry's error above which a method adds nothing.
        small_error: meters below which an error needs no gain over the odometry.
        f1_aligned: smallest F1 of a map after alignment.
        false_occupied: largest excess of false occupied cells over the true-pose map, share.
        elevation_rmse: largest excess of a cloud map's elevation error over the true poses' map, meters.
        elevation_seen: smallest share of the visible elevation in a cloud map.
    """

    robot_lengths: float = 10.0
    times_odometry: float = 1.1
    over_odometry: float = 0.05
    drift: float = 0.02
    gain: float = 0.9
    small_error: float = 0.05
    f1_aligned: float = 0.8
    false_occupied: float = 0.1
    elevation_rmse: float = 0.1
    elevation_seen: float = 0.8


LIMITS = VerdictLimits()


@dataclass(frozen=True, kw_only=True)
class VerdictFigures:
    """Figures of a result that decide its verdict; None = the result lacks the figure.

    Attributes:
        status: of the result.
        has_reference: whether the truth is known, as in every simulated run, even if nothing can be compared.
        uses_estimate: whether the driver follows the mapper's pose.
        robot_lengths: driven distance in robot lengths; None of a log.
        error: of the mapper's path, meters: ATE, or the mean translational error of relations.
        odometry_error: the same of the odometry.
        distance: driven, meters.
        occupied: occupied cells of the map.
        f1_aligned: of the map after alignment.
        false_occupied: false occupied cells of the aligned map, share.
        reference_false_occupied: the same of the true-pose map.
        elevation_rmse: of a cloud map after alignment, meters.
        reference_elevation_rmse: the same of the true poses' map.
        elevation_seen: share of the visible elevation in the cloud map.
    """

    status: str
    has_reference: bool = False
    uses_estimate: bool = False
    robot_lengths: float | None = None
    error: float | None = None
    odometry_error: float | None = None
    distance: float | None = None
    occupied: int | None = None
    f1_aligned: float | None = None
    false_occupied: float | None = None
    reference_false_occupied: float | None = None
    elevation_rmse: float | None = None
    reference_elevation_rmse: float | None = None
    elevation_seen: float | None = None


@dataclass(frozen=True)
class Reason:
    """A figure that decided a verdict.

    Attributes:
        figure: name.
        value: of the figure.
        limit: that the value exceeded or fell short of; a text for a status.
    """

    figure: str
    value: float | str | None
    limit: float | str


def classify(
    figures: VerdictFigures, limits: VerdictLimits = LIMITS
) -> tuple[VerdictClass, tuple[Reason, ...]]:
    """Return the class of a result and its reasons: the first rule that applies decides.

    A condition whose figure is None does not apply.
    """
    rules: tuple[tuple[VerdictClass, Callable[[VerdictFigures, VerdictLimits], list[Reason]]], ...] = (
        ("failed", _failure),
        ("no reference", _missing_reference),
        ("not evaluated", _short_drive),
        ("loses its way", _divergence),
        ("adds nothing", _no_gain),
        ("path only", _poor_map),
    )
    for name, rule in rules:
        reasons = rule(figures, limits)
        if reasons:
            return name, tuple(reasons)
    return "works", ()


def _failure(figures: VerdictFigures, _: VerdictLimits) -> list[Reason]:
    failed = figures.status in ("error", "timeout", "incomplete")
    return [Reason("status", figures.status, "ok")] if failed else []


def _missing_reference(figures: VerdictFigures, _: VerdictLimits) -> list[Reason]:
    missing = figures.error is None and not figures.has_reference
    return [Reason("trajectory error", None, "a reference")] if missing else []


def _short_drive(figures: VerdictFigures, limits: VerdictLimits) -> list[Reason]:
    ended = figures.status in DRIVE_ENDED and not figures.uses_estimate
    if figures.status == "diverged" or ended:
        return [Reason("status", figures.status, "ok")]
    if figures.robot_lengths is not None and figures.robot_lengths < limits.robot_lengths:
        return [Reason("robot lengths driven", figures.robot_lengths, limits.robot_lengths)]
    return []


def _divergence(figures: VerdictFigures, limits: VerdictLimits) -> list[Reason]:
    ended = figures.status in DRIVE_ENDED and figures.uses_estimate
    if figures.status == "lost" or ended:
        return [Reason("status", figures.status, "ok")]
    most = _largest_error(figures, limits)
    if figures.error is None or most is None or figures.error <= most:
        return []
    return [Reason("trajectory error", figures.error, most)]


def _largest_error(figures: VerdictFigures, limits: VerdictLimits) -> float | None:
    """Return the error above which a method loses its way, meters."""
    if figures.odometry_error is not None:
        return limits.times_odometry * figures.odometry_error + limits.over_odometry
    return None if figures.distance is None else limits.drift * figures.distance


def _no_gain(figures: VerdictFigures, limits: VerdictLimits) -> list[Reason]:
    reasons = []
    if figures.occupied == 0:
        reasons.append(Reason("occupied cells", 0, 1))
    if figures.error is not None and figures.odometry_error is not None:
        most = max(limits.gain * figures.odometry_error, limits.small_error)
        if figures.error > most:
            reasons.append(Reason("trajectory error", figures.error, most))
    return reasons


def _poor_map(figures: VerdictFigures, limits: VerdictLimits) -> list[Reason]:
    reference, elevation = figures.reference_false_occupied, figures.reference_elevation_rmse
    most_false = None if reference is None else reference + limits.false_occupied
    most_rmse = None if elevation is None else elevation + limits.elevation_rmse
    checks = (
        ("F1 aligned", figures.f1_aligned, limits.f1_aligned, False),
        ("false occupied, aligned", figures.false_occupied, most_false, True),
        ("elevation RMSE, aligned", figures.elevation_rmse, most_rmse, True),
        ("elevation seen", figures.elevation_seen, limits.elevation_seen, False),
    )
    return [
        Reason(name, value, limit)
        for name, value, limit, most in checks
        if value is not None and limit is not None and (value > limit if most else value < limit)
    ]
