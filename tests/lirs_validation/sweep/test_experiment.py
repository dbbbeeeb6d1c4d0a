"""A run of a sweep: which results are kept, what a failed one leaves, the same bytes from every engine."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lirs_validation.config import RunConfig
from lirs_validation.record.run_record import Status, read_record, source_files
from lirs_validation.sweep.engines import Processes
from lirs_validation.sweep.sweep import Outcome, Serial, Sweep
from lirs_validation.sweep.tasks import RunTask
from lirs_wct import BuildOptions
from lirs_wct.errors import WctError
from lirs_wct.files import MANIFEST
from tests.lirs_validation.records import WITH_RESULTS, record, saved_whole

TIMES = {"rtf", "cost", "mapper", "versions"}
"""Of a record, what holds wall times or depends on them; a developer's code may change while engines run."""


def saved(experiment: RunTask, out: Path, status: Status = "ok") -> Path:
    """Write a folder as a finished run leaves it; return its record's file."""
    like = record(status=status)
    world = {**like.world, "name": experiment.world, "files": list(source_files(experiment.config))}
    return saved_whole(out, replace(like, config=experiment.config, world=world)) / "record.json"


def edited(file: Path, **changes: Any) -> None:
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))


def test_a_finished_run_is_kept(tmp_path: Path) -> None:
    experiment = RunTask(RunConfig(source="simple"))
    assert experiment.find_outcome(tmp_path) is None
    saved(experiment, tmp_path)
    assert experiment.find_outcome(tmp_path) == Outcome(task=experiment.name, status="ok", written=True)
    assert RunTask(RunConfig(source="simple", seed=2)).find_outcome(tmp_path) is None


def test_a_run_of_another_schema_version_or_code_is_not_kept(tmp_path: Path) -> None:
    experiment = RunTask(RunConfig(source="simple"))
    file = saved(experiment, tmp_path)
    versions = json.loads(file.read_text())["versions"]
    for changes in (
        {"schema": 1},
        {"versions": versions | {"lirs-wct": "0.0.1"}},
        {"versions": versions | {"code": "00000000"}},
        {"versions": None},
        {"config": None},
        {"status": ["ok"]},
        {"reason": 7},
        {"world": []},
        {"map": {"f1": "good"}},
    ):
        saved(experiment, tmp_path)
        edited(file, **changes)
        assert experiment.find_outcome(tmp_path) is None, changes
    for text in ('{"schema": 3, "sta', "[]", '"ok"', "3", "[" * 100_000):
        file.write_text(text)
        assert experiment.find_outcome(tmp_path) is None


