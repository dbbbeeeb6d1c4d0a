"""Tasks of the benchmark as data (task, robot, world, start, goal), in sets with splits; their worlds.

A world is bundled, generated, or built from files known by digest.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from lirs_envs.episodes.world_cache import cached_world
from lirs_envs.generators.arena import ArenaConfig, arena
from lirs_envs.generators.floor_plan import floor_plan
from lirs_envs.generators.terrain import EDGE, KINDS, NATURAL_TERRAINS, NODES, fractal, generate, with_rocks
from lirs_envs.robots.robot import make_robot
from lirs_wct import BuildOptions, FloatArray, HeightField, World, build_world
from lirs_wct.errors import (
    Check,
    Checked,
    ConfigError,
    SourceError,
    WctError,
    check_field,
    check_seed,
    limited,
    one_of,
    reason_of,
    unknown_name,
    within,
)
from lirs_wct.files import digest
from lirs_wct.ground import Terrain
from lirs_wct.sources.bundled import RECIPES

CELL = EDGE / (NODES - 1)
"""Spacing of a natural terrain's nodes, meters."""


@dataclass(frozen=True, kw_only=True)
class FileSpec:
    """A file that is not part of this package; its origin is a repository and a path there."""

    sha256: str
    size: int
    origin: str


@dataclass(frozen=True, kw_only=True)
class WorldSpec:
    """Recipe of a world.

    Attributes:
        maker: one of `MAKERS`, or `files`.
        files: external input files, the source first.
    """

    name: str
    maker: str
    options: tuple[tuple[str, Any], ...] = ()
    files: tuple[FileSpec, ...] = ()

    def world(self, data: Path | None) -> World:
        """Make the world, of files in a folder where they do not ship."""
        return _make_world(self, tuple(self.places(data)))

    def places(self, data: Path | None) -> list[Path]:
        """Return the paths of its files."""
        found = []
        for file in self.files:
            path = _find(file, data)
            if path is None:
                where = "no --data folder is given" if data is None else f"{data} does not hold it"
                raise SourceError(f"{self.name}: {where}: {file.origin} (sha256 {file.sha256[:12]}...)")
            found.append(path)
        return found

    def describe(self) -> dict[str, Any]:
        """Return the JSON value."""
        entry: dict[str, Any] = {"maker": self.maker} | dict(self.options)
        return entry | ({"files": [vars(file) for file in self.files]} if self.files else {})


def read_world(name: str, entry: Mapping[str, Any]) -> WorldSpec:
    """Return a world of its JSON value (see `WorldSpec.describe`).

    Options of the maker `files` are those of `BuildOptions`.
    """
    given = dict(entry)
    maker, files = str(given.pop("maker")), given.pop("files", [])
    options: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in given.items()}
    if (maker == "files") != bool(files) or maker not in (*MAKERS, "files"):
        raise unknown_name("maker of a world", maker, (*MAKERS, "files with a list of files"))
    specs = tuple(FileSpec(**file) for file in files)
    if maker == "files":
        BuildOptions(**options)
    return WorldSpec(name=name, maker=maker, options=tuple(options.items()), files=specs)


def _bundled_world(name: str, *, source: str) -> World:
    one_of(RECIPES)(source, "bundled world")
    return cached_world(source)


def _natural(name: str, *, kind: str, seed: int) -> World:
    one_of(NATURAL_TERRAINS)(kind, "natural terrain")
    return _terrain(name, NATURAL_TERRAINS[kind](np.random.default_rng(seed)))


def _boulders(name: str, *, seed: int) -> World:
    """Return rolling ground with many boulders, which block the view."""
    rng = np.random.default_rng(seed)
    return _terrain(name, with_rocks(rng, 3 * fractal(rng), 160, radius=(0.5, 1.2), height=(1.0, 2.0)))


def _terrain(name: str, heights: FloatArray) -> World:
    surface = HeightField.centered(heights.astype(np.float32), (CELL, CELL))
    return World(name, Terrain(surface), scale="generated")


