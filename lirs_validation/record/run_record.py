"""Run record: config, metrics and provenance, as JSON by a schema; groups of runs; staleness."""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import cache, cached_property, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from lirs_validation.config import RUN_AXES, RunConfig, run_name
from lirs_validation.record.metric_catalog import Entry, picture_lines
from lirs_validation.record.verdict import Verdict, judge
from lirs_wct.display import html_table
from lirs_wct.errors import ConfigError, SourceError, reason_of
from lirs_wct.files import MANIFEST, digest, read_manifest, write_json
from lirs_wct.formats.map_server import read_metadata
from lirs_wct.option import declared, defaults
from lirs_wct.sources.source import SourceKind, find_source

if TYPE_CHECKING:
    from jsonschema import Draft202012Validator

SCHEMA = 3
RECORD = "record.json"
BAG = "bag"
"""Stem of the file of a run's bag, whose folder is the run's."""
PACKAGES = ("lirs-wct", "mujoco", "gymnasium", "numpy", "scipy", "numba")
OWN_PACKAGES = ("lirs_wct", "lirs_envs", "slam_baselines", "lirs_validation", "lirs_extensions")
CODE_FILES = (".py", ".xml", ".npz")
"""Endings of the files that decide a result."""
FIELDS = ("world", *(name for name in RUN_AXES if name != "seed"), "seconds")
"""Fields of a group: the world's name, and the options of its runs."""
DEFAULT_OPTIONS = defaults(RunConfig)

Status = Literal[
    "ok", "wall limit", "tipped", "stuck", "off world", "diverged", "lost", "incomplete", "error", "timeout"
]
SUCCEEDED: tuple[Status, ...] = ("ok", "wall limit")
"""A run that ended so did not fail: it drove its time, or as much of it as it was allowed."""


def succeeded(entry: Mapping[str, Any]) -> bool:
    """Whether a run, its record as nested dicts, did not fail."""
    return entry["status"] in SUCCEEDED


def versions() -> dict[str, str]:
    """Return the versions of Python, relevant packages and our code (`code`)."""
    packages = {name: importlib.metadata.version(name) for name in PACKAGES}
    return {"python": platform.python_version()} | packages | {"code": code()}


@cache
def code() -> str:
    """Return eight hex digits that tell states of our code, robots and weights apart."""
    state = hashlib.sha256()
    for package in OWN_PACKAGES:
        spec = importlib.util.find_spec(package)
        for folder in (spec.submodule_search_locations or ()) if spec else ():
            for path in sorted(path for path in Path(folder).rglob("*") if path.suffix in CODE_FILES):
                state.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return state.hexdigest()[:8]


def machine() -> dict[str, Any]:
    """Return the machine's properties, on which a run's times depend."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    processor = names[0] if names else platform.processor() or platform.machine()
    return {"system": platform.platform(), "processor": processor, "cores": os.cpu_count()}


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """Result of a run.

    A run that came to nothing (`error`, `timeout`) has no metrics.

    Attributes:
        world: name, kind, size, relief, contact grid, scale, window, files that it was made from.
        status: `ok`, or how it ended before its time; `reason` says why.
        rtf: mean, std, min, parts, physics_reference, timestep, series, ...
        trajectory: ate_rmse, ate_unaligned, length, final drift, scan_coverage, ...
        map: f1, f1_aligned, iou, f1_input, false_occupied, ...
        collisions: max_penetration, ...
        scans: beams, range_max, and medians of returns and of hits on walls per scan (of planar mappers);
            imu_rate, inertial readings a second of a bag or of a mapper that reads them.
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
    scans: dict[str, Any] = field(default_factory=dict)
    mapper: dict[str, Any] = field(default_factory=dict)
    cost: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=versions)
    machine: dict[str, Any] = field(default_factory=machine)

    def __repr__(self) -> str:
        return f"RunRecord({self.name!r}, {self.status})"

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return run_name(self.config, self.world["name"])

    @cached_property
    def verdict(self) -> Verdict:
        """Class, sentence and reasons of the result."""
        return judge(asdict(self))

    def to_dict(self) -> dict[str, Any]:
        """Return the record as nested dicts, as its file holds them."""
        entry = {"schema": SCHEMA, "seed": self.config.seed, "name": self.name} | asdict(self)
        return entry | {"verdict": self.verdict.to_dict()}

    def to_json(self) -> str:
        """Return the record as JSON; values that do not exist are null."""
        return json.dumps(self.to_dict(), indent=1, default=plain, allow_nan=False) + "\n"

    def save(self, folder: Path) -> None:
        """Write `record.json`."""
        write_json(folder / RECORD, self.to_dict(), plain)

    def _repr_html_(self) -> str:
        return html_table(picture_lines(self.to_dict()))


