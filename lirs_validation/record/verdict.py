"""Verdict on a result: limits, class, one sentence for the user, and the reasons.

The same rules hold for runs, mapped logs and scores; only the walls of mapped logs are compared with each
other (`lirs_validation.metrics.mapped_log`): a run knows the truth, and its hillsides differ.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

import yaml

from lirs_validation.config import CLIENT, FRONTIER
from lirs_validation.record.metric_catalog import (
    ATE,
    ODOMETRY_ATE,
    Entry,
    is_worse,
    metrics_named,
    text_at,
    value_at,
)
from lirs_wct.errors import ConfigError, reason_of, within
from slam_baselines.mapper import short_name

MIN_COVERAGE = 0.95
"""Share of the scans that need a pose: a few poses alone can be aligned with any truth."""
AGREEING, BETTER = 0.25, 0.85
"""Largest revisit residual of a path that is probably right, meters, and share of it below which another
path is the better one (docs/measured.md)."""
MAX_GAP = 10.0
"""Longest way without a scan over which the passes before and after it have one frame, meters."""
DRIVE_ENDED = ("tipped", "stuck", "off world")
"""Statuses of a drive that could not go on; the driver's source of poses decides whose fault that is."""
ACCEPTABLE = ("no reference", "path only")
"""Classes that a limits file may accept in addition to `works`."""

VerdictClass = Literal[
    "failed", "no reference", "not evaluated", "loses its way", "adds nothing", "path only", "works"
]
Conclusion = Literal["probably right", "doubtful", "cannot be checked"]
LEADS: dict[VerdictClass, str] = {
    "failed": "{who} gives no result on {world}",
    "no reference": "{who}'s map of {world}",
    "not evaluated": "{who} was not evaluated on {world}",
    "loses its way": "{who} loses its way on {world}",
    "adds nothing": "{who} adds nothing to the odometry on {world}",
    "path only": "{who} finds only its path on {world}",
    "works": "{who} works on {world}",
}
"""Beginning of the sentence by class, from worst to best."""
DRIVEN, ERROR, ODOMETRY_ERROR = metrics_named(("trajectory.length", ATE, ODOMETRY_ATE))
AGREE, FALSE = metrics_named(("map.f1_aligned", "map.false_occupied_aligned"))
ELEVATION, SEEN = metrics_named(("map.elevation_rmse_aligned", "map.elevation_seen"))
"""Figures that the sentence states."""


@dataclass(frozen=True, kw_only=True)
class VerdictLimits:
    """Limits between the classes of a verdict.

    Attributes:
        robot_lengths: shortest evaluated drive of a simulated run, robot lengths.
        times_odometry: factor of the odometry's error above which a method loses its way.
        over_odometry: meters added to that limit.
        drift: share of the distance above which a method without odometry loses its way.
        gain: factor of the odometry's error above which a method adds nothing.
        gain_without_map: value of `gain` for a method whose map is not usable.
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
    gain_without_map: float = 0.75
    small_error: float = 0.05
    f1_aligned: float = 0.8
    false_occupied: float = 0.1
    elevation_rmse: float = 0.1
    elevation_seen: float = 0.8

    def most_error(self, odometry: Any) -> Any:
        """Return the largest error without losing the way, of one or (n,) odometry errors."""
        return self.times_odometry * odometry + self.over_odometry


LIMITS = VerdictLimits()


@dataclass(frozen=True, kw_only=True)
class VerdictFigures:
    """Figures of a result that decide its verdict; None = the result lacks the figure.

    Attributes:
        status: Status of the result.
        has_reference: whether the truth is known, as in every simulated run, even if nothing can be compared.
        uses_estimate: whether the driver follows the mapper's pose.
        robot_lengths: driven distance in robot lengths; None of a log.
        error: Error of the mapper's path, meters: ATE, or the mean translational error of relations.
        odometry_error: Error of the odometry's path, meters.
        distance: Driven distance, meters.
        occupied: Number of occupied cells of the map.
        f1_aligned: F1 of the map after alignment.
        false_occupied: Share of false occupied cells of the aligned map.
        reference_false_occupied: Share of false occupied cells of the true-pose map.
        elevation_rmse: Elevation error of a cloud map after alignment, meters.
        reference_elevation_rmse: Elevation error of the true poses' map, meters.
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
    """Figure that decided a verdict, with its value and the limit (a text for a status)."""

    figure: str
    value: float | str | None
    limit: float | str


