"""Tasks of the benchmark as data (task, robot, world, start, goal), in sets with splits."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from lirs_envs.generators.terrain import KINDS
from lirs_envs.robots.robot import make_robot
from lirs_extensions.bench.task_worlds import WorldSpec, read_world
from lirs_wct.checks import check_seed, require_within
from lirs_wct.errors import ConfigError, SourceError, WctError, reason_of, unknown_name

SETS = ("indoor", "hills", "lirs", "generated")
SPLITS = ("train", "validation", "test")
TASKS = ("navigation", "mapping", "traverse")
FARTHEST = 1e6
"""Largest coordinate of a start or goal, meters."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")
SCHEMA = 1
"""Of a file with a set of tasks."""


@dataclass(frozen=True, kw_only=True)
class BenchTask:
    """One episode that every policy runs.

    Attributes:
        name: unique in its set.
        task: `navigation`, `mapping` or `traverse`.
        split: `train`, `validation` or `test`; worlds of one split are in no other.
        robot: name.
        seed: of the episode; of a course to traverse, too.
        time_limit: seconds.
        world: world of the episode; None = on a course.
        start: x, y, yaw in the world frame, meters and radians; None = the course's.
        goal: x, y; None = the task has none, or the course's.
        path_budget: path length that ends a mapping task, meters.
        course: kind of the course to traverse.
        difficulty: of the course, 0 to 1.

    Raises:
        ConfigError: a value is not legal, or the task lacks one.
    """

    name: str
    task: str
    split: str
    robot: str
    seed: int
    time_limit: float
    world: WorldSpec | None = None
    start: tuple[float, float, float] | None = None
    goal: tuple[float, float] | None = None
    path_budget: float | None = None
    course: str | None = None
    difficulty: float | None = None

    def __post_init__(self) -> None:
        check_name(self.name, "task")
        if self.task not in TASKS:
            raise unknown_name("task", self.task, TASKS)
        if self.split not in SPLITS:
            raise unknown_name("split", self.split, SPLITS)
        make_robot(self.robot)
        check_seed(self.seed)
        require_within(self, "(0, inf)", "time_limit", of=self.name, unit="s")
        needs = {
            "navigation": {"world", "start", "goal"},
            "mapping": {"world", "start", "path_budget"},
            "traverse": {"course", "difficulty"},
        }[self.task]
        for name in ("world", "start", "goal", "path_budget", "course", "difficulty"):
            given = getattr(self, name) is not None
            if given != (name in needs):
                verb = "needs" if name in needs else "takes no"
                raise ConfigError(f"{self.name}: a {self.task} task {verb} {name}")
        self._check_numbers()

    def _check_numbers(self) -> None:
        for name, size in (("start", 3), ("goal", 2)):
            value = getattr(self, name)
            if value is not None and not (len(value) == size and all(abs(v) <= FARTHEST for v in value)):
                raise ConfigError(
                    f"{self.name}: {name} must be {size} finite numbers up to {FARTHEST:g}, got {value}"
                )
        if self.path_budget is not None:
            require_within(self, "(0, inf)", "path_budget", of=self.name, unit="m")
        if self.course is not None and self.course not in KINDS:
            raise unknown_name("course", self.course, KINDS)
        if self.difficulty is not None:
            require_within(self, "[0, 1]", "difficulty", of=self.name)

    @property
    def place(self) -> str:
        """Name of its world, or kind and difficulty of its course."""
        return self.world.name if self.world is not None else f"{self.course} {self.difficulty:g}"

    def describe(self) -> dict[str, Any]:
        """Return everything that decides the episode, as JSON."""
        entry = {key: value for key, value in asdict(self).items() if value is not None and key != "world"}
        return entry | ({} if self.world is None else {"world": self.world.describe()})


