"""Verdict on a record: class, one sentence for the user, and the figures that decided."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import yaml

from lirs_validation.config import CLIENT, FRONTIER
from lirs_validation.metrics.verdict import (
    LIMITS,
    Reason,
    VerdictClass,
    VerdictFigures,
    VerdictLimits,
    classify,
    is_worse,
    revisit_agreement,
)
from lirs_validation.record.formatting import Entry, text_at, value_at
from lirs_wct.errors import ConfigError, reason_of
from slam_baselines.mapper import short_name

LEADS: dict[VerdictClass, str] = {
    "failed": "{who} gives no result on {world}",
    "no reference": "{who} cannot be judged on {world}: no true trajectory or relations are given",
    "not evaluated": "{who} was not evaluated on {world}",
    "loses its way": "{who} loses its way on {world}",
    "adds nothing": "{who} adds nothing to the odometry on {world}",
    "path only": "{who} finds its path on {world}, but its map is not usable",
    "works": "{who} works on {world}",
}
"""Beginning of the sentence by class."""
ACCEPTABLE = ("no reference", "path only")
"""Classes that a limits file may accept in addition to `works`."""


@dataclass(frozen=True)
class Verdict:
    """Verdict on a run, a mapped log or a score.

    Attributes:
        kind: class, from `failed` to `works`.
        sentence: conclusion for the user, with what was evaluated.
        reasons: figures that decided; empty if the method works.
    """

    kind: VerdictClass
    sentence: str
    reasons: tuple[Reason, ...] = ()

    def __str__(self) -> str:
        return self.sentence

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as a record stores it."""
        reasons = [asdict(reason) for reason in self.reasons]
        return {"class": self.kind, "sentence": self.sentence, "reasons": reasons}


def judge(entry: Entry, limits: VerdictLimits = LIMITS, method: str = "") -> Verdict:
    """Return the verdict on a run's record.

    Args:
        entry: the record as nested dicts.
        limits: between the classes.
        method: name in the sentence; empty = the run's mapper and robot.
    """
    figures = run_figures(entry)
    kind, reasons = classify(figures, limits)
    mapper, robot = text_at(entry, "config.mapper"), text_at(entry, "config.robot")
    who = method or f"{short_name(mapper)} on {robot}"
    lead = LEADS[kind].format(who=who, world=entry["world"]["name"])
    unjudged = kind in ("failed", "not evaluated")
    results = () if unjudged else (_path_sentence(figures), _map_sentence(figures))
    parts = (_lead(lead, kind, entry, limits), *results, extent_sentences(entry))
    return Verdict(kind, " ".join(part for part in parts if part), reasons)


def judge_log(entry: Entry, limits: VerdictLimits = LIMITS) -> Verdict:
    """Return the verdict on the record of a mapped log, given as nested dicts."""
    figures = log_figures(entry)
    kind, reasons = classify(figures, limits)
    log = Path(entry["config"].get("log", entry["name"])).name
    lead = LEADS[kind].format(who=short_name(entry["config"]["mapper"]), world=log)
    reason = entry["reason"]
    first = f"{lead}: {reason}." if reason and kind != "no reference" else f"{lead}."
    unfit = entry["log"].get("unfit") if kind != "works" else ""
    if unfit:  # the log is at fault, and not the mapper
        first, reason = f"{log} is not fit for planar mapping: {unfit}.", ""
    doubts = [*entry["log"].get("findings", ()), *entry["log"].get("repaired", ())]
    if doubts and not unfit and entry["status"] == "lost":
        first = f"{first} The log may be at fault: {doubts[0]}."
    told = f"The mapper is lost: {reason}." if reason and kind == "no reference" else ""
    unmapped = "" if kind == "failed" else "The map was not evaluated."
    quality = _quality_sentence(entry.get("quality", {})) if kind == "no reference" else ""
    parts = (first, told, quality, _path_sentence(figures), "" if quality else unmapped)
    return Verdict(kind, " ".join(part for part in parts if part), reasons)


def _quality_sentence(quality: Entry) -> str:
    """Return a mapped log's quality by figures that need no truth; empty without any."""
    residual, second = quality.get("revisit_residual"), quality.get("second") or {}
    clauses = []
    if residual is not None:
        clauses.append(f"walls seen again lie {residual:.2f} m apart ({revisit_agreement(residual)})")
    elif quality.get("wall_thickness") is not None:
        thick = f"walls are {quality['wall_thickness']:.3f} m thick"
        clauses.append(f"no place is seen by two passes, so that its path cannot be checked; {thick}")
    if second.get("difference") is not None:
        apart = second["revisit_residual"]
        own = "" if apart is None else f" (walls {apart:.2f} m apart)"
        clauses.append(f"its path differs from {second['mapper']}'s{own} by {second['difference']:.2f} m")
    told = "; ".join(clauses)
    return f"{told[0].upper()}{told[1:]}." if told else ""