def _course(name: str, *, kind: str, difficulty: float, seed: int) -> World:
    one_of(KINDS)(kind, "course")
    return generate(kind, difficulty, np.random.default_rng(seed)).world()


def _floor_plan(name: str, *, seed: int) -> World:
    return World(name, floor_plan(np.random.default_rng(seed)), scale="generated")


MAKERS: Mapping[str, Callable[..., World]] = {
    "bundled": _bundled_world,
    "natural": _natural,
    "boulders": _boulders,
    "course": _course,
    "floor plan": _floor_plan,
    "arena": lambda name, **parameters: arena(name, ArenaConfig(**parameters)),
}
"""Makers of worlds without external files, by name."""


@lru_cache(maxsize=4)
def _make_world(spec: WorldSpec, places: tuple[Path, ...]) -> World:
    """Make a world of its files' paths, if it has files."""
    options = dict(spec.options)
    check_seed(options.get("seed", 0))
    if places:
        return build_world(places[0], BuildOptions(**options))
    try:
        return MAKERS[spec.maker](spec.name, **options)
    except TypeError as error:
        raise ConfigError(f"world {spec.name!r}: {error}") from error


@lru_cache(maxsize=256)
def _find(file: FileSpec, data: Path | None) -> Path | None:
    """Return the file of this content in a folder and those in it."""
    if data is None:
        return None
    for path in sorted(data.rglob("*")):
        if path.is_file() and path.stat().st_size == file.size and digest(path) == file.sha256:
            return path
    return None


SETS = ("indoor", "hills", "lirs", "generated")
SHIPPED = Path(__file__).parent / "task_sets"
SPLITS = ("train", "validation", "test")
TASKS: Mapping[str, tuple[str, ...]] = {
    "navigation": ("world", "start", "goal"),
    "mapping": ("world", "start", "path_budget"),
    "traverse": ("course", "difficulty"),
}
"""Fields that a task needs, by its kind."""
FARTHEST = 1e6
"""Largest coordinate of a start or goal, meters."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")
SCHEMA = 1
"""Of a file with a set of tasks."""


def _coordinates(size: int) -> Check:
    """Return a check of a position's coordinates."""

    def check(value: Any, label: str) -> None:
        if not (len(value) == size and all(abs(v) <= FARTHEST for v in value)):
            raise ConfigError(f"{label} must be {size} finite numbers up to {FARTHEST:g}, got {value}")

    return check


@dataclass(frozen=True, kw_only=True)
class BenchTask(Checked):
    """One episode that every policy runs.

    Attributes:
        name: unique in its set.
        task: `navigation`, `mapping` or `traverse`.
        split: `train`, `validation` or `test`; worlds of one split are in no other.
        seed: Seed of the episode, and of a course to traverse.
        time_limit: seconds.
        world: world of the episode; None = on a course.
        start: x, y, yaw in the world frame, meters and radians; None = the course's.
        goal: x, y; None = the task has none, or the course's.
        path_budget: path length that ends a mapping task, meters.
        course: kind of the course to traverse.
        difficulty: Difficulty of the course, 0 to 1.
    """

    name: str
    task: str = check_field(one_of(TASKS))
    split: str = check_field(one_of(SPLITS))
    robot: str
    seed: int = check_field(check_seed)
    time_limit: float = check_field(within("(0, inf)", "s"))
    world: WorldSpec | None = None
    start: tuple[float, float, float] | None = check_field(_coordinates(3), default=None)
    goal: tuple[float, float] | None = check_field(_coordinates(2), default=None)
    path_budget: float | None = limited(None, "(0, inf)", "m")
    course: str | None = check_field(one_of(KINDS), default=None)
    difficulty: float | None = limited(None, "[0, 1]")

    def __post_init__(self) -> None:
        check_name(self.name, "task")
        try:
            super().__post_init__()
            make_robot(self.robot)
        except ConfigError as error:
            raise ConfigError(f"{self.name}: {error}") from error
        needs = TASKS[self.task]
        for name in ("world", "start", "goal", "path_budget", "course", "difficulty"):
            if (getattr(self, name) is not None) != (name in needs):
                verb = "needs" if name in needs else "takes no"
                raise ConfigError(f"{self.name}: a {self.task} task {verb} {name}")

    def describe(self) -> dict[str, Any]:
        """Return everything that decides the episode, as JSON."""
        entry = {key: value for key, value in asdict(self).items() if value is not None and key != "world"}
        return entry | ({} if self.world is None else {"world": self.world.describe()})