def read_record(folder: Path) -> dict[str, Any]:
    """Read a run's `record.json` as nested dicts.

    Raises:
        SourceError: missing, damaged or of another schema.
    """
    path = folder / RECORD
    try:
        entry: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        schema = entry["schema"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise SourceError(f"{path}: not a run's record, or damaged: {reason_of(error)}") from error
    if schema != SCHEMA:
        raise SourceError(f"{path}: schema {schema} is not the one this version reads ({SCHEMA})")
    return entry


def record_schema() -> dict[str, Any]:
    """Return the JSON schema of `record.json`."""
    text = files(__package__).joinpath("record.schema.json").read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


def schema_error(entry: Mapping[str, Any]) -> str | None:
    """Return the first schema violation in one line; None if valid."""
    from jsonschema.exceptions import best_match  # imported here: a new run has no record to be checked

    error = best_match(_validator().iter_errors(entry))
    if error is not None:
        place = ".".join(str(part) for part in error.absolute_path) or "record"
        return " ".join(f"{place}: {error.message}".split())[:200]
    try:
        json.dumps(entry, allow_nan=False)
    except ValueError:
        return "record: a number is not finite"
    return None


@cache
def _validator() -> Draft202012Validator:
    from jsonschema import Draft202012Validator

    return Draft202012Validator(record_schema())


@dataclass(frozen=True, order=True)
class RunGroup:
    """World and options that the runs of a group share, as values of FIELDS."""

    values: tuple[Any, ...]

    @staticmethod
    def of(entry: Entry) -> RunGroup:
        """Return the group of a record, with the robot's default lidar filled in."""
        values = {"world": entry["world"]["name"], **DEFAULT_OPTIONS, **entry["config"]}
        values |= {
            "lidar": values["lidar"] or _own_lidar(values["robot"]),
            "seconds": float(values["seconds"]),
        }
        return RunGroup(tuple(values[name] for name in FIELDS))

    def __getitem__(self, name: str) -> Any:
        return self.values[FIELDS.index(name)]

    def replaced(self, **values: Any) -> RunGroup:
        """Return the group with other values of some fields."""
        return RunGroup(tuple(values.get(name, self[name]) for name in FIELDS))

    def label(self, fields: Iterable[str] = FIELDS) -> str:
        """Return the group's name: its fields, or some of them, in one line."""
        forms = {name: option.shown for name, option in declared(RunConfig).items()}
        wanted = set(fields)
        return ", ".join(forms.get(f, "{}").format(self[f]) for f in FIELDS if f in wanted)


def unusual_fields(groups: Iterable[RunGroup]) -> tuple[str, ...]:
    """Return the axes in which a group differs from the default run."""
    different = set[str]()
    for group in groups:
        usual = DEFAULT_OPTIONS | {"lidar": _own_lidar(group["robot"])}
        different |= {name for name in RUN_AXES if name in FIELDS and group[name] != usual[name]}
    return tuple(name for name in RUN_AXES if name in different)


def by_group(entries: Iterable[Entry]) -> dict[RunGroup, list[Entry]]:
    """Return the records of each group by seed, groups in order of appearance."""
    groups: dict[RunGroup, list[Entry]] = {}
    for entry in entries:
        groups.setdefault(RunGroup.of(entry), []).append(entry)
    return {group: sorted(runs, key=lambda e: int(e["seed"])) for group, runs in groups.items()}


def distinguishing_fields(groups: Iterable[RunGroup]) -> tuple[str, ...]:
    """Return the fields in which groups differ; `world` where they do not differ at all.

    The LRF is left out where each robot has its own.
    """
    kept = list(groups)
    different = [f for f in FIELDS if len({group[f] for group in kept}) > 1]
    if len({(g["robot"], g["lidar"]) for g in kept}) == len({g["robot"] for g in kept}):
        different = [f for f in different if f != "lidar"]
    return tuple(different) or ("world",)


@cache
def _own_lidar(robot: str) -> str:
    from lirs_envs.robots.robot import make_robot  # loads the simulator, which logs do not need

    try:
        return make_robot(robot).lidar
    except ConfigError:
        return "the robot's own"


def source_files(config: RunConfig) -> tuple[dict[str, str], ...]:
    """Return `path` and `sha256` of a world's source files; empty for bundled worlds."""
    source = find_source(config.source, config.build)
    if source.kind is SourceKind.BUNDLED:
        return ()
    paths = [source.path]
    if source.kind is SourceKind.FOLDER:
        paths = [source.path / "world.json", source.path / "world.npz"]
    elif source.kind is SourceKind.MAP:
        paths.append(read_metadata(source.path).image)
    entries = []
    for path in paths:
        try:
            state = path.stat()
            content = _digest_of(path.absolute(), state.st_mtime_ns, state.st_size)
        except OSError as error:
            raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error
        entries.append({"path": str(path.absolute()), "sha256": content})
    return tuple(entries)


@lru_cache(maxsize=256)
def _digest_of(path: Path, changed: int, size: int) -> str:
    """Return the digest of a file; one that did not change is read once."""
    return digest(path)


def same_source(config: RunConfig, recorded: Sequence[dict[str, str]]) -> bool:
    """Return whether a config's source has the recorded content."""
    try:
        current = source_files(config) if recorded else ()
    except SourceError:
        return False
    return [file["sha256"] for file in current] == [file["sha256"] for file in recorded]


def same_code(recorded: Any) -> bool:
    """Return whether this very code and package version made a result, by its recorded versions."""
    own = {"code": code(), "lirs-wct": importlib.metadata.version("lirs-wct")}
    return isinstance(recorded, dict) and own.items() <= recorded.items()


def damaged_files(folder: Path, marker: str) -> list[str]:
    """Return missing or changed files of a result's folder, by its manifest.

    The marker is left out: who reads it notices damage. A manifest that does not name it is damaged.
    """
    manifest = read_manifest(folder)
    if manifest.pop(marker, None) is None:
        return [MANIFEST]
    damaged = []
    for name, digests in manifest.items():
        with suppress(OSError):
            if digest(folder / name) in digests:
                continue
        damaged.append(name)
    return damaged


def world_files(config: RunConfig) -> list[Path]:
    """Return a source's files, judged by its name; empty for bundled worlds."""
    path = Path(config.source)
    if path.is_dir():
        return [path / "world.json", path / "world.npz"]
    siblings = path.parent.glob(f"{path.stem}.*") if path.suffix in (".yaml", ".yml") else ()
    textures = (config.build.texture, config.build.wall_texture)
    return [path, *siblings, *filter(None, textures)]


def is_stale(result: Path, recorded: Any, inputs: Iterable[Path | None]) -> bool:
    """Tell whether other code wrote a result, or an input is newer.

    The result is the file that was written last, with its recorded versions; an input may be written, moved
    or copied after it.
    """
    if not same_code(recorded):
        return True
    written = result.stat().st_mtime
    for path in inputs:
        with suppress(OSError):
            if path is not None and max(path.stat().st_mtime, path.stat().st_ctime) > written:
                return True
    return False


def plain(value: Any) -> Any:
    """Return the JSON value of a NumPy number or a path."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"a record holds numbers, text and lists, got {type(value).__name__}")


def maps_clouds(entry: Mapping[str, Any]) -> bool:
    """Whether a run's mapper read point clouds: it has no occupancy map, but an elevation."""
    return "elevation_rmse" in entry["map"]
