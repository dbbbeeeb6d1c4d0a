"""Record of a mapped log: options and results, as JSON and text."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from lirs_validation.config import MapConfig
from lirs_validation.record.metric_catalog import WORSE, is_worse
from lirs_validation.record.run_record import RECORD, machine, plain, versions
from lirs_validation.record.verdict import DRIVEN, Verdict, judge_log
from lirs_wct.files import write_json
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.geometry import OccupancyGrid

SCHEMA = 2
KIND = "map of a log"
"""Distinguishes these records from those of runs."""
MAX_REASONS = 8
"""Reasons for skipping that are listed one by one."""
WHEELS = (("distance", "wheels:", "too long", "too short"), ("turn", "turns", "too far", "not far enough"))
"""Scale errors in the record, and their words."""
KNOWN = 0.025
"""Margin from which on a scale error is not known."""


@dataclass(frozen=True, kw_only=True)
class MapRecord:
    """Result of mapping a log.

    Attributes:
        name: Name of the folder.
        status: `lost` where the mapper lost its place or walls seen again differ, `incomplete` where the
            trajectory leaves out scans; `reason` says when, and how many.
        log: scans, beams, laser, seconds, distance by odometry, skipped, left_out (scans), late, repaired,
            inertial_readings, findings (deviations), unfit (the one that spoils a map; empty without), and of
            the stamps how many went back, were repeated and were moved, and by how much at most.
        map: cells, resolution, meters, occupied cells, square meters known.
        trajectory: poses, length, the share of the scans that has a pose (scan_coverage), and when the watch
            on the poses gave an alarm (alarms, seconds since the first scan; null where scans are too rare).
        mapper: scans received, used, skipped, lost, milliseconds, bytes of its maps, its own counts.
        accuracy: `relations` (relative-pose constraints) and `reference`, null where not given.
        quality: figures without truth: revisit_residual, pass_residual, longest_gap (meters)
            and revisited (share); absent of scans that are not level. `second`: another mapper, its command,
            the difference to its path and its revisit_residual (meters); null where not compared.
        odometry: accuracy of the raw odometry alone, and `scale`, relative errors of its distance and turn
            against the path of a planar method, with 95 % margins; empty where the log has none.
        cost: seconds for reading, compiling and mapping; processor time; peak memory in bytes.
    """

    name: str
    config: MapConfig
    status: Literal["ok", "lost", "incomplete"]
    reason: str = ""
    log: dict[str, Any]
    map: dict[str, Any]
    trajectory: dict[str, Any]
    mapper: dict[str, Any]
    accuracy: dict[str, Any]
    cost: dict[str, Any]
    quality: dict[str, Any] = field(default_factory=dict)
    odometry: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=versions)
    machine: dict[str, Any] = field(default_factory=machine)

    @cached_property
    def verdict(self) -> Verdict:
        """Class, sentence and reasons of the result."""
        return judge_log(asdict(self))

    @property
    def wheels(self) -> str:
        """Scale errors of the odometry in words; empty where the path does not tell them."""
        scale, texts = self.odometry.get("scale", {}), list[str]()
        for key, lead, more, less in WHEELS if scale and self.status == "ok" else ():
            error, margin = scale[key] or (0.0, math.inf)
            text = f"{100 * abs(error):.1f} ± {100 * margin:.1f} % {more if error > 0 else less}"
            texts.append(f"{lead} {text if margin < KNOWN else 'not known, the drive is too short'}")
        return "; ".join(texts)

    def save(self, folder: Path) -> None:
        """Write `record.json`."""
        entry = {"schema": SCHEMA, "kind": KIND, "seed": self.config.seed} | asdict(self)
        write_json(folder / RECORD, entry | {"verdict": self.verdict.to_dict()}, plain)


def is_mapped_log(folder: Path) -> bool:
    """Return whether a folder holds the record of a mapped log."""
    try:
        entry = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(entry, dict) and entry.get("kind") == KIND


def describe_log(log: LaserLog) -> dict[str, Any]:
    """Return a record's description of a log."""
    first, stamps = log.scans[0] if log.scans else None, log.stamps
    return {
        "laser": log.laser,
        "scans": len(stamps),
        "beams": first and len(first.ranges),
        "fov_deg": first and math.degrees(first.angle_increment * (len(first.ranges) - 1)),
        "seconds": float(stamps[-1] - stamps[0]),
        "odometry_length": log.track.length if len(log.track) else None,
        "skipped": dict(log.skipped),
        "left_out": log.left_out,
        "late": log.late,
        "stamps": {
            "back": log.lines.back,
            "repeated": log.lines.repeated,
            "moved": log.lines.moved,
            "furthest": log.lines.furthest,
        },
        "repaired": dict(log.repaired),
    }


def describe_map(grid: OccupancyGrid) -> dict[str, Any]:
    """Return a record's description of a map."""
    rows, cols = grid.shape
    return {
        "cells": [rows, cols],
        "resolution": grid.resolution,
        "size": [cols * grid.resolution, rows * grid.resolution],
        "occupied": int(grid.occupied.sum()),
        "known_area": float(grid.known.sum()) * grid.resolution**2,
    }


