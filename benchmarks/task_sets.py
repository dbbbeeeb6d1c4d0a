"""Draw the benchmark's sets of tasks anew: the same seeds give the same tasks.

    python benchmarks/task_sets.py [SET ...] [--data FOLDER] [--output FOLDER]

What is drawn is in PLANS. Without `--data`, tasks in worlds of files that do not ship stay as they
are in the shipped set. When a task changes, its set's version is raised by hand.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

from benchmarks.steps import arguments
from lirs_envs.generators.terrain import KINDS
from lirs_extensions.bench.drawing import TaskDrawing
from lirs_extensions.bench.tasks import SETS, SPLITS, BenchTask, TaskSet, WorldSpec, set_entry, task_set
from lirs_validation.driving.choice import CLEARANCE
from lirs_wct.errors import SourceError


@dataclass(frozen=True)
class Plan:
    """Tasks to draw in one world: how many with a goal (navigation), and without one (mapping)."""

    world: WorldSpec
    split: str
    robot: str
    navigation: int
    mapping: int

    def draw(self, data: Path | None, first: int) -> list[BenchTask]:
        """Return the tasks; their seeds begin with `first`."""
        world, tasks = self.world.world(data), []
        for task, count, seed in (
            ("navigation", self.navigation, first),
            ("mapping", self.mapping, first + 500),
        ):
            if count:
                drawing = TaskDrawing(
                    self.world, world, task, self.robot, split=self.split, margins=(CLEARANCE,)
                )
                name = f"{self.split}-{task}-{self.world.name}-{self.robot}"
                tasks += [drawing.draw(f"{name}-{k}", seed + k, k) for k in range(count)]
        return tasks


MAPS = (("maze", "train"), ("smoothers_world", "validation"), ("depot", "test"), ("willow", "test"))
"""Maps of buildings that do not ship, with their splits."""
ELEVATION = (("apollo15", "train"), ("prayag", "validation"), ("vrc_driving", "test"), ("moon", "test"))
"""Elevation models that do not ship, with their splits."""
FURTHER_PLANS = range(23, 69)
"""Seeds of floor plans for tests of navigation only: 150 generated tasks tell policies apart."""


def make(maker: str, name: str, **options: Any) -> WorldSpec:
    """Return a world that ships, or that a generator makes."""
    return WorldSpec(name=name, maker=maker, options=tuple(options.items()))


def from_files(name: str) -> WorldSpec:
    """Return a world of files that do not ship, as a shipped set names them."""
    worlds = (task.world for shipped in ("hills", "indoor") for task in task_set(shipped).tasks)
    return next(world for world in worlds if world is not None and world.name == name and world.files)


def lirs() -> list[Plan]:
    """Return the three bundled worlds, one a split."""
    worlds = (("simple", "train"), ("medium", "validation"), ("advanced", "test"))
    return [
        Plan(make("bundled", name, source=name), split, robot, count, 2)
        for name, split in worlds
        for robot, count in (("husky", 6), ("jackal", 4))
    ]


def hills() -> list[Plan]:
    """Return hills, dunes and a field of boulders for each split, and elevation models that do not ship."""
    plans = []
    for first, split in ((0, "train"), (10, "validation"), (20, "test")):
        for k, (kind, mapping) in enumerate((("hills", 0), ("dunes", 0), ("boulders", 4))):
            seed = first + k
            world = make("natural", f"{kind}-{seed}", kind=kind, seed=seed)
            world = make(kind, f"{kind}-{seed}", seed=seed) if kind == "boulders" else world
            plans.append(Plan(world, split, "husky" if k else "jackal", 4, mapping))
    return plans + [Plan(from_files(name), split, "husky", 4, 0) for name, split in ELEVATION]


def indoor() -> list[Plan]:
    """Return floor plans for each split, and maps of buildings that do not ship."""
    robots = ("jackal", "turtlebot2", "turtlebot3_waffle")
    plans = [
        Plan(_floor_plan(first + k), split, robot, 4, 2)
        for first, split in ((0, "train"), (10, "validation"), (20, "test"))
        for k, robot in enumerate(robots)
    ]
    # A lidar of 30 m sees half of a hall at once: there a robot with a short one maps.
    for robot, navigation, mapping in (("jackal", 4, 0), ("turtlebot2", 0, 2)):
        plans += [Plan(from_files(name), split, robot, navigation, mapping) for name, split in MAPS]
    # Last, so that the seeds of the tasks above stay.
    further = zip(FURTHER_PLANS, cycle(robots), strict=False)
    return plans + [Plan(_floor_plan(seed), "test", robot, 3, 0) for seed, robot in further]


def _floor_plan(seed: int) -> WorldSpec:
    return make("floor plan", f"floor-plan-{seed}", seed=seed)


def generated() -> list[Plan]:
    """Return courses as worlds for each split; courses to traverse are drawn apart."""
    courses = (("mazes", 0.5, 2), ("mazes", 1.0, 2), ("stones", 0.7, 0))
    return [
        Plan(
            make("course", f"{kind}-{first + k}", kind=kind, difficulty=difficulty, seed=first + k),
            split,
            "husky" if kind == "stones" else "jackal",
            3,
            mapping,
        )
        for first, split in ((0, "train"), (10, "validation"), (20, "test"))
        for k, (kind, difficulty, mapping) in enumerate(courses)
    ]


PLANS = {"indoor": indoor, "hills": hills, "lirs": lirs, "generated": generated}
COURSE_DIFFICULTIES = {"train": (0.25, 0.5, 0.75), "validation": (0.5, 0.75), "test": (0.5, 0.75, 1.0)}
"""Of the courses to traverse, of each kind one."""

VERSIONS = {"indoor": 3, "hills": 2, "lirs": 2, "generated": 2}
SHIPPED = Path(__file__).resolve().parents[1] / "lirs_extensions" / "bench" / "task_sets"


def main() -> None:
    """Write the sets."""
    given = arguments(__doc__, "sets", sets=list(SETS), data=Path, output=SHIPPED)
    given.output.mkdir(parents=True, exist_ok=True)
    for name in given.sets:
        found = draw_set(name, given.data)
        (given.output / f"{name}.json").write_text(as_text(set_entry(found)), encoding="utf-8")
        print(f"{name}: {len(found.tasks)} tasks")


def draw_set(name: str, data: Path | None) -> TaskSet:
    """Return a set, drawn anew."""
    tasks: list[BenchTask] = []
    for number, plan in enumerate(PLANS[name]()):
        try:
            plan.world.places(data)
        except SourceError:
            tasks += [task for task in task_set(name).tasks if task.world == plan.world]
            continue
        tasks += plan.draw(data, 1000 * number)
    if name == "generated":
        tasks += courses()
    return TaskSet(name=name, version=VERSIONS[name], tasks=tuple(tasks))


def courses() -> list[BenchTask]:
    """Return the courses to traverse: of each kind one a difficulty, for a Husky."""
    return [
        BenchTask(
            name=f"{split}-traverse-{kind}-{round(100 * difficulty):03d}",
            task="traverse",
            split=split,
            robot="husky",
            seed=100 * s + 10 * k + d,
            time_limit=90.0,
            course=kind,
            difficulty=difficulty,
        )
        for s, split in enumerate(SPLITS)
        for k, kind in enumerate(KINDS)
        for d, difficulty in enumerate(COURSE_DIFFICULTIES[split])
    ]


def as_text(entry: dict[str, Any]) -> str:
    """Return a set as JSON with a world or a task a line."""
    worlds = ",\n".join(f"  {json.dumps(name)}: {json.dumps(w)}" for name, w in entry["worlds"].items())
    tasks = ",\n".join(f"  {json.dumps(task)}" for task in entry["tasks"])
    head = "".join(f' "{key}": {json.dumps(entry[key])},\n' for key in ("schema", "name", "version"))
    return f'{{\n{head} "worlds": {{\n{worlds}\n }},\n "tasks": [\n{tasks}\n ]\n}}\n'


if __name__ == "__main__":
    main()
