"""The record of a mapped log as text, for the terminal and for the picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lirs_validation.record.map_record import MapRecord
from lirs_validation.record.odometry import WORSE, is_worse

MANY = 8
"""Reasons for skipping that are listed one by one."""


def map_lines(record: MapRecord) -> list[tuple[str, str]]:
    """Return names and values of what exists, the status first."""
    log, grid, mapper, cost = record.log, record.map, record.mapper, record.cost
    width, depth = grid["size"]
    driven = log["odometry_length"]
    beams = "" if log["beams"] is None else f" of {log['beams']} beams"
    lines = [
        ("status", record.status),
        ("scans", f"{log['scans']}{beams} ({log['laser']})"),
        ("time", f"{log['seconds']:.0f} s"),
        ("distance by odometry", "no odometry" if driven is None else f"{driven:.0f} m"),
        *_inertial_line(record),
        ("map", f"{width:.1f} x {depth:.1f} m, {grid['resolution']:g} m a cell"),
        ("known", f"{grid['known_area']:.0f} m2"),
        ("scans received, used", f"{mapper['received']}, {mapper['used']}"),
        ("scans while lost", f"{mapper['lost']}"),
        *_contradiction_line(record),
        ("scans with a pose", f"{100 * record.trajectory['scan_coverage']:.1f} %"),
        (
            "ms a scan (p50, p95, max)",
            ", ".join(f"{mapper[f'ms_{p}']:.2f}" for p in ("p50", "p95", "max")),
        ),
        ("mapping took", f"{cost['map_seconds']:.1f} s"),
        ("memory of the maps", f"{mapper['memory'] / 1e6:.0f} MB"),
    ]
    return lines + _accuracy_lines(record)


def repair_lines(record: MapRecord) -> list[tuple[str, str]]:
    """Return what of the log was left out or put right, and how often; nothing where it was whole."""
    log = record.log
    lines = [("skipped", f"{count} x {why}") for why, count in _most(log["skipped"])]
    stamps = log["stamps"]
    if stamps["moved"]:
        lines.append(("stamps going back", f"{stamps['back']}, repeated {stamps['repeated']}"))
        lines.append(("stamps moved", f"{stamps['moved']}, by at most {stamps['furthest']:.2f} s"))
    lines += [("put right", f"{count} x {what}") for what, count in _most(log["repaired"])]
    for name, errors in record.accuracy.items():
        if errors is not None and errors["outside"]:
            lines.append((f"outside the log, {name}", f"{errors['outside']}"))
    return lines


def _contradiction_line(record: MapRecord) -> list[tuple[str, str]]:
    """Return the share of scans that contradict other passes, where the scans are level."""
    share = record.trajectory["contradicted"]
    return [] if share is None else [("scans in contradiction", f"{100 * share:.1f} %")]


def _inertial_line(record: MapRecord) -> list[tuple[str, str]]:
    """Return at how many scans the attitude is known, where a file of readings was given."""
    if record.config.imu is None:
        return []
    told = " (not told to the mapper)" if record.config.attitude == "none" else ""
    return [("with attitude", f"{record.log['inertial_readings']} scans{told}")]


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
        lines += _odometry_lines(reference["ate_rmse"], record.odometry.get("reference"))
    lines += [
        (name, "nothing within the log's time")
        for name, errors in record.accuracy.items()
        if errors is not None and not errors["used"]
    ]
    return lines


def _odometry_lines(ate: float, alone: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """Return the odometry's ATE, and whether the mapper's is the worse."""
    if alone is None or not alone["used"]:
        return []
    lines = [("ATE of the odometry", f"{alone['ate_rmse']:.3f} m")]
    return [*lines, ("", WORSE)] if is_worse(ate, alone["ate_rmse"]) else lines


def _most(counts: Mapping[str, int]) -> list[tuple[str, int]]:
    """Return the commonest reasons, and the rest in one."""
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    if len(ordered) <= MANY:
        return ordered
    rest = ordered[MANY:]
    return [*ordered[:MANY], (f"{len(rest)} other reasons", sum(count for _, count in rest))]