@dataclass(frozen=True, kw_only=True)
class TaskSet:
    """Tasks that belong together.

    Attributes:
        name: of the set.
        version: raised whenever a task or the environment changes; scores of two versions are not compared.
        tasks: all of them.
    """

    name: str
    version: int
    tasks: tuple[BenchTask, ...]

    def chosen(self, task: str, split: str) -> tuple[BenchTask, ...]:
        """Return the tasks of one kind and split, `all` = of every split.

        Raises:
            ConfigError: there is no such task or split, or none of these in the set.
        """
        if task not in TASKS:
            raise unknown_name("task", task, TASKS)
        if split not in (*SPLITS, "all"):
            raise unknown_name("split", split, (*SPLITS, "all"))
        found = tuple(t for t in self.tasks if t.task == task and split in (t.split, "all"))
        if not found:
            held = sorted({t.task for t in self.tasks if split in (t.split, "all")})
            raise ConfigError(
                f"the set {self.name} has no {task} tasks in the split {split}; "
                f"it has {', '.join(held) or 'none'}"
            )
        return found


def check_name(name: object, of: str) -> None:
    """Check a name that folder names contain.

    Raises:
        ConfigError: it holds other characters than letters, digits and `_.-`, or more than 100.
    """
    if not isinstance(name, str) or not NAME.fullmatch(name):
        shown = f"{name[:50]!r} ..." if isinstance(name, str) and len(name) > 100 else repr(name)
        raise ConfigError(f"the name of a {of} must be 1 to 100 letters, digits and _.-, got {shown}")


def task_set(name: str) -> TaskSet:
    """Return a set by its name, or of a JSON file.

    Raises:
        ConfigError: there is no such set.
        SourceError: the file cannot be read or is no set of tasks.
    """
    if name in SETS:
        return _read_shipped_set(name)
    if not name.endswith(".json"):
        raise unknown_name("set", name, [*SETS, "FILE.json"])
    path = Path(name)
    try:
        return read_task_set(json.loads(path.read_text(encoding="utf-8")), name)
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from error
    except WctError as error:
        raise SourceError(f"{path}: {error}") from error
    except (ValueError, RecursionError) as error:
        raise SourceError(f"{path}: {reason_of(error)}") from error


@cache
def _read_shipped_set(name: str) -> TaskSet:
    file = resources.files("lirs_extensions.bench") / "task_sets" / f"{name}.json"
    return read_task_set(json.loads(file.read_text(encoding="utf-8")), name)


def read_task_set(entry: Any, where: str) -> TaskSet:
    """Return a set of its JSON value: `schema`, `name`, `version`, `worlds` by name, `tasks`.

    Raises:
        ConfigError: it is no such value.
    """
    try:
        if entry["schema"] != SCHEMA:
            raise ConfigError(f"schema of a task set must be {SCHEMA}, got {entry['schema']}")
        check_name(entry["name"], "task set")
        worlds = {name: read_world(name, world) for name, world in entry["worlds"].items()}
        tasks = tuple(_read_task(task, worlds) for task in entry["tasks"])
        found = TaskSet(name=str(entry["name"]), version=int(entry["version"]), tasks=tasks)
    except (KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"not a set of tasks, or damaged: {reason_of(error)}") from error
    names = [task.name for task in tasks]
    if len(set(names)) < len(names):
        raise ConfigError(f"{where}: two tasks have one name")
    return found


def _read_task(entry: Mapping[str, Any], worlds: Mapping[str, WorldSpec]) -> BenchTask:
    values = dict(entry)
    for name in ("start", "goal"):
        if values.get(name) is not None:
            values[name] = tuple(float(v) for v in values[name])
    if values.get("world") is not None:
        if values["world"] not in worlds:
            raise unknown_name("world of a task", str(values["world"]), worlds)
        values["world"] = worlds[values["world"]]
    return BenchTask(**values)


def set_entry(found: TaskSet) -> dict[str, Any]:
    """Return the JSON value of a set (see `read_task_set`)."""
    worlds = {t.world.name: t.world.describe() for t in found.tasks if t.world is not None}
    tasks = [t.describe() | ({} if t.world is None else {"world": t.world.name}) for t in found.tasks]
    return {"schema": SCHEMA, "name": found.name, "version": found.version, "worlds": worlds, "tasks": tasks}
