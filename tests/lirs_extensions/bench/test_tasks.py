"""The sets as they ship: whole, split by world, and large enough without any file."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_extensions.bench.tasks import (
    SETS,
    FileSpec,
    WorldSpec,
    read_task_set,
    read_world,
    set_entry,
    task_set,
)
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


@pytest.mark.parametrize("name", SETS)
def test_a_set_survives_json(name: str) -> None:
    found = task_set(name)
    assert read_task_set(json.loads(json.dumps(set_entry(found)))) == found


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
        (changed(time_limit=0), "a: time_limit must be"),
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


YAML = (
    "image: plan.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n"
    "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
)


def file_spec(path: Path) -> FileSpec:
    content = path.read_bytes()
    return FileSpec(
        sha256=hashlib.sha256(content).hexdigest(), size=len(content), origin=f"some/where/{path.name}"
    )


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A folder with a laser map, under another name than the maker's and with other files around it."""
    folder = tmp_path / "data" / "deep"
    folder.mkdir(parents=True)
    cells = np.full((60, 80), 254, np.uint8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 0
    (folder / "plan.pgm").write_bytes(b"P5\n80 60\n255\n" + cells.tobytes())
    (folder / "renamed.yaml").write_text(YAML)
    (folder / "other.yaml").write_text(YAML.replace("0.05", "0.10"))
    return tmp_path / "data"


def test_a_map_is_found_by_its_content(data: Path) -> None:
    files = (file_spec(data / "deep" / "renamed.yaml"), file_spec(data / "deep" / "plan.pgm"))
    world = WorldSpec(name="plan", maker="files", files=files).world(data)
    assert world.surface.size == pytest.approx((4.0, 3.0))
    entry = {"maker": "files", "files": [vars(file) for file in files], "window": [1, 1, 2]}
    assert read_world("plan", entry).world(data).surface.size == pytest.approx((2.0, 2.0), abs=0.06)


def test_a_missing_file_is_named_by_origin_and_content(data: Path) -> None:
    files = (FileSpec(sha256="ab" * 32, size=124, origin="some/where/depot.yaml"),)
    spec = WorldSpec(name="depot", maker="files", files=files)
    with pytest.raises(
        SourceError, match=r"depot: no --data folder is given: some/where/depot.yaml \(sha256 abab"
    ):
        spec.world(None)
    with pytest.raises(SourceError, match=r"data does not hold it: some/where/depot\.yaml"):
        spec.world(data)


def test_generated_worlds_are_the_same_each_time() -> None:
    for set_name in ("hills", "generated"):
        world = next(t.world for t in task_set(set_name).tasks if t.world is not None and not t.world.files)
        again = read_world(world.name, world.describe())
        assert again == world
        assert np.array_equal(world.world(None).surface.z, again.world(None).surface.z)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"maker": "natural", "kind": "alps", "seed": 1}, "unknown natural terrain 'alps'"),
        ({"maker": "bundled", "source": "hard"}, "unknown bundled world 'hard'"),
        ({"maker": "floor plan", "sed": 1}, "world 'w': "),
    ],
)
def test_a_maker_says_what_it_does_not_know(entry: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        read_world("w", entry).world(None)
