"""The run record: config, seed, versions, machine and every figure; JSON, enough to run it again."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import platform
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lirs_wct.contact_parts import TERRAINS, Terrain
from lirs_wct.errors import ConfigError, SourceError, unknown_name
from lirs_wct.files import atomic_write
from lirs_wct.options import BuildOptions

SCHEMA = 1
PACKAGES = ("lirs-wct", "mujoco", "gymnasium", "numpy", "scipy", "numba")

Status = Literal["ok", "tipped", "stuck", "off world", "diverged", "lost"]


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """What to run.

    Attributes:
        source: a bundled world's name, a built folder, a picture or a map YAML.
        robot: name of a robot.
        mapper: name of a mapper.
        lidar: name of an LRF preset; None = the robot's own.
        terrain: what MuJoCo touches.
        seconds: simulated time to drive.
        seed: of every random number in the run.
        build: how the source becomes a world.

    Raises:
        ConfigError: seconds is not above 0, the seed is negative, or there is no such terrain.
    """

    source: str
    robot: str = "husky"
    mapper: str = "hector"
    lidar: str | None = None
    terrain: Terrain = "hfield"
    seconds: float = 120.0
    seed: int = 1
    build: BuildOptions = field(default_factory=BuildOptions)

    def __post_init__(self) -> None:
        if not 0 < self.seconds < float("inf"):
            raise ConfigError(f"seconds must be a finite number above 0, got {self.seconds:g}")
        if self.seed < 0:
            raise ConfigError(f"seed must be 0 or above, got {self.seed}")
        if self.terrain not in TERRAINS:
            raise unknown_name("terrain for MuJoCo", self.terrain, TERRAINS)

    @property
    def digest(self) -> str:
        """Eight hex digits that tell this config from others."""
        text = json.dumps(asdict(self), sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:8]


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """What came of a run; the groups of figures mean what the design's definitions say.

    Attributes:
        world: name, kind, size, relief, contact grid, scale, window.
        status: `ok`, or how it failed; `reason` says it in words.
        rtf: mean, std, min, parts, physics_only, series.
        trajectory: ate_rmse, ate_unaligned, length, final drift, ...
        map: f1, iou, f1_input, false_occupied, ...
        collisions: max_penetration, ...
        mapper: scans received, used, skipped, milliseconds a scan.
    """

    config: RunConfig
    world: dict[str, Any]
    status: Status
    reason: str
    rtf: dict[str, Any]
    trajectory: dict[str, Any]
    map: dict[str, Any]
    collisions: dict[str, Any]
    mapper: dict[str, Any]
    versions: dict[str, str]
    machine: dict[str, Any]

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        c = self.config
        return f"{self.world['name']}-{c.robot}-{c.mapper}-s{c.seed}-{c.digest}"

    def to_json(self) -> str:
        """Return the record as JSON; figures that do not exist are null."""
        entry = {"schema": SCHEMA, "seed": self.config.seed, "name": self.name} | asdict(self)
        return json.dumps(entry, indent=1, default=_plain, allow_nan=False) + "\n"

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


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that decide the result."""
    return {"python": platform.python_version()} | {p: importlib.metadata.version(p) for p in PACKAGES}


def machine() -> dict[str, Any]:
    """Return what the run's times depend on."""
    return {"system": platform.platform(), "processor": _processor(), "cores": os.cpu_count()}


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"a record holds numbers, words and lists, got {type(value).__name__}")


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