@dataclass(frozen=True, kw_only=True)
class TaskSet:
    """Tasks that belong together.

    Attributes:
        version: raised whenever a task or the environment changes; scores of two versions are not compared.
    """

    name: str
    version: int
    tasks: tuple[BenchTask, ...]

    def chosen(self, task: str, split: str) -> tuple[BenchTask, ...]:
        """Return the tasks of one kind and split, `all` = of every split."""
        one_of(TASKS)(task, "task")
        one_of((*SPLITS, "all"))(split, "split")
        found = tuple(t for t in self.tasks if t.task == task and split in (t.split, "all"))
        if not found:
            held = sorted({t.task for t in self.tasks if split in (t.split, "all")})
            raise ConfigError(
                f"the set {self.name} has no {task} tasks in the split {split}; "
                f"it has {', '.join(held) or 'none'}"
            )
        return found


def check_name(name: object, of: str) -> None:
    """Check a name that folder names contain."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise ConfigError(f"the name of a {of} must be 1 to 100 letters, digits and _.-, got {name!r:.60}")


def task_set(name: str) -> TaskSet:
    """Return a set by its name, or of a JSON file."""
    path = SHIPPED / f"{name}.json" if name in SETS else Path(name)
    if path.suffix != ".json":
        raise unknown_name("set", name, [*SETS, "FILE.json"])
    try:
        return read_task_set(json.loads(path.read_text(encoding="utf-8")))
    except WctError as error:
        raise SourceError(f"{path}: {error}") from error
    except (OSError, ValueError, RecursionError) as error:
        raise SourceError(f"{path}: {reason_of(error)}") from error


def read_task_set(entry: Any) -> TaskSet:
    """Return a set of its JSON value: `schema`, `name`, `version`, `worlds` by name, `tasks`."""
    try:
        if entry["schema"] != SCHEMA:
            raise ConfigError(f"schema of a task set must be {SCHEMA}, got {entry['schema']}")
        check_name(entry["name"], "task set")
        worlds = {name: read_world(name, world) for name, world in entry["worlds"].items()}
        tasks = tuple(_read_task(task, worlds) for task in entry["tasks"])
        found = TaskSet(name=str(entry["name"]), version=int(entry["version"]), tasks=tasks)
    except (KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"not a set of tasks, or damaged: {reason_of(error)}") from error
    if len({task.name for task in tasks}) < len(tasks):
        raise ConfigError("two tasks have one name")
    return found


def _read_task(entry: Mapping[str, Any], worlds: Mapping[str, WorldSpec]) -> BenchTask:
    values = dict(entry)
    for name in ("start", "goal"):
        if values.get(name) is not None:
            values[name] = tuple(float(v) for v in values[name])
    if values.get("world") is not None:
        one_of(worlds)(values["world"], "world of a task")
        values["world"] = worlds[values["world"]]
    return BenchTask(**values)


def set_entry(found: TaskSet) -> dict[str, Any]:
    """Return the JSON value of a set (see `read_task_set`)."""
    worlds = {t.world.name: t.world.describe() for t in found.tasks if t.world is not None}
    tasks = [t.describe() | ({} if t.world is None else {"world": t.world.name}) for t in found.tasks]
    return {"schema": SCHEMA, "name": found.name, "version": found.version, "worlds": worlds, "tasks": tasks}
