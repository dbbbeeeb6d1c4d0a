"""The sets of tasks that ship are what their script draws."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from lirs_extensions.bench.episode import make_task_env, reset_options
from lirs_extensions.bench.tasks import SETS, BenchTask, set_entry, task_set
from tests.benchmark_modules import load_benchmark

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = ROOT / "lirs_extensions" / "bench" / "task_sets"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return load_benchmark("task_sets")


@pytest.mark.parametrize("name", SETS)
def test_the_files_are_as_the_script_writes_them(name: str, script: ModuleType) -> None:
    text = (SHIPPED / f"{name}.json").read_text(encoding="utf-8")
    assert script.as_text(set_entry(task_set(name))) == text
    assert json.loads(text)["version"] == script.VERSIONS[name]


def test_plans_and_files_have_the_same_worlds(script: ModuleType) -> None:
    for name in SETS:
        planned: Counter[tuple[str, str]] = Counter()
        for plan in script.PLANS[name]():
            planned[plan.world.name, plan.robot] += plan.navigation + plan.mapping
        tasks = [task for task in task_set(name).tasks if task.world is not None]
        assert Counter((t.world.name, t.robot) for t in tasks if t.world) == planned


def test_150_generated_indoor_tasks_tell_policies_apart() -> None:
    """In worlds of no other split."""
    worlds: dict[str, set[Any]] = {split: set() for split in ("train", "validation", "test")}
    for task in task_set("indoor").tasks:
        worlds[task.split].add(task.world)
    assert not worlds["test"] & (worlds["train"] | worlds["validation"])
    found = task_set("indoor").chosen("navigation", "test")
    assert sum(t.world is not None and t.world.maker == "floor plan" for t in found) >= 150


def test_drawing_again_gives_the_same_tasks(script: ModuleType) -> None:
    number, plan = next((k, p) for k, p in enumerate(script.PLANS["indoor"]()) if p.split == "validation")
    shipped = {task.name: task for task in task_set("indoor").tasks}
    drawn = replace(plan, navigation=2, mapping=1).draw(None, 1000 * number)
    assert [task.task for task in drawn] == ["navigation", "navigation", "mapping"]
    assert all(same(task, shipped[task.name]) for task in drawn)


def same(drawn: BenchTask, shipped: BenchTask) -> bool:
    """Whether two tasks are one but for the last digit, which may differ between machines."""
    a, b = drawn.describe(), shipped.describe()
    numbers = [
        (x, y) for key in ("start", "goal") for x, y in zip(a.pop(key, ()), b.pop(key, ()), strict=True)
    ]
    return a == b and all(abs(x - y) <= 0.002 for x, y in numbers)


@pytest.mark.slow
def test_every_test_task_that_ships_can_begin() -> None:
    for name in SETS:
        worlds = set()
        for task in task_set(name).chosen("navigation", "test"):
            if task.world is None or task.world.files or task.world in worlds:
                continue
            worlds.add(task.world)
            env = make_task_env(task, None, None)
            _, info = env.reset(seed=task.seed, options=reset_options(task))
            assert info["shortest_path"] > 1.0
            env.close()