def classify(
    figures: VerdictFigures, limits: VerdictLimits = LIMITS
) -> tuple[VerdictClass, tuple[Reason, ...]]:
    """Return the class of a result and its reasons: the first rule that applies decides.

    A condition whose figure is None does not apply.
    """
    status = Reason("status", figures.status, "ok")
    ended = figures.status in DRIVE_ENDED
    if figures.status in ("error", "timeout", "incomplete"):
        return "failed", (status,)
    if figures.error is None and not figures.has_reference:
        return "no reference", (Reason("trajectory error", None, "a reference"),)
    if figures.status == "diverged" or (ended and not figures.uses_estimate):
        return "not evaluated", (status,)
    if figures.robot_lengths is not None and figures.robot_lengths < limits.robot_lengths:
        return "not evaluated", (Reason("robot lengths driven", figures.robot_lengths, limits.robot_lengths),)
    if figures.status == "lost" or ended:
        return "loses its way", (status,)
    error, odometry, distance = figures.error, figures.odometry_error, figures.distance
    if odometry is not None:
        most = limits.most_error(odometry)
    else:
        most = math.inf if distance is None else limits.drift * distance
    if error is not None and error > most:
        return "loses its way", (Reason("trajectory error", error, most),)
    reasons = [Reason("occupied cells", 0, 1)] if figures.occupied == 0 else []
    poor = _poor_map(figures, limits)
    if error is not None and odometry is not None:
        most = max(limits.gain * odometry, limits.small_error)
        most = min(most, limits.gain_without_map * odometry) if poor else most
        reasons += [Reason("trajectory error", error, most), *poor] if error > most else []
    if reasons:
        return "adds nothing", tuple(reasons)
    return ("path only", tuple(poor)) if poor else ("works", ())


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


def incompleteness(coverage: float) -> str | None:
    """Return why a trajectory's scan coverage is too low; None if it suffices."""
    if coverage >= MIN_COVERAGE:
        return None
    return (
        f"the trajectory has a pose for {100 * coverage:.1f} % of the scans, "
        f"at least {100 * MIN_COVERAGE:g} % are required"
    )


def disagreement(residual: float | None) -> str | None:
    """Return why a path's revisit residual is too large; None if acceptable or not known."""
    if residual is None or residual <= AGREEING:
        return None
    return f"its walls agree only to {residual:.2f} m, at most {AGREEING:g} m may lie between them"


@dataclass(frozen=True)
class Verdict:
    """Class, sentence for the user and deciding figures of a run, a mapped log or a score.

    No figure decides if the method works. A mapped log without truth has a conclusion.
    """

    kind: VerdictClass
    sentence: str
    reasons: tuple[Reason, ...] = ()
    conclusion: Conclusion | None = None

    def __str__(self) -> str:
        return self.sentence

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as a record stores it."""
        reasons = [asdict(reason) for reason in self.reasons]
        own = {"conclusion": self.conclusion} if self.conclusion else {}
        return {"class": self.kind, "sentence": self.sentence, "reasons": reasons} | own


def stored_verdict(entry: Entry, limits: VerdictLimits = LIMITS) -> Verdict:
    """Return the verdict that a record holds; by other limits, the record is judged again."""
    if limits != LIMITS:
        return judge(entry, limits)
    stored = entry["verdict"]
    reasons = tuple(Reason(**reason) for reason in stored["reasons"])
    return Verdict(stored["class"], stored["sentence"], reasons)


def judge(entry: Entry, limits: VerdictLimits = LIMITS, method: str = "") -> Verdict:
    """Return the verdict on a run's record; `method` is a name for the sentence."""
    figures = run_figures(entry)
    kind, reasons = classify(figures, limits)
    mapper, robot = text_at(entry, "config.mapper"), text_at(entry, "config.robot")
    who = method or f"{short_name(mapper)} on {robot}"
    lead, cause = LEADS[kind].format(who=who, world=entry["world"]["name"]), cause_of(kind, entry)
    if kind == "not evaluated" and not cause:
        needed = limits.robot_lengths * value_at(entry, "world.robot_length")
        length = DRIVEN.text(value_at(entry, DRIVEN.key))
        cause = f"it drove {length}, at least {DRIVEN.text(needed)} are needed (--seconds)"
    first = f"{lead}: {cause.rstrip('.')}." if cause else f"{lead}."
    unjudged = kind in ("failed", "not evaluated")
    results = () if unjudged else (_path_sentence(figures), _map_sentence(figures, limits))
    reports = "" if unjudged else _report_sentence(entry, lost=kind == "loses its way")
    parts = (first, *results, reports, extent_sentences(entry))
    return Verdict(kind, " ".join(part for part in parts if part), reasons)


