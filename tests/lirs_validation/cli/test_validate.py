"""`validate` over axes: what is wrong is said before anything runs; what failed is in table and exit code."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from lirs_validation import read_record
from lirs_validation.sweep.sweep import Outcome
from lirs_validation.sweep.tasks import RunTask
from lirs_wct.errors import MapperError
from slam_baselines.mapper import MAPPERS
from tests.command_line import run_command
from tests.lirs_validation.records import record, saved, saved_whole


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs that take no time; the one of seed 3 goes wrong."""

    def perform(
        experiment: RunTask, out: Path, scenarios: object, progress: object, *, concurrent: bool
    ) -> Outcome:
        if experiment.config.seed == 3:
            raise MapperError("update() must return a finite pose")
        saved_whole(out, replace(record(experiment.world), config=experiment.config))
        return Outcome(task=experiment.name, status="ok", written=True)

    monkeypatch.setattr(RunTask, "run", perform)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("simple", "--robot", "husky,huksy"), "unknown robot 'huksy'; legal: husky"),
        (("simple", "--mapper", "hector,slam"), "unknown mapper 'slam'; legal: "),
        (("simple", "--mapper", "nowhere:Slam"), "no module 'nowhere'"),
        (("simple", "--lidar", "lms111,sick"), "unknown lidar 'sick'; legal: "),
        (("simple", "smple"), "smple: no such file or folder"),
        (("simple", "--terrain", "hfield,lava"), "terrain must be hfield, mesh, prisms or convex, got"),
        (("simple", "--rays", "builtin,theirs"), "unknown rays 'theirs'; legal: builtin, mujoco"),
        (("simple", "--attitude", "imu,some"), "attitude must be imu or none, got 'some'"),
        (("simple", "--actors", "5,many"), "--actors must be a list such as 1-5 or 1,3,7-9, got '5,many'"),
        (("--suite", "paper", "--actors", "5"), "leave out --actors"),
        (("simple", "--robot", "husky,,jackal"), "--robot must be a list such as a,b,c"),
        (("simple", "--seed", "5-1"), "--seed must be a list such as 1-5 or 1,3,7-9, got '5-1'"),
        (("simple", "--jobs", "0"), "jobs must be at least 1, got 0"),
        (("simple", "--wall-limit", "0"), "wall limit must be a finite number above 0, got 0"),
        (("simple", "--option", "cell-timeout=-1"), "cell timeout must be a finite number above 0, got -1"),
        (("simple", "--option", "cell-timeout=nan"), "cell timeout must be a finite number above 0, got nan"),
        (("--suite", "paper", "--wall-limit", "0"), "wall limit must be a finite number above 0, got 0"),
        (("--suite", "paper", "--seconds", "0"), "seconds must be within (0, 1e6] simulated seconds, got 0"),
        (
            ("simple", "--driver", "tour,walk"),
            "--driver: unknown driver 'tour,walk'; legal: tour, frontier, ",
        ),
        (("simple", "--driver", "waypoints:none.csv"), "none.csv: cannot be read"),
        (("simple", "--driver", "tour,replay:none"), "none/record.json: not a run's record"),
        (("--suite", "paper", "--driver", "frontier"), "leave out --driver"),
        ((), "nothing to validate"),
        (("simple", "--seconds", "1e30"), "seconds must be within (0, 1e6] simulated seconds, got 1e+30"),
        (("simple", "--driver", "pretrained:1"), "driver pretrained:X,Y must be X,Y in meters, got '1'"),
        (
            ("simple", "--driver", "pretrained", "--option", "reversing=.5"),
            "pretrained: reversing must be 0, got 0.5",
        ),
        (("simple", "--mapper", "evalio:foo"), "unknown mapper 'evalio:foo'; legal: evalio:ct, "),
        (("simple", "--mapper-python", "/none"), "/none: no such program; --mapper-python takes a Python"),
        (("--suite", "papr"), "unknown suite 'papr'; legal: paper, paper-short"),
        (("simple", "--suite", "paper", "--robot", "husky"), "leave out --robot, sources"),
        (("--suite", "paper", "--size", "3"), "leave out options of build"),
    ],
)
def test_bad_input_is_one_line_before_anything_runs(
    arguments: tuple[str, ...], expected: str, wct: Any, tmp_path: Path
) -> None:
    code, _, complaint = wct("validate", *arguments)
    assert code == 2
    assert expected in complaint
    assert complaint.count("\n") == 1, "one line, and no empty one"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("quick")
