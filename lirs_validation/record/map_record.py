"""What a log was mapped with and what came of it: JSON, enough to do it again."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from lirs_validation.record.provenance import machine, versions
from lirs_wct.errors import ConfigError
from lirs_wct.files import atomic_write
from lirs_wct.formats.carmen.log import CarmenLog
from lirs_wct.geometry.grid import OccupancyGrid

SCHEMA = 1
KIND = "map of a log"
"""Tells these records from those of runs."""
RESOLUTIONS = (0.01, 1.0)
"""Legal edges of a map's cell, metres: finer ones fill the memory, coarser ones hold no room."""


@dataclass(frozen=True, kw_only=True)
class MapConfig:
    """How a log is mapped.

    Attributes:
        log: path of a CARMEN log.
        mapper: name of a mapper, or `module:name` of your own.
        seed: of its random numbers.
        particles: of gmapping; None = its own number.
        resolution: edge of a cell, metres; None = the mapper's own.
        fov: field of view of the laser, degrees; None = as the log says.
        range_max: ranges from here on are no return, metres; None = as the log says.
        relations: path of relations that are known to be true.
        reference: path of a reference trajectory: TUM, or a CARMEN log of corrected poses.

    Raises:
        ConfigError: a value is not legal.
    """

    log: str
    mapper: str = "cartographer"
    seed: int = 1
    particles: int | None = None
    resolution: float | None = None
    fov: float | None = None
    range_max: float | None = None
    relations: str | None = None
    reference: str | None = None

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ConfigError(f"seed must be 0 or above, got {self.seed}")
        low, high = RESOLUTIONS
        if self.resolution is not None and not low <= self.resolution <= high:
            raise ConfigError(f"resolution must be {low:g} to {high:g} m, got {self.resolution:g}")
        if self.fov is not None and not 0 < self.fov <= 360:
            raise ConfigError(f"field of view must be above 0 and at most 360 deg, got {self.fov:g}")
        if self.range_max is not None and not 0 < self.range_max < math.inf:
            raise ConfigError(f"range max must be a finite number above 0 m, got {self.range_max:g}")

    def digest(self, content: bytes) -> str:
        """Return eight hex digits that tell this map from others.

        Args:
            content: of the log. Its path is left out, and what the map is only judged by.
        """
        entry = asdict(self) | {"log": hashlib.sha256(content).hexdigest()}
        del entry["relations"], entry["reference"]
        return hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()[:8]


@dataclass(frozen=True, kw_only=True)
class MapRecord:
    """What came of a mapped log.

    Attributes:
        name: of the folder.
        status: `lost` where the mapper did not know its place at the end.
        log: scans, beams, laser, seconds, way by odometry, skipped, late, repaired.
        map: cells, resolution, metres, occupied cells, square metres known.
        mapper: scans received, used, skipped, lost, milliseconds, bytes of its maps, its own counts.
        accuracy: `relations` and `reference`, null where not given.
        cost: seconds for reading, compiling and mapping; processor time; peak memory in bytes.
    """

    name: str
    config: MapConfig
    status: Literal["ok", "lost"]
    log: dict[str, Any]
    map: dict[str, Any]
    mapper: dict[str, Any]
    accuracy: dict[str, Any]
    cost: dict[str, Any]
    versions: dict[str, str] = field(default_factory=versions)
    machine: dict[str, Any] = field(default_factory=machine)

    def to_json(self) -> str:
        """Return the record as JSON; figures that do not exist are null."""
        # The run's record knows the whole simulator, which the first scan should not wait for.
        from lirs_validation.record.run_record import plain

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
    """Tell whether a folder holds the record of a mapped log."""
    try:
        entry = json.loads((folder / "record.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(entry, dict) and entry.get("kind") == KIND


def log_figures(log: CarmenLog) -> dict[str, Any]:
    """Return what a record tells of a log."""
    first, stamps = log.scans[0], log.stamps
    return {
        "laser": log.laser,
        "scans": len(log.scans),
        "beams": len(first.ranges),
        "fov_deg": math.degrees(first.angle_increment * (len(first.ranges) - 1)),
        "seconds": float(stamps[-1] - stamps[0]),
        "odometry_length": log.track.length if len(log.track) else None,
        "skipped": dict(log.skipped),
        "late": log.late,
        "repaired": dict(log.repaired),
    }


def map_figures(grid: OccupancyGrid) -> dict[str, Any]:
    """Return what a record tells of a map."""
    rows, cols = grid.shape
    return {
        "cells": [rows, cols],
        "resolution": grid.resolution,
        "size": [cols * grid.resolution, rows * grid.resolution],
        "occupied": int(grid.occupied.sum()),
        "known_area": float(grid.known.sum()) * grid.resolution**2,
    }
