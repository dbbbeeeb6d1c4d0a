"""A log wherever a source may be: mapped once, into the output folder, and its map used from then on."""

import gzip
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lirs_validation import resolve_source
from lirs_validation.analysis.results import read_results
from lirs_validation.experiment.run import validate
from lirs_validation.record.run_record import same_code
from lirs_wct import BuildOptions, World
from lirs_wct.errors import SourceError
from lirs_wct.geometry.pose import Pose2
from tests.command_line import run_command
from tests.lirs_wct.formats.carmen_room import START, flaser, room_lines, write_log

pytestmark = pytest.mark.usefixtures("plain_pictures")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the log of a room."""
    monkeypatch.chdir(tmp_path)
    write_log(tmp_path / "my room.clf", room_lines(30)[0])
    return tmp_path


def maps(folder: Path) -> list[Path]:
    return sorted(folder.glob("*/map.yaml"))


@pytest.mark.slow
def test_build_makes_the_map_and_the_world_of_it(folder: Path) -> None:
    assert run_command("build", "my room.clf", "-o", "worlds", "--to", "hfield", "--wall-height", "1.5") == 0
    world = World.load("worlds/my_room")
    assert (world.kind, world.name) == ("map", "my_room")
    assert world.walls.height == 1.5
    assert world.walls.solid.sum() > 200
    assert [p.parent.name[:24] for p in maps(folder / "worlds")] == ["my_room-cartographer-s1-"]


def test_a_map_that_is_there_is_used_again(folder: Path) -> None:
    options = BuildOptions()
    first = resolve_source("my room.clf", options, folder)
    assert Path(first).name == "my_room.yaml"
    record = Path(first).with_name("record.json")
    before = record.stat().st_mtime_ns
    assert resolve_source("my room.clf", options, str(folder)) == first
    assert record.stat().st_mtime_ns == before
    # Other cells, another log, other code: another map.
    assert resolve_source("my room.clf", BuildOptions(resolution=0.1), folder) != first
    write_log(folder / "my room.clf", room_lines(25)[0])
    assert resolve_source("my room.clf", options, folder) != first
    assert len(maps(folder)) == 3
    entry = json.loads(record.read_text())
    record.write_text(json.dumps(entry | {"versions": {"lirs-wct": "0.0"}}))
    write_log(folder / "my room.clf", room_lines(30)[0])
    assert resolve_source("my room.clf", options, folder) == first
    assert json.loads(record.read_text())["versions"] == entry["versions"]


@pytest.mark.parametrize(("changed", "again"), [({"numpy": "0.0"}, False), ({"code": "0"}, True)])
def test_a_map_is_stale_where_a_run_would_be(changed: dict[str, str], again: bool, folder: Path) -> None:
    options = BuildOptions()
    record = Path(resolve_source("my room.clf", options, folder)).with_name("record.json")
    entry = json.loads(record.read_text())
    versions = entry["versions"] | changed
    record.write_text(json.dumps(entry | {"versions": versions}))
    assert same_code(versions) != again
    resolve_source("my room.clf", options, folder)
    assert (json.loads(record.read_text())["versions"] == entry["versions"]) == again


def test_a_map_of_a_lost_mapper_is_no_world(folder: Path) -> None:
    """After the first half the laser sees nothing of the room any more, but noise."""
    rng, lines = np.random.default_rng(5), room_lines(60)[0]
    for k in range(60, 120):
        lines.append(flaser(rng.uniform(0.5, 7.0, 181), resting(lines), START + 0.2 * k))
    write_log(folder / "lost.log", lines)
    with pytest.raises(SourceError, match=r"lost\.log: cartographer lost its place in this log"):
        resolve_source("lost.log", BuildOptions(), folder)
    assert run_command("map", "lost.log", "--mapper", "hector") == 3


def resting(lines: list[str]) -> Pose2:
    """The odometry of the last line."""
    x, y, yaw = map(float, lines[-1].split()[-6:-3])
    return Pose2(x, y, yaw)


def test_info_of_a_log_maps_nothing(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(folder.rglob("*"))
    assert run_command("info", "my room.clf", "--range-max", "9") == 0
    shown = capsys.readouterr().out
    assert shown.rstrip().endswith("my room.clf: fit for planar mapping")
    assert "0.02 to 9 m" in shown
    assert sorted(folder.rglob("*")) == before
    assert run_command("info", "my room.clf", "--scan-topic", "/scan") == 2


def test_a_robot_drives_in_the_map_of_a_log(folder: Path) -> None:
    source = resolve_source("my room.clf", BuildOptions(), folder)
    run = validate(source, robot="turtlebot3_burger", seconds=1.0, out=folder)
    assert run.record.world["name"] == "my_room"
    assert run.record.status == "ok"
    results = read_results(folder)
    assert [read.folder for read in results.runs] == [run.folder]
    assert results.skipped == ()  # the map beside it is no damaged run


def test_the_map_command_tells_figures_and_what_was_wrong(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = room_lines(60)[0]
    lines[5], lines[9], lines[10] = "FLASER 181 1.0", lines[10], lines[9]
    write_log(folder / "damaged.clf", [*lines, "TRUEPOS 1 2 3"])
    assert run_command("map", "damaged.clf", "--mapper", "hector", "-o", "maps") == 0
    told = capsys.readouterr().out
    for part in ("59 of 181 beams (FLASER)", "1 x FLASER cut off or malformed", "1 x message TRUEPOS"):
        assert part in told
    assert "stamps going back" in told
    assert len(maps(folder / "maps")) == 1


BAD = {
    "no log": (("map", "nothing.clf"), "nothing.clf: cannot be read: No such file"),
    "empty": (("map", "empty.clf"), "empty.clf: no usable laser scan"),
    "binary": (("map", "binary.clf"), "binary.clf: not a text file"),
    "damaged gzip": (("map", "cut.clf.gz"), "cut.clf.gz: the gzip stream is damaged or cut off"),
    "a picture": (("map", "picture.png"), "picture.png: not a text file, a CARMEN log is one"),
    "a bundled world": (("map", "simple"), "simple: is a bundled world, map takes a CARMEN log or a ROS bag"),
    "relations": (("map", "my room.clf", "--relations", "empty.clf"), "empty.clf: holds no relation"),
    "reference": (("map", "my room.clf", "--reference", "empty.clf"), "empty.clf: no usable laser scan"),
    "in the way": (("map", "my room.clf", "--mapper", "hector", "-o", "empty.clf"), "empty.clf"),
    "build": (("build", "empty.clf"), "empty.clf: no usable laser scan"),
    "build without": (("build", "nothing.clf"), "nothing.clf: no such file or folder"),
    "validate": (("validate", "binary.clf"), "binary.clf: not a text file"),
    "info": (("info", "cut.clf.gz"), "cut.clf.gz: the gzip stream is damaged"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_code_2(
    case: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "empty.clf").write_bytes(b"")
    (folder / "binary.clf").write_bytes(bytes(range(256)))
    (folder / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR")
    (folder / "cut.clf.gz").write_bytes(gzip.compress(b"FLASER 1 2 3 4 5 6 7\n" * 99)[:40])
    before = sorted(folder.rglob("*"))
    arguments, expected = BAD[case]
    assert run_command(*arguments) == 2
    told = capsys.readouterr().err.strip()
    assert expected in told
    assert len(told.splitlines()) == 1, told
    assert sorted(folder.rglob("*")) == before


@pytest.mark.slow
def test_the_first_scan_does_not_wait_for_what_it_does_not_need() -> None:
    """Neither simulator nor drawing is loaded before a log is mapped; the command line loads less still."""
    code = (
        "import sys, lirs_validation.cli.app; early = set(sys.modules);"
        "import lirs_validation.logs.map_log, slam_baselines.cartographer.mapper;"
        "heavy = {'mujoco', 'matplotlib', 'gymnasium', 'trimesh'};"
        "print({'scipy.ndimage'} & early, heavy & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set() set()"