def judge_log(entry: Entry) -> Verdict:
    """Return the verdict on the record of a mapped log, given as nested dicts."""
    figures = log_figures(entry)
    kind, reasons = classify(figures)
    log, reason, conclusion = entry["config"].get("log", entry["name"]), entry["reason"], None
    lead = LEADS[kind].format(who=short_name(entry["config"]["mapper"]), world=Path(log).name)
    if kind == "no reference":
        conclusion, reason = conclude_log(entry)
        lead += f" {conclusion}" if conclusion == "cannot be checked" else f" is {conclusion}"
    first = f"{lead}: {reason}." if reason else f"{lead}."
    unfit = entry["log"].get("unfit") if kind != "works" else ""
    if unfit:  # the log is at fault, and not the mapper
        first = f"{Path(log).name} is not fit for planar mapping: {unfit}."
    doubts = [*entry["log"].get("findings", ()), *entry["log"].get("repaired", ())]
    if doubts and not unfit and (entry["status"] == "lost" or conclusion == "doubtful"):
        first = f"{first} The log may be at fault: {doubts[0]}."
    unmapped = "" if kind == "failed" or conclusion else "The map was not evaluated."
    parts = (first, _path_sentence(figures), unmapped)
    return Verdict(kind, " ".join(part for part in parts if part), reasons, conclusion)


def conclude_log(entry: Entry) -> tuple[Conclusion, str]:
    """Return the conclusion on a mapped log without truth, and the reason in words."""
    quality, fault = entry.get("quality", {}), entry["reason"] or entry["log"].get("unfit")
    own, gap = quality.get("revisit_residual"), quality.get("longest_gap") or 0.0
    second = quality.get("second") or {}
    other = second.get("revisit_residual")
    better = other is not None and other < BETTER * (AGREEING if own is None else own)
    conclusion: Conclusion = "doubtful" if fault or (own or 0.0) > AGREEING else "probably right"
    clauses = [fault] if fault else []
    if not fault and (own is None or gap > MAX_GAP):
        conclusion = "doubtful" if own is None and better else "cannot be checked"
        nothing = (
            "it passes no place twice" if quality.get("pass_residual") else "it has no level planar scans"
        )
        clauses.append(nothing if own is None else f"{gap:.0f} m of its path are without a scan")
    if own is not None and not (fault and fault == disagreement(own)):
        clauses.append(f"its walls agree {_up_to(own, AGREEING)}")
    if other is not None:
        agreed = _up_to(other, min((own or 1.0) / BETTER, AGREEING))
        clauses.append(f"{second['mapper']}'s {'walls agree ' if own is None else ''}{agreed}")
        clauses[-2:] = [", ".join(clauses[-2:])]
    if second.get("difference") is not None:
        clauses.append(f"the two paths differ by {second['difference']:.2f} m")
    if better:
        clauses.append(f"{second['command']} may give the better path")
    return conclusion, "; ".join(clauses)


