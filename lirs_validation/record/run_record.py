"""The run record: config, seed, versions, machine and every figure; JSON, enough to run it again."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lirs_envs.lidar.casters import Rays, check_rays
from lirs_validation.record.provenance import machine, versions
from lirs_wct.contact.contact_parts import CONTACT_GEOMETRIES, ContactGeometry
from lirs_wct.errors import ConfigError, SourceError, unknown_name
from lirs_wct.files import atomic_write
from lirs_wct.sources.options import BuildOptions

SCHEMA = 2

Status = Literal["ok", "wall limit", "tipped", "stuck", "off world", "diverged", "lost", "error", "timeout"]
SOUND: tuple[Status, ...] = ("ok", "wall limit")
"""A run that ended so did not fail: it drove its time, or as much of it as it was allowed."""


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """What to run.

    Attributes:
        source: a bundled world's name, a built folder, a picture or a map YAML.
        robot: name of a robot.
        mapper: name of a mapper, or `module:name` of your own.
        lidar: name of an LRF preset; None = the robot's own.
        terrain: what MuJoCo touches.
        rays: whose rays the LRF takes: `ours`, or `mujoco` for comparison.
        seconds: simulated time to drive.
        seed: of every random number in the run.
        wall_limit: wall seconds after which the drive is stopped; None = never.
        build: how the source becomes a world.

    Raises:
        ConfigError: seconds or the wall limit is not above 0, the seed is negative, or there is no such
            terrain or rays.
    """

    source: str
    robot: str = "husky"
    mapper: str = "hector"
    lidar: str | None = None
    terrain: ContactGeometry = "hfield"
    rays: Rays = "ours"
    seconds: float = 120.0
    seed: int = 1
    wall_limit: float | None = None
    build: BuildOptions = field(default_factory=BuildOptions)

    def __post_init__(self) -> None:
        if not 0 < self.seconds < float("inf"):
            raise ConfigError(f"seconds must be a finite number above 0, got {self.seconds:g}")
        if self.wall_limit is not None and not self.wall_limit > 0:
            raise ConfigError(f"the wall limit must be above 0 s, got {self.wall_limit:g}")
        if self.seed < 0:
            raise ConfigError(f"seed must be 0 or above, got {self.seed}")
        if self.terrain not in CONTACT_GEOMETRIES:
            raise unknown_name("terrain for MuJoCo", self.terrain, CONTACT_GEOMETRIES)
        check_rays(self.rays)

    @property
    def digest(self) -> str:
        """Eight hex digits that tell this experiment from others.

        The wall limit is left out: it says how long one waits, not what is tried.
        """
        entry = asdict(self) | {"seconds": float(self.seconds)}
        del entry["wall_limit"]
        text = json.dumps(entry, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:8]


def run_name(config: RunConfig, world: str) -> str:
    """Return the name of the run's folder; of a mapper's `module:name` only the name."""
    mapper = config.mapper.rpartition(":")[2]
    return f"{world}-{config.robot}-{mapper}-s{config.seed}-{config.digest}"


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """What came of a run; the groups of figures mean what the design's definitions say.

    A run that came to nothing (`error`, `timeout`) has empty groups.

    Attributes:
        world: name, kind, size, relief, contact grid, scale, window.
        status: `ok`, or how it ended before its time; `reason` says it in words.
        rtf: mean, std, min, parts, physics_only, series, concurrent, extrapolated.
        trajectory: ate_rmse, ate_unaligned, length, final drift, ...
        map: f1, iou, f1_input, false_occupied, ...
        collisions: max_penetration, ...
        mapper: scans received, used, skipped, milliseconds a scan.
        cost: cpu_seconds of the drive, peak_memory of the process (bytes), compile_seconds, scans_dropped.
    """

    config: RunConfig
    world: dict[str, Any]
    status: Status
    reason: str = ""
    rtf: dict[str, Any] = field(default_factory=dict)
    trajectory: dict[str, Any] = field(default_factory=dict)
    map: dict[str, Any] = field(default_factory=dict)
    collisions: dict[str, Any] = field(default_factory=dict)
    mapper: dict[str, Any] = field(default_factory=dict)
    cost: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=versions)
    machine: dict[str, Any] = field(default_factory=machine)

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return run_name(self.config, self.world["name"])

    def to_json(self) -> str:
        """Return the record as JSON; figures that do not exist are null."""
        entry = {"schema": SCHEMA, "seed": self.config.seed, "name": self.name} | asdict(self)
        return json.dumps(entry, indent=1, default=plain, allow_nan=False) + "\n"

    def save(self, folder: Path) -> None:
        """Write `record.json`.

        Raises:
            OutputError: the folder cannot be written.
        """
        with atomic_write(folder / "record.json") as path:
            path.write_text(self.to_json(), encoding="utf-8")


def read_record(folder: Path) -> dict[str, Any]:
    """Read a run's `record.json` as nested dicts.

    Raises:
        SourceError: missing, damaged or of another schema.
    """
    path = folder / "record.json"
    try:
        entry: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        schema = entry["schema"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SourceError(f"{path}: not a run's record, or damaged ({type(error).__name__})") from error
    if schema != SCHEMA:
        raise SourceError(f"{path}: schema {schema} is not the one this version reads ({SCHEMA})")
    return entry


def plain(value: Any) -> Any:
    """Return what JSON has a word for, of what it has none for."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"a record holds numbers, words and lists, got {type(value).__name__}")
