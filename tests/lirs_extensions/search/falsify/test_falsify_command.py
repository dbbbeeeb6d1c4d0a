"""The command on real drives: a failure from the search to its replay."""

import json
import sys
from pathlib import Path

import pytest

from lirs_extensions.search.falsify.search import DriveScore
from lirs_wct.drawing.canvas import bare_figure
from lirs_wct.errors import MapperError
from tests.command_line import run_command

MAPPER = '''
from examples.your_own_mapper import DeadReckoning


class HalfWay(DeadReckoning):
    """Takes every distance for half of what it is."""

    def update(self, scan, odometry, imu):
        return super().update(scan, type(odometry)(odometry.x / 2, odometry.y / 2, odometry.yaw), imu)


class Raises(DeadReckoning):
    def update(self, scan, odometry, imu):
        raise ValueError("no scan matcher")
'''
SEARCH = ("--mapper", "half_way:HalfWay", "--seconds", "16", "--drives", "20", "--cases", "1", "-o", "out")
DRIVEN = ("truth.tum", "estimate.tum", "odometry.tum", "commands.csv", "map.pgm")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "half_way.py").write_text(MAPPER)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "half_way", raising=False)
    # In the drives' process, which is there already.
    monkeypatch.setattr("lirs_validation.experiment.mapper_under_test.needs_process", lambda mapper: False)
    return tmp_path


@pytest.mark.slow
def test_a_failure_is_found_written_and_replayed_byte_for_byte(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command("falsify", *SEARCH) == 0
    assert "HalfWay on husky fails on the easiest ground already." in capsys.readouterr().out
    case = folder / "out" / "case-1"
    first = contents(case / "run", DRIVEN)
    (found,) = json.loads((folder / "out" / "falsify.json").read_text())["cases"]
    assert found["drives"] == 6
    assert json.loads((case / "run" / "record.json").read_text())["config"]["source"] == "out/case-1"
    files = [path for path in (folder / "out").rglob("*") if path.is_file()]
    assert not [path for path in files if b"staged" in path.read_bytes()], "paths of a folder that is gone"
    assert (case / "case.png").stat().st_size > 10_000
    assert "case-1" in (folder / "out" / "falsify.html").read_text()
    assert run_command("validate", "--suite", "out/cases.yaml", "-o", "again", "--gate") == 4
    (replayed,) = (folder / "again").glob("case-1-*")
    assert contents(replayed, DRIVEN) == first
    # The same command writes the same, and another mapper takes the suite.
    kept = ("drives.jsonl", "falsify.json", "cases.md", "cases.yaml")
    written = contents(folder / "out", kept)
    assert run_command("falsify", *SEARCH, "--jobs", "2") == 0
    assert contents(folder / "out", kept) == written
    assert contents(case / "run", DRIVEN) == first
    assert run_command("validate", "out/case-1", "--mapper", "hector", "-o", "other", "--gate") == 0


@pytest.mark.parametrize("driven", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_mapper_that_raises_is_a_case_without_a_run(
    folder: Path, driven: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> DriveScore:
        raise MapperError("no scan matcher")

    if not driven:
        monkeypatch.setattr("lirs_extensions.search.falsify.search._measure_mapper", fail)
        monkeypatch.setattr("lirs_extensions.search.falsify.results.run", fail)
        monkeypatch.setattr(
            "lirs_extensions.search.falsify.results.case_figure", lambda *_: bare_figure(1, 1)
        )
    kept = folder / "out" / "case-of-mine" / "notes.txt"
    kept.parent.mkdir(parents=True)
    kept.write_text("not of a search")
    options = ("--mapper", "half_way:Raises", "--seconds", "2", "--drives", "10", "--cases", "1", "-o", "out")
    assert run_command("falsify", *options) == 0
    case = folder / "out" / "case-1"
    assert (case / "case.yaml").is_file()
    assert not (case / "run").exists()
    assert (case / "case.png").stat().st_size > (10_000 if driven else 100)
    assert "no scan matcher" in (folder / "out" / "falsify.html").read_text()
    assert kept.is_file()


def contents(folder: Path, names: tuple[str, ...]) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in names}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--limits", "within.yaml"), "within.yaml: slope must be a number or [low, high]"),
        (("--limits", "none.yaml"), "none.yaml: cannot be read"),
        (("--mapper", "hectr"), "did you mean hector"),
        (("--robot", "huskie"), "did you mean husky"),
        (("--policy", "astra"), "did you mean astar"),
        (("--mapper", "gmapping", "--policy", "straight"), "and --policy straight: give one"),
        (("--policy", "astar"), "--reference must be another method than astar"),
        (("--drives", "0"), "drives must be within [1, 100000], got 0"),
        (("--drives", "nan"), "--drives must be a whole number, got 'nan'"),
        (("--seconds", "1e30"), "seconds must be within (0, 1e6] simulated seconds, got 1e+30"),
    ],
)
def test_bad_input_is_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], message: str
) -> None:
    (folder / "within.yaml").write_text("slope: [9, 1]\n")
    assert run_command("falsify", *arguments, "-o", "out") == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cases: []", "`cases` must be a list of folders"),
        ("cases: [none]", "none is no case"),
        ("3", "must hold names and values"),
        ("a: [", "line"),
    ],
)
def test_a_bad_suite_is_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    (folder / "cases.yaml").write_text(text)
    assert run_command("validate", "--suite", "cases.yaml", "-o", "out") == 2
    error = capsys.readouterr().err
    assert error.startswith("lirs-wct: cases.yaml: ")
    assert message in error


@pytest.mark.slow
def test_a_policy_fails_where_the_upper_bound_succeeds(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "within.yaml").write_text("obstacles: [40, 60]\nslope: 0\nrelief: 0\nroughness: 0\n")
    options = ("--policy", "straight", "--drives", "30", "--cases", "1", "--limits", "within.yaml")
    assert run_command("falsify", *options, "-o", "out") == 0
    assert "straight on husky fails" in capsys.readouterr().out
    suite = ("--set", "out/cases.json", "--task", "navigation", "-o", "bench")
    assert run_command("bench", "straight", "astar", *suite) == 0
    scores = json.loads((folder / "bench" / "scores-cases-navigation-test.json").read_text())
    assert scores