def map_lines(record: MapRecord) -> list[tuple[str, str]]:
    """Return names and values of existing results, the status first."""
    log, grid, mapper, quality = record.log, record.map, record.mapper, record.quality
    width, depth = grid["size"]
    driven, alarms = log["odometry_length"], record.trajectory["alarms"]
    beams = "" if log["beams"] is None else f" of {log['beams']} beams"
    told = " (not told to the mapper)" if record.config.attitude == "none" else ""
    second = quality.get("second") or {}
    rows: list[tuple[str, str | None]] = [
        ("status", record.status),
        ("scans", f"{log['scans']}{beams} ({log['laser']})"),
        ("time", f"{log['seconds']:.0f} s"),
        ("distance by odometry", "no odometry" if driven is None else DRIVEN.text(driven)),
        ("length of the path", DRIVEN.text(record.trajectory["length"]) if driven is None else None),
        ("with attitude", f"{log['inertial_readings']} scans{told}" if record.config.imu else None),
        ("map", f"{width:.1f} x {depth:.1f} m, {grid['resolution']:g} m a cell"),
        ("known", f"{grid['known_area']:.0f} m2"),
        ("scans received, used", f"{mapper['received']}, {mapper['used']}"),
        ("scans while lost", f"{mapper['lost']}"),
        ("alarms of the watch", "too few scans a second" if alarms is None else f"{len(alarms)}"),
        ("walls seen again differ by", _meters(quality.get("revisit_residual"))),
        ("... within one pass by", _meters(quality.get("pass_residual"))),
        (f"path differs from {second.get('mapper')}'s by", _meters(second.get("difference"))),
        ("scans with a pose", f"{100 * record.trajectory['scan_coverage']:.1f} %"),
        ("ms a scan (p50, p95, max)", ", ".join(f"{mapper[f'ms_{p}']:.2f}" for p in ("p50", "p95", "max"))),
        ("mapping took", f"{record.cost['map_seconds']:.1f} s"),
        ("memory of the maps", f"{mapper['memory'] / 1e6:.0f} MB"),
    ]
    return [(name, text) for name, text in rows if text is not None] + _accuracy_lines(record)


def _meters(value: float | None) -> str | None:
    return None if value is None else f"{value:.3f} m"


def repair_lines(record: MapRecord) -> list[tuple[str, str]]:
    """Return counts of skipped and repaired parts of a log; empty without any."""
    log = record.log
    lines = [("deviation", text) for text in log["findings"]]
    lines += [("skipped", f"{count} x {why}") for why, count in _most(log["skipped"])]
    stamps = log["stamps"]
    if stamps["moved"]:
        lines.append(("stamps going back", f"{stamps['back']}, repeated {stamps['repeated']}"))
        lines.append(("stamps moved", f"{stamps['moved']}, by at most {stamps['furthest']:.2f} s"))
    lines += [("put right", f"{what} ({count})") for what, count in _most(log["repaired"])]
    for name, errors in record.accuracy.items():
        if errors is not None and errors["outside"]:
            lines.append((f"outside the log, {name}", f"{errors['outside']}"))
    return lines


def _accuracy_lines(record: MapRecord) -> list[tuple[str, str]]:
    """Return the errors of the path, those of the odometry alone beside them."""
    lines = []
    relations, reference = record.accuracy["relations"], record.accuracy["reference"]
    if relations is not None and relations["used"]:
        shift = f"{relations['translation_mean']:.3f} +- {relations['translation_std']:.3f} m"
        turn = f"{relations['rotation_mean_deg']:.2f} +- {relations['rotation_std_deg']:.2f} deg"
        lines += [(f"{relations['used']} relations", shift), ("", turn)]
        alone = record.odometry.get("relations")
        if alone is not None and alone["used"]:
            shift, turn = f"{alone['translation_mean']:.3f} m", f"{alone['rotation_mean_deg']:.2f} deg"
            lines.append(("... of the odometry", f"{shift}, {turn}"))
    if reference is not None and reference["used"]:
        lines.append((f"ATE over {reference['used']} poses", f"{reference['ate_rmse']:.3f} m"))
        alone = record.odometry.get("reference")
        if alone is not None and alone["used"]:
            lines.append(("ATE of the odometry", f"{alone['ate_rmse']:.3f} m"))
            lines += [("", WORSE)] if is_worse(reference["ate_rmse"], alone["ate_rmse"]) else []
    lines += [
        (name, "nothing within the log's time")
        for name, errors in record.accuracy.items()
        if errors is not None and not errors["used"]
    ]
    return lines


def _most(counts: Mapping[str, int]) -> list[tuple[str, int]]:
    """Return the commonest reasons, and the rest in one."""
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    if len(ordered) <= MAX_REASONS:
        return ordered
    rest = ordered[MAX_REASONS:]
    return [*ordered[:MAX_REASONS], (f"{len(rest)} other reasons", sum(count for _, count in rest))]