def _up_to(residual: float, most: float) -> str:
    return f"{'only ' if residual > most else ''}to {residual:.2f} m"


def class_counts(kinds: Iterable[str]) -> str:
    """Return classes of verdicts with their numbers, if several, the most frequent first."""
    counts = Counter(kinds)
    if (total := counts.total()) == 1:
        return next(iter(counts))
    return ", ".join(f"{kind} ({count} of {total})" for kind, count in counts.most_common())


def run_figures(entry: Entry) -> VerdictFigures:
    """Return the figures of a run's record that decide its verdict."""
    driver = value_at(entry, "config.driver") or ""
    return VerdictFigures(
        status=entry["status"],
        has_reference=True,
        uses_estimate=driver.partition(":")[0] in (FRONTIER, CLIENT),
        robot_lengths=value_at(entry, "trajectory.robot_lengths"),
        error=value_at(entry, "trajectory.ate_rmse"),
        odometry_error=value_at(entry, "trajectory.odometry_ate_rmse"),
        distance=value_at(entry, "trajectory.length"),
        occupied=value_at(entry, "map.occupied_cells"),
        f1_aligned=value_at(entry, "map.f1_aligned"),
        false_occupied=value_at(entry, "map.false_occupied_aligned"),
        reference_false_occupied=value_at(entry, "map.reference_false_occupied"),
        elevation_rmse=value_at(entry, "map.elevation_rmse_aligned"),
        reference_elevation_rmse=value_at(entry, "map.reference_elevation_rmse"),
        elevation_seen=value_at(entry, "map.elevation_seen"),
    )


def log_figures(entry: Entry) -> VerdictFigures:
    """Return the figures of a mapped log's record: of the reference, else of the relations."""
    error = value_at(entry, "accuracy.reference.ate_rmse")
    odometry = value_at(entry, "odometry.reference.ate_rmse")
    distance = value_at(entry, "log.odometry_length") or value_at(entry, "trajectory.length")
    if error is None:
        error = value_at(entry, "accuracy.relations.translation_mean")
        odometry = value_at(entry, "odometry.relations.translation_mean")
        distance = None  # relations do not grow with the distance
    return VerdictFigures(
        status=entry["status"],
        error=error,
        odometry_error=odometry,
        distance=distance,
        occupied=value_at(entry, "map.occupied"),
    )


def cause_of(kind: VerdictClass, entry: Entry) -> str:
    """Return why a run ended early, or that scans see no walls; else empty."""
    ended = entry["status"] not in ("ok", "wall limit")
    if ended and kind in ("failed", "not evaluated", "loses its way"):
        return str(entry["reason"] or entry["status"])
    if kind not in ("adds nothing", "loses its way") or value_at(entry, "scans.walls_median") != 0:
        return ""
    seen = "no walls" if value_at(entry, "scans.returns_median") else "nothing"
    return f"at least half of its scans see {seen} within {value_at(entry, 'scans.range_max'):g} m"


def _path_sentence(figures: VerdictFigures) -> str:
    """Compare the path with the odometry's."""
    if figures.error is None:
        return ""
    driven = "" if figures.distance is None else f" after {DRIVEN.text(figures.distance)}"
    error = f"Its path error is {ERROR.text(figures.error)}{driven}"
    if figures.odometry_error is None:
        return f"{error}; there is no odometry to compare with."
    worse = "worse than " if is_worse(figures.error, figures.odometry_error) else ""
    return f"{error}, {worse}the odometry's {ODOMETRY_ERROR.text(figures.odometry_error)}."


def _report_sentence(entry: Entry, *, lost: bool) -> str:
    """Return whether the method and the watch reported its loss, and how often it was wrong."""
    failure: Entry = value_at(entry, "trajectory.failure") or {}
    clauses, false = list[str](), value_at(failure, "mapper.false")
    if lost and failure.get("onset") is not None:
        own, watch = value_at(failure, "mapper.delay"), value_at(failure, "watch.delay")
        clauses.append("It did not notice." if own is None else f"It said so {_moment(own)}.")
        if own is None and watch is not None:
            clauses.append(f"The watch on its poses gave an alarm {_moment(watch)}.")
    if false:
        times = "once" if false == 1 else f"{false} times"
        clauses.append(f"It reported itself lost {times} without being lost.")
    return " ".join(clauses)


