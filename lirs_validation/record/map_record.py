"""What a log was mapped with and what came of it: JSON, enough to do it again."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from lirs_validation.config import MapConfig
from lirs_validation.record.provenance import machine, versions
from lirs_validation.record.run_record import plain
from lirs_wct.files import atomic_write
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.geometry.grid import OccupancyGrid

SCHEMA = 2
KIND = "map of a log"
"""Distinguishes these records from those of runs."""


@dataclass(frozen=True, kw_only=True)
class MapRecord:
    """What came of a mapped log.

    Attributes:
        name: of the folder.
        status: `lost` where the mapper lost its place or the scans contradict each other, `incomplete` where
            the trajectory leaves out scans; `reason` says when, and how many.
        log: scans, beams, laser, seconds, distance by odometry, skipped, left_out (scans), late, repaired,
            inertial_readings, and of the stamps how many went back, were repeated and were moved, and by how
            much at most.
        map: cells, resolution, meters, occupied cells, square meters known.
        trajectory: poses, the share of the scans that has one (scan_coverage), and the share that contradicts
            other passes (contradicted; null where not tested).
        mapper: scans received, used, skipped, lost, milliseconds, bytes of its maps, its own counts.
        accuracy: `relations` (relative-pose constraints) and `reference`, null where not given.
        odometry: the same of the raw odometry alone; empty where the log has none.
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
    odometry: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=versions)
    machine: dict[str, Any] = field(default_factory=machine)

    def to_json(self) -> str:
        """Return the record as JSON; values that do not exist are null."""
        entry = {"schema": SCHEMA, "kind": KIND, "seed": self.config.seed} | asdict(self)
        return json.dumps(entry, indent=1, default=plain, allow_nan=False) + "\n"

    def save(self, folder: Path) -> None:
        """Write `record.json`.

        Raises:
            OutputError: the folder cannot be written.
        """
        with atomic_write(folder / "record.json") as path:
            path.write_text(self.to_json(), encoding="utf-8")


def is_mapped_log(folder: Path) -> bool:
    """Return whether a folder holds the record of a mapped log."""
    try:
        entry = json.loads((folder / "record.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(entry, dict) and entry.get("kind") == KIND


def describe_log(log: LaserLog) -> dict[str, Any]:
    """Return what a record holds of a log."""
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
    """Return what a record holds of a map."""
    rows, cols = grid.shape
    return {
        "cells": [rows, cols],
        "resolution": grid.resolution,
        "size": [cols * grid.resolution, rows * grid.resolution],
        "occupied": int(grid.occupied.sum()),
        "known_area": float(grid.known.sum()) * grid.resolution**2,
    }