def test_a_failed_cell_is_told_in_table_and_exit_code_and_the_rest_stand(wct: Any, tmp_path: Path) -> None:
    command = ("validate", "simple", "medium", "--mapper", "hector,gmapping", "--seed", "1-3")
    code, table, _ = wct(*command)
    assert code == 3
    assert "finite pose" in table
    folders = [path for path in (tmp_path / "out").iterdir() if path.is_dir()]
    assert len(folders) == 12
    assert sum(read_record(folder)["status"] == "error" for folder in folders) == 4

    code, _, notes = wct(*command)
    assert code == 3
    assert "kept 12 of 12 from before" in notes
    code, _, notes = wct(*command, "--retry-failed")
    assert code == 3
    assert "kept 8 of 12 from before; 4 to run" in notes
    code, _, notes = wct("validate", "simple", "--seed", "1-2")
    assert code == 0
    assert "kept 2 of 2 from before" in notes


@pytest.mark.parametrize(
    ("limits", "code"),
    [
        (None, 0),
        ("f1_aligned: 0.9\n", 0),
        ("f1_aligned: 0.99\n", 4),
        ("f1_aligned: 0.99\naccept: [path only]\n", 0),
        ("f1_aligned: 0.99\naccept: [no reference]\n", 4),
    ],
)
@pytest.mark.usefixtures("quick")
def test_the_gate_fails_unless_every_verdict_is_accepted(
    limits: str | None, code: int, wct: Any, tmp_path: Path
) -> None:
    options = ["--gate"]
    if limits is not None:
        (tmp_path / "limits.yaml").write_text(limits)
        options += ["--limits", "limits.yaml"]
    assert wct("validate", "simple", "--seed", "1,2", *options)[0] == code


@pytest.mark.usefixtures("quick")
def test_a_failed_run_ends_with_code_3_and_not_that_of_the_gate(wct: Any) -> None:
    assert wct("validate", "simple", "--seed", "1,3", "--gate")[0] == 3


@pytest.mark.usefixtures("quick")
def test_limits_need_the_gate(wct: Any, tmp_path: Path) -> None:
    (tmp_path / "limits.yaml").write_text("f1_aligned: 0.9\n")
    code, _, message = wct("validate", "simple", "--limits", "limits.yaml")
    assert (code, message.count("\n")) == (2, 1)
    assert "--limits is for --gate" in message
    assert not (tmp_path / "out").exists()


def store(folder: Path, seeds: range, **config: Any) -> None:
    """Write a baseline whose ATE is 5 mm above that of the quick runs, give or take 2."""
    for seed in seeds:
        saved(folder, "simple", seed, ate=0.025 + 0.002 * (-1) ** seed, **config)


@pytest.mark.usefixtures("quick")
def test_the_gate_with_a_baseline_names_what_is_significantly_worse(wct: Any, tmp_path: Path) -> None:
    gate = ("validate", "simple", "--seed", "1,2,4-8", "--seconds", "30", "--gate", "--baseline")
    store(tmp_path / "worse", range(1, 9))
    code, shown, _ = wct(*gate, "worse")
    assert code == 0
    assert shown.endswith("\ngate: none of 6 figures is significantly worse\n")
    for path in (tmp_path / "worse").glob("*/record.json"):
        stored = json.loads(path.read_text())
        stored["trajectory"]["ate_rmse"] -= 0.01
        path.write_text(json.dumps(stored))
    code, shown, _ = wct(*gate, "worse")
    assert code == 4
    named = "gate: worse than the baseline: ATE of hector on simple, husky: 0.015 -> 0.020 m"
    assert re.fullmatch(rf"{named} \(7 pairs, p = 0.00\d\)", shown.splitlines()[-1])
    code, shown, _ = wct("validate", "simple", "medium", *gate[2:], "worse")
    assert code == 4
    assert "gate: not in the baseline: hector on medium, husky\n" in shown


@pytest.mark.usefixtures("quick")
def test_a_baseline_needs_no_verdict_that_works_but_none_that_got_worse(wct: Any, tmp_path: Path) -> None:
    (tmp_path / "limits.yaml").write_text("f1_aligned: 0.99\n")
    gate = ("--seconds", "30", "--gate", "--limits", "limits.yaml", "--baseline", "base")
    store(tmp_path / "base", range(1, 9))
    assert wct("validate", "simple", "--seed", "1,2,4", *gate)[0] == 0
    for path in (tmp_path / "base").glob("*/record.json"):
        stored = json.loads(path.read_text())
        stored["map"]["f1_aligned"] = 1.0 - 0.008 * (stored["seed"] == 2)
        path.write_text(json.dumps(stored))
    code, shown, _ = wct("validate", "simple", "--seed", "1,2", *gate)
    assert code == 0
    code, shown, _ = wct("validate", "simple", "--seed", "1,2,4", *gate)
    assert code == 4
    assert "verdict of hector on simple, husky: works (3 of 3) -> path only (3 of 3)" in shown
    (tmp_path / "limits.yaml").write_text("f1_aligned: 0.99\naccept: [path only]\n")
    assert "verdict of hector" not in wct("validate", "simple", "--seed", "1,2,4", *gate)[1]