def _moment(delay: float) -> str:
    """Return the time of a report, seconds after the onset of a failure, in words."""
    return f"after {delay:.1f} s" if delay >= 0 else f"{-delay:.1f} s before"


def _map_sentence(figures: VerdictFigures, limits: VerdictLimits) -> str:
    """Return the quality of the map, or that it was not evaluated.

    Where the true poses give as many false walls or heights, the scans are at fault.
    """
    if figures.occupied == 0:
        return "Its map has no occupied cells."
    agree, false = figures.f1_aligned, figures.false_occupied
    off, seen = figures.elevation_rmse, figures.elevation_seen
    if agree is not None:
        kind, clauses = "map", [f"{AGREE.text(agree)} of the walls agree"]
        clauses += [] if false is None else [f"{FALSE.text(false)} are false"]
    else:
        kind, clauses = "elevation map", [] if off is None else [f"its error is {ELEVATION.text(off)}"]
        clauses += [] if seen is None else [f"{SEEN.text(seen)} of the visible ground is seen"]
    poor, compared = _poor_map(figures, limits), agree is not None or off is not None
    if not clauses or not (poor or compared):
        return "The map was not evaluated."
    exact = (false or 0.0) <= limits.false_occupied and (off or 0.0) <= limits.elevation_rmse
    quality = "not usable" if poor else "right" if exact else "as good as its scans allow"
    return f"Its {kind} is {quality}: {', '.join(clauses)}."


def extent_sentences(entry: Entry) -> str:
    """Return the evaluated part of a larger world, and samples too far apart."""
    window, whole = value_at(entry, "world.window"), value_at(entry, "world.whole_size")
    spacing, length = value_at(entry, "world.sample_spacing"), value_at(entry, "world.robot_length")
    clauses = []
    if window is not None:
        of = "" if whole is None else f" of {_meters(max(whole))}"
        clauses.append(f"Evaluated on a window of {_meters(window[2])}{of}.")
    if spacing is not None and length is not None and spacing > length:
        clauses.append(
            f"The source's samples are {spacing:.3g} m apart: they do not resolve a robot of {length:.2g} m."
        )
    if entry["status"] == "wall limit":
        clauses.append("The wall limit ended the drive early.")
    return " ".join(clauses)


def _meters(length: float) -> str:
    """Return a length in meters or kilometers."""
    return f"{length / 1000:.3g} km" if length >= 1000 else f"{length:.3g} m"


def read_limits(path: Path | None) -> tuple[VerdictLimits, frozenset[str]]:
    """Read limits of verdicts, and the classes that pass in addition to `works`.

    The YAML file has fields of `VerdictLimits`, and `accept`, a list of classes; None = the defaults.
    """
    if path is None:
        return LIMITS, frozenset()
    try:
        entry = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise ConfigError(f"{path}: cannot be read as YAML: {reason_of(error)}") from error
    legal = ", ".join((*(field.name for field in fields(VerdictLimits)), "accept"))
    if not isinstance(entry, dict):
        raise ConfigError(f"{path}: must have fields ({legal}), got {entry!r}")
    accept = entry.pop("accept", [])
    if not isinstance(accept, list) or not set(map(str, accept)) <= set(ACCEPTABLE):
        raise ConfigError(f"{path}: accept must be a list of {', '.join(ACCEPTABLE)}, got {accept!r}")
    for name, value in entry.items():
        if name not in vars(LIMITS):
            raise ConfigError(f"{path}: unknown limit {name!r}; legal: {legal}")
        within("[0, 1e9]")(value, f"{path}: {name}")
    return VerdictLimits(**entry), frozenset(accept)