def class_counts(verdicts: Iterable[Verdict]) -> str:
    """Return the classes of several verdicts with their numbers, the most frequent first."""
    counts = Counter(verdict.kind for verdict in verdicts)
    return ", ".join(f"{kind} ({count} of {counts.total()})" for kind, count in counts.most_common())


def run_figures(entry: Entry) -> VerdictFigures:
    """Return the figures of a run's record that decide its verdict."""
    driver = value_at(entry, "config.driver") or ""
    robot_lengths = value_at(entry, "trajectory.robot_lengths")
    return VerdictFigures(
        status=entry["status"],
        has_reference=True,
        uses_estimate=driver.partition(":")[0] in (FRONTIER, CLIENT),
        robot_lengths=robot_lengths,
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


def _lead(lead: str, kind: VerdictClass, entry: Entry, limits: VerdictLimits) -> str:
    """Return the first sentence, with the cause where one is known."""
    cause = cause_of(kind, entry)
    if kind == "not evaluated" and not cause:
        needed = limits.robot_lengths * value_at(entry, "world.robot_length")
        length = value_at(entry, "trajectory.length")
        cause = f"it drove {length:.1f} m, at least {needed:.1f} m are needed (--seconds)"
    return f"{lead}: {cause.rstrip('.')}." if cause else f"{lead}."


def cause_of(kind: VerdictClass, entry: Entry) -> str:
    """Return why a run ended early, or that its scans see no walls; empty if neither."""
    ended = entry["status"] not in ("ok", "wall limit")
    if ended and kind in ("failed", "not evaluated", "loses its way"):
        return str(entry["reason"] or entry["status"])
    return _few_walls(entry) if kind in ("adds nothing", "loses its way") else ""


def _few_walls(entry: Entry) -> str:
    """Return a clause on scans without walls; empty if they see some."""
    walls = value_at(entry, "scans.walls_median")
    if walls is None or walls > 0:
        return ""
    returns = value_at(entry, "scans.returns_median")
    seen, reach = "no walls" if returns else "nothing", value_at(entry, "scans.range_max")
    return f"at least half of its scans see {seen} within {reach:g} m"


def _path_sentence(figures: VerdictFigures) -> str:
    """Compare the path with the odometry's."""
    if figures.error is None:
        return ""
    driven = "" if figures.distance is None else f" after {figures.distance:.0f} m"
    error = f"Its path error is {figures.error:.3f} m{driven}"
    if figures.odometry_error is None:
        return f"{error}; there is no odometry to compare with."
    worse = "worse than " if is_worse(figures.error, figures.odometry_error) else ""
    return f"{error}, {worse}the odometry's {figures.odometry_error:.3f} m."


def _map_sentence(figures: VerdictFigures) -> str:
    """Return the quality of the map, or that it was not evaluated."""
    if figures.occupied == 0:
        return "Its map has no occupied cells."
    if figures.f1_aligned is not None:
        false, reference = figures.false_occupied, figures.reference_false_occupied
        ghosts = "" if false is None else f"; {100 * false:.0f} % of its occupied cells are false"
        own = "" if not ghosts or reference is None else f" ({100 * reference:.0f} % at the true poses)"
        quality = f"F1 {figures.f1_aligned:.2f}{ghosts}{own}"
        return f"After alignment, its map agrees with the true one by {quality}."
    if figures.elevation_rmse is not None:
        seen = f", {100 * (figures.elevation_seen or 0.0):.0f} % of the visible ground is seen"
        return f"Its elevation map is {figures.elevation_rmse:.3f} m off{seen}."
    return "The map was not evaluated."


def extent_sentences(entry: Entry) -> str:
    """Return the evaluated part of a larger world, and samples that do not resolve the robot."""
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


def read_limits(path: Path) -> tuple[VerdictLimits, frozenset[str]]:
    """Read limits of verdicts, and the classes that pass in addition to `works`.

    The YAML file has fields of `VerdictLimits`, and `accept`, a list of classes.

    Raises:
        ConfigError: the file cannot be read, or a name or value is not legal.
    """
    try:
        entry = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise ConfigError(f"{path}: cannot be read as YAML: {reason_of(error)}") from error
    names = [field.name for field in fields(VerdictLimits)]
    if not isinstance(entry, dict):
        raise ConfigError(f"{path}: must have fields ({', '.join((*names, 'accept'))}), got {entry!r}")
    accept = entry.pop("accept", [])
    if not isinstance(accept, list) or not set(map(str, accept)) <= set(ACCEPTABLE):
        raise ConfigError(f"{path}: accept must be a list of {', '.join(ACCEPTABLE)}, got {accept!r}")
    for name, value in entry.items():
        if name not in names:
            raise ConfigError(f"{path}: unknown limit {name!r}; legal: {', '.join((*names, 'accept'))}")
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not 0 <= value <= sys.float_info.max
        ):
            raise ConfigError(f"{path}: {name} must be a finite number, at least 0, got {value!r}")
    return VerdictLimits(**entry), frozenset(accept)
