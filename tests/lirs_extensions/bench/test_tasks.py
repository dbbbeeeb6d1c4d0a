"""The sets as they ship: whole, split by world, and large enough without any file."""

import json
from pathlib import Path
from typing import Any

import pytest

from lirs_extensions.bench.tasks import SETS, SPLITS, read_task_set, set_entry, task_set
from lirs_wct.errors import ConfigError, SourceError

GOOD: dict[str, Any] = {
    "schema": 1,
    "name": "mine",
    "version": 1,
    "worlds": {"plan": {"maker": "floor plan", "seed": 3}},
    "tasks": [
        {
            "name": "a",
            "task": "navigation",
            "split": "test",
            "world": "plan",
            "robot": "jackal",
            "seed": 1,
            "start": [0, 0, 0],
            "goal": [2, 0],
            "time_limit": 30,
        }
    ],
}


def changed(**task: Any) -> dict[str, Any]:
    """The good set with another task; None leaves a key out."""
    entry = GOOD["tasks"][0] | task
    return GOOD | {"tasks": [{key: value for key, value in entry.items() if value is not None}]}


@pytest.mark.parametrize("name", SETS)
def test_no_world_is_in_two_splits(name: str) -> None:
    splits: dict[str, set[str]] = {}
    for task in task_set(name).tasks:
        if task.world is not None:
            splits.setdefault(task.world.name, set()).add(task.split)
    assert all(len(found) == 1 for found in splits.values())


def test_courses_of_two_splits_differ() -> None:
    drawn = [(t.course, t.seed) for t in task_set("generated").tasks if t.task == "traverse"]
    assert len(set(drawn)) == len(drawn)


def test_at_least_100_tasks_need_no_file() -> None:
    tasks = [task for name in SETS for task in task_set(name).tasks]
    ship = [task for task in tasks if task.world is None or not task.world.files]
    assert len(ship) >= 100
    assert {task.split for task in ship} == set(SPLITS)


@pytest.mark.parametrize("name", SETS)
def test_every_set_has_navigation_and_mapping_that_ship_in_every_split(name: str) -> None:
    for split in SPLITS:
        for kind in ("navigation", "mapping"):
            chosen = task_set(name).chosen(kind, split)
            assert any(t.world is not None and not t.world.files for t in chosen), (split, kind)


@pytest.mark.parametrize("name", SETS)
def test_a_set_survives_json(name: str) -> None:
    found = task_set(name)
    assert read_task_set(json.loads(json.dumps(set_entry(found))), name) == found


def test_what_a_set_lacks_is_said() -> None:
    with pytest.raises(ConfigError, match="the set lirs has no traverse tasks in the split test; it has"):
        task_set("lirs").chosen("traverse", "test")
    with pytest.raises(ConfigError, match="unknown split 'tests'; legal: all, test, train, validation"):
        task_set("lirs").chosen("mapping", "tests")


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (changed(goal=None), "a: a navigation task needs goal"),
        (changed(path_budget=3.0), "a: a navigation task takes no path_budget"),
        (changed(start=[0, 0]), "a: start must be 3 finite numbers"),
        (changed(robot="huksy"), "unknown robot 'huksy'"),
        (changed(world="attic"), "unknown world of a task 'attic'; legal: plan"),
        (changed(time_limit=0), "time_limit of a must be"),
        (changed(color="red"), "color"),
        (changed(name="../a"), "the name of a task must be 1 to 100 letters, digits and _.-, got '../a'"),
        (changed(name="a" * 101), "the name of a task must be 1 to 100 letters"),
        (changed(start=[1e300, 0, 0]), "a: start must be 3 finite numbers up to 1e+06"),
        (GOOD | {"name": ""}, "the name of a task set must be"),
        (GOOD | {"schema": 9}, "schema of a task set must be 1, got 9"),
        (GOOD | {"tasks": GOOD["tasks"] * 2}, "two tasks have one name"),
        (GOOD | {"worlds": {"plan": {"maker": "magic"}}}, "unknown maker of a world 'magic'"),
        ([], "not a set of tasks"),
    ],
)
def test_a_file_that_is_no_set_is_one_line(entry: Any, message: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(entry))
    with pytest.raises(SourceError) as raised:
        task_set(str(path))
    assert str(raised.value).startswith(f"{path}: ")
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_set_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(GOOD))
    (task,) = task_set(str(path)).chosen("navigation", "all")
    assert task.goal == (2.0, 0.0)
    with pytest.raises(SourceError, match="cannot be read"):
        task_set(str(tmp_path / "none.json"))
    with pytest.raises(ConfigError, match=r"unknown set 'mine'; legal: FILE\.json, generated"):
        task_set("mine")
