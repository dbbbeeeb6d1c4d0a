"""Tasks drawn in a user's worlds: room, ways, seeds; the command that scores policies on them."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from lirs_envs.robots.robot import make_robot
from lirs_extensions.bench.drawing import NEAR_START, draw_set, find_worlds
from lirs_extensions.bench.episode import RECORD
from lirs_extensions.bench.tasks import BenchTask
from lirs_wct import BuildOptions
from tests.kit import refused

CELL = 0.05
ROBOT = "turtlebot2"


def plan(door: float = 1.0) -> np.ndarray:
    """Occupied cells of two rooms of 3 x 4 m, row 0 north, with a door between them."""
    cells = np.zeros((84, 124), np.bool_)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = cells[:, 61:63] = True
    half = round(door / CELL / 2)
    cells[42 - half : 42 + half, 61:63] = False
    return cells


def write_map(path: Path, cells: np.ndarray) -> str:
    """Write a map's YAML and its picture; return the YAML's path."""
    rows, cols = cells.shape
    picture = np.where(cells, 0, 254).astype(np.uint8)
    path.with_suffix(".pgm").write_bytes(b"P5\n%d %d\n255\n" % (cols, rows) + picture.tobytes())
    path.write_text(
        f"image: {path.stem}.pgm\nresolution: {CELL}\norigin: [0, 0, 0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    return str(path)


def draw(source: str, count: int, seed: int = 1, robot: str = ROBOT) -> tuple[BenchTask, ...]:
    return draw_set(find_worlds([source], BuildOptions()), "navigation", robot, count, seed).tasks


@pytest.mark.parametrize(("door", "room"), [(1.0, 0.15), (0.5, 0.05)])
def test_starts_and_goals_have_room_and_a_way(door: float, room: float, tmp_path: Path) -> None:
    cells = plan(door)
    radius = make_robot(ROBOT).radius
    # By SciPy on the picture, not by our grids; two cells of tolerance.
    distance = ndimage.distance_transform_edt(~cells) * CELL
    areas, _ = ndimage.label(distance > radius + room - 2 * CELL)
    tasks = draw(write_map(tmp_path / "flat.yaml", cells), 6)
    for task in tasks:
        assert task.start is not None
        assert task.goal is not None
        ends = [
            areas[cells.shape[0] - 1 - int(y / CELL), int(x / CELL)] for x, y in (task.start[:2], task.goal)
        ]
        assert ends[0] == ends[1] != 0
        bearing = math.atan2(task.goal[1] - task.start[1], task.goal[0] - task.start[0]) - task.start[2]
        assert abs(math.remainder(bearing, math.tau)) > NEAR_START - 0.1
        assert task.time_limit > 20 + math.dist(task.start[:2], task.goal) / make_robot(ROBOT).max_speed
    # The way through the door counts where half of the ground lies behind it.
    assert any((task.start[0] < 3.1) != (task.goal[0] < 3.1) for task in tasks if task.start and task.goal)


def test_a_seed_draws_its_tasks(tmp_path: Path) -> None:
    source = write_map(tmp_path / "flat.yaml", plan())
    four, six = draw(source, 4), draw(source, 6)
    assert four == six[:4]
    assert not {task.start for task in six} & {task.start for task in draw(source, 6, seed=2)}


def test_a_world_without_room_names_robot_and_ground(tmp_path: Path) -> None:
    source = write_map(tmp_path / "flat.yaml", plan()[:20, :20])
    with refused(source, "husky is 1.16 m wide: too large .*; try another --robot"):
        draw(source, 1, robot="husky")


@pytest.fixture
def bench(wct: Any, tmp_path: Path) -> Any:
    write_map(tmp_path / "flat.yaml", plan())
    write_map(tmp_path / "office.yaml", plan(0.7))
    (tmp_path / "deep").mkdir()
    write_map(tmp_path / "deep" / "flat.yaml", plan(0.6))
    write_map(tmp_path / "cell.yaml", plan()[:20, :20])
    return lambda *words, out="out": wct("bench", *words, "-o", out)


def reached(out: Path, policy: str, world: str = "") -> int:
    """Count the goals that a policy reached, by the last pose of its records."""
    found = 0
    for path in out.glob(f"*/{RECORD}"):
        entry = json.loads(path.read_text())
        if entry["policy"] == policy and entry["task"]["name"].startswith(world):
            found += math.dist(entry["path"][-1][:2], entry["task"]["goal"]) < 0.6
    return found


@pytest.mark.slow
def test_one_sentence_for_each_world_and_for_all_and_the_same_bytes_again(bench: Any, tmp_path: Path) -> None:
    words = (
        "go_to_goal",
        "straight",
        "--world",
        "flat.yaml",
        "office.yaml",
        "--robot",
        ROBOT,
        "--tasks",
        "3",
    )
    code, said, _ = bench(*words)
    assert code == 0
    flat, office, both = said.splitlines()[-3:]
    out = tmp_path / "out"
    for line, world, count, where in (
        (flat, "flat", 3, "flat"),
        (office, "office", 3, "office"),
        (both, "", 6, "2 worlds"),
    ):
        n, m = reached(out, "go_to_goal", world), reached(out, "straight", world)
        assert line == f"go_to_goal reaches {n} of {count} goals in {where}; straight {m}."
    assert reached(out, "go_to_goal") > 0
    code, again, told = bench(*words)
    assert (code, again) == (0, said)
    assert "kept 12 of 12 from before" in told
    code, elsewhere, _ = bench(*words, out="other")
    assert (code, elsewhere.replace("other", "out")) == (0, said)
    scores = "scores-navigation.json"
    assert (tmp_path / "other" / scores).read_bytes() == (out / scores).read_bytes()


@pytest.mark.slow
def test_a_changed_map_is_another_world(bench: Any, tmp_path: Path) -> None:
    words = ("straight", "--world", "flat.yaml", "--robot", ROBOT, "--tasks", "2")
    bench(*words)
    cells = plan()
    cells[10, 10] = True
    write_map(tmp_path / "flat.yaml", cells)
    code, said, told = bench(*words)
    assert code == 0
    assert "kept" not in told
    assert "straight reaches" in said
    assert " of 2 goals in flat." in said


@pytest.mark.slow
def test_a_mapping_policy_covers_ground(bench: Any, tmp_path: Path) -> None:
    code, said, _ = bench("astar", "straight", "--world", "flat.yaml", "--task", "mapping", "--tasks", "1")
    assert code == 0
    records = [json.loads(path.read_text()) for path in tmp_path.glob(f"out/*/{RECORD}")]
    shares = {entry["policy"]: f"{100 * entry['coverage'][-1][1]:.0f} %" for entry in records}
    line = f"astar covers {shares['astar']} of the ground in flat; straight {shares['straight']}."
    assert said.splitlines()[-1] == line


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--world flat.yaml deep/flat.yaml", "deep/flat.yaml: its world is named flat, as that of flat.yaml"),
        ("--world flat.yaml,office.yaml flat.yaml", "its world is named flat, as that of flat.yaml"),
        ("--world flat.yaml --set lirs", "--set: for tasks of a set; --world draws its own"),
        ("--world flat.yaml --split test", "--split: for tasks of a set; --world draws its own"),
        ("straight --robot husky --size 3", "--robot, --size: for --world, which is not given"),
        ("--world attic.yaml", "attic.yaml: no such file or folder"),
        ("pretraned --world flat.yaml", "unknown policy or world 'pretraned'"),
        ("--world cell.yaml", "that were drawn can be used; try another --robot, --window"),
        ("--world flat.yaml --tasks 0", "tasks must be within [1, 1000], got 0"),
        ("--world flat.yaml --robot huksy", "unknown robot 'huksy'"),
        (
            "straight --world flat.yaml --task traverse",
            "unknown --task in worlds of your own 'traverse'; legal: mapping, navigation",
        ),
    ],
)
def test_what_does_not_fit_is_one_line(words: str, message: str, bench: Any, tmp_path: Path) -> None:
    code, said, told = bench(*words.split())
    line = told.strip().splitlines()[-1]
    assert (code, said) == (2, "")
    assert line.startswith("lirs-wct: ")
    assert message in line
    assert not (tmp_path / "out").exists()