@pytest.mark.parametrize("name", WITH_RESULTS)
@pytest.mark.parametrize("how", ["gone", "empty", "cut off"])
def test_a_run_whose_folder_is_not_whole_is_run_again(name: str, how: str, tmp_path: Path) -> None:
    experiment = RunTask(RunConfig(source="simple"))
    saved(experiment, tmp_path)
    file = tmp_path / experiment.name / name
    content = file.read_text()
    file.write_text(content[: len(content) // 2] if how == "cut off" else "")
    if how == "gone":
        file.unlink()
    assert experiment.find_outcome(tmp_path) is None


def test_a_run_without_a_manifest_is_run_again(tmp_path: Path) -> None:
    """Nobody can tell whether its files are whole."""
    experiment = RunTask(RunConfig(source="simple"))
    manifest = saved(experiment, tmp_path).with_name(MANIFEST)
    manifest.write_text("\n".join(manifest.read_text().splitlines()[:3]))
    assert experiment.find_outcome(tmp_path) is None
    manifest.unlink()
    assert experiment.find_outcome(tmp_path) is None


def test_a_failure_whose_trace_is_cut_off_is_run_again(tmp_path: Path) -> None:
    experiment = RunTask(RunConfig(source="simple"))
    outcome = Outcome(task=experiment.name, status="error", reason="it broke", trace="line 7")
    experiment.write_failure(tmp_path, outcome)
    assert experiment.find_outcome(tmp_path) == replace(outcome, trace="", written=True)
    (tmp_path / experiment.name / "error.txt").write_text("line")
    assert experiment.find_outcome(tmp_path) is None


def test_a_run_is_done_again_when_its_picture_changed(tmp_path: Path) -> None:
    picture = tmp_path / "dune.png"
    cv2.imwrite(str(picture), np.eye(9, dtype=np.uint8))
    experiment = RunTask(RunConfig(source=str(picture)))
    file = saved(experiment, tmp_path)
    now = picture.stat().st_ctime
    os.utime(file, (now + 10, now + 10))
    assert experiment.find_outcome(tmp_path) is not None
    os.utime(picture, (now + 20, now + 20))
    assert experiment.find_outcome(tmp_path) is None


def test_a_run_that_hit_a_wall_limit_counts_for_that_limit_only(tmp_path: Path) -> None:
    experiment = RunTask(RunConfig(source="simple", wall_limit=60.0))
    saved(experiment, tmp_path, "wall limit")
    assert experiment.find_outcome(tmp_path) is not None
    for limit in (None, 90.0):
        other = RunTask(replace(experiment.config, wall_limit=limit))
        assert other.name == experiment.name
        assert other.find_outcome(tmp_path) is None
    saved(experiment, tmp_path, "ok")
    assert RunTask(replace(experiment.config, wall_limit=None)).find_outcome(tmp_path) is not None


def test_a_failure_leaves_a_record_without_figures(tmp_path: Path) -> None:
    experiment = RunTask(RunConfig(source="simple", mapper="their.slam:Slam"))
    assert experiment.name.startswith("simple-husky-Slam-s1-")
    experiment.write_failure(
        tmp_path, Outcome(task=experiment.name, status="error", reason="it broke", trace="line 7")
    )
    written = read_record(tmp_path / experiment.name)
    assert (written["status"], written["reason"]) == ("error", "it broke")
    groups = ("rtf", "trajectory", "map", "collisions", "mapper", "cost")
    assert [written[group] for group in groups] == [{}] * 6
    assert (tmp_path / experiment.name / "error.txt").read_text() == "line 7"


def test_the_name_is_known_before_the_world_is_built(tmp_path: Path) -> None:
    from lirs_wct import build_world

    picture = tmp_path / "my dune.v2.png"
    cv2.imwrite(str(picture), np.tile(np.arange(33, dtype=np.uint8), (33, 1)))
    for options in (BuildOptions(), BuildOptions(name="other")):
        world = build_world(picture, options)
        assert RunTask(RunConfig(source=str(picture), build=options)).world == world.name
        world.save(tmp_path / "folder")
        for again in (BuildOptions(), BuildOptions(name="third")):
            source = str(tmp_path / "folder")
            assert RunTask(RunConfig(source=source, build=again)).world == build_world(source, again).name


def assert_same_run(a: Path, b: Path) -> None:
    """Compare the folders of two runs: all bytes, of the record all but the times."""
    assert {p.name for p in a.iterdir()} == {p.name for p in b.iterdir()}
    for file in a.iterdir():
        if file.name not in ("record.json", "rtf.csv", "overview.png", "manifest-sha256.txt"):
            assert file.read_bytes() == (b / file.name).read_bytes(), file.name
    one, other = read_record(a), read_record(b)
    assert {k: v for k, v in one.items() if k not in TIMES} == {
        k: v for k, v in other.items() if k not in TIMES
    }
    assert one["mapper"]["counts"] == other["mapper"]["counts"]
    assert one["cost"]["scans_dropped"] == other["cost"]["scans_dropped"] == 0
    assert not one["rtf"]["extrapolated"]
    assert one["cost"]["cpu_seconds"] > 0
    assert one["cost"]["peak_memory"] > 50e6


@pytest.mark.slow
def test_engines_give_the_same_bytes(room: str, tmp_path: Path) -> None:
    experiment = RunTask(RunConfig(source=room, mapper="gmapping", seconds=2.0))
    for name, engine in (("a", Serial()), ("b", Processes(jobs=1))):
        assert [o.status for o in Sweep([experiment], tmp_path / name).run(engine)] == ["ok"]
    assert_same_run(tmp_path / "a" / experiment.name, tmp_path / "b" / experiment.name)


@pytest.mark.slow
def test_a_cold_cache_gives_the_same_bytes(tmp_path: Path) -> None:
    experiment = RunTask(RunConfig(source="medium", seconds=1.0))
    (outcome,) = Sweep([experiment], tmp_path / "warm").run(Serial())
    assert outcome.status == "ok"
    command = [sys.executable, "-m", "lirs_validation", "validate", "medium", "--seconds", "1"]
    cold = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    subprocess.run([*command, "-o", str(tmp_path / "cold")], env=cold, check=True, stdout=subprocess.DEVNULL)
    assert list((tmp_path / "cache").rglob("*.nbc")), "it compiled its kernels"
    assert_same_run(tmp_path / "warm" / experiment.name, tmp_path / "cold" / experiment.name)


def test_a_single_cell_with_a_bad_source_says_so_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "cut.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    experiment = RunTask(RunConfig(source=str(tmp_path / "cut.png")))
    with pytest.raises(WctError, match=r"cut\.png: "):
        list(Sweep([experiment], tmp_path / "out").run(Serial()))
    assert not (tmp_path / "out").exists()
    both = [experiment, RunTask(replace(experiment.config, seed=2))]
    sweep = Sweep(both, tmp_path / "out")
    assert [outcome.status for outcome in sweep.run(Serial())] == ["error", "error"]
    assert "cut.png: " in read_record(tmp_path / "out" / experiment.name)["reason"]