@pytest.mark.usefixtures("quick")
def test_a_gate_with_few_seeds_says_what_they_can_show(wct: Any, tmp_path: Path) -> None:
    store(tmp_path / "base", range(1, 9))
    gate = ("--seconds", "30", "--gate", "--baseline", "base")
    shown = wct("validate", "simple", "--seed", "1", *gate)[1]
    needed = "significant; 6 seeds find changes of 2 times their spread\n"
    assert f"gate: 1 pair of runs: no change is {needed}" in shown
    shown = wct("validate", "simple", "--seed", "1,2,4", *gate)[1]
    assert "gate: 3 pairs of runs: only changes above 6 times their spread over the seeds are" in shown
    assert needed in shown
    assert "pairs of runs" not in wct("validate", "simple", "--seed", "1,2,4-7", *gate)[1]
    assert wct("validate", "simple", "--seed", "1-4", *gate)[0] == 3


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--baseline", "base"), "--baseline is for --gate, which is not given"),
        (("--gate", "--baseline", "none"), "none: no such folder of results"),
        (("--gate", "--baseline", "empty"), "empty: holds no readable record of a run"),
        (("--gate", "--baseline", "base", "-o", "./base"), "base: the baseline must be another folder than"),
        (
            ("--gate", "--baseline", "base", "--mapper", "gmapping"),
            "such as gmapping, seed 1; got hector, seed 1",
        ),
        (("--gate", "--baseline", "base", "--seed", "9"), "such as simple, seed 9; got simple, seed "),
        (("--gate", "--baseline", "twice"), "move one of them to another folder"),
        (("--gate", "--baseline", "damaged"), ": record.json: not a run's record, or damaged"),
    ],
)
def test_a_wrong_baseline_is_one_line_before_anything_runs(
    options: tuple[str, ...], expected: str, wct: Any, tmp_path: Path
) -> None:
    store(tmp_path / "base", range(1, 3))
    (tmp_path / "empty").mkdir()
    shutil.copytree(tmp_path / "base", tmp_path / "damaged")
    shutil.copytree(saved(tmp_path / "twice"), tmp_path / "twice" / "copy")
    (next((tmp_path / "damaged").glob("*-s2-*")) / "record.json").write_text("{")
    before = sorted(tmp_path.rglob("*"))
    code, _, complaint = wct("validate", "simple", "--seconds", "30", *options)
    assert code == 2
    assert expected in complaint
    assert complaint.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


OFFICE = Path(__file__).parents[3] / "examples/data/office.yaml"
"""Walls on level ground: here the methods hold, and rounding does not lead them elsewhere."""


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in MAPPERS if name.endswith("_original")])
def test_a_run_mapped_again_from_its_scans_scores_as_the_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A log's ranges are in millimeters: all is the same where the method rounds to them itself."""
    monkeypatch.chdir(tmp_path)
    assert run_command("validate", str(OFFICE), "--mapper", name, "--seconds", "12", "-o", "runs") == 0
    (run,) = (tmp_path / "runs").glob("*/record.json")
    assert run_command("map", str(run.parent / "scans.clf.gz"), "--mapper", name, "-o", "maps") == 0
    (mapped,) = (tmp_path / "maps").glob("*/estimate.tum")
    files = ("--trajectory", str(mapped), "--map", str(mapped.with_name("map.yaml")))
    assert run_command("score", str(run.parent), *files, "-o", "score.json") == 0
    recorded, scored = (json.loads(path.read_text()) for path in (run, tmp_path / "score.json"))
    assert recorded["config"]["mapper"] == name
    ate, again = (entry["trajectory"]["ate_rmse"] for entry in (recorded, scored))
    rounds = name == "gmapping_original"
    assert again == pytest.approx(ate, abs=1e-6 if rounds else 1e-3)
    assert scored["map"]["f1"] == pytest.approx(recorded["map"]["f1"], abs=1e-6 if rounds else 0.03)
