"""Decision: drives until decided, which count, what is tried then, and the files of the result."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_extensions.decide.decide import Answer, Trial, TrialDrive, changes, decide
from lirs_extensions.decide.page import failure_place, write_decision
from lirs_validation.config import EngineOptions, RunConfig
from lirs_validation.experiment.scenario import ScenarioCache, build_scenario
from lirs_validation.sweep.sweep import Outcome
from lirs_validation.sweep.tasks import RunTask
from lirs_wct.errors import ConfigError, WctError
from lirs_wct.formats.drive_files import write_tum
from lirs_wct.geometry import Pose2, Trajectory
from tests.lirs_validation.records import record, saved_whole

CONFIG = RunConfig(source="simple", mapper="hector", seconds=20)
ENGINE = EngineOptions()


def path(drift: float) -> Trajectory:
    """Five seconds eastward at 1 m/s, with a drift to the north in m/s."""
    return Trajectory.from_poses(np.arange(5.0), [Pose2(float(k), drift * k) for k in range(5)])


PATH = path(0.0)


@pytest.fixture
def driven(room: str, monkeypatch: pytest.MonkeyPatch) -> list[RunConfig]:
    """Drives that take no time: `hector` works, the others fail; with seeds above 100 the robot tips over."""
    configs: list[RunConfig] = []

    def perform(
        experiment: RunTask, out: Path, scenarios: object, progress: object, *, concurrent: bool
    ) -> Outcome:
        config = experiment.config
        configs.append(config)
        works = config.mapper == "hector" and config.attitude == "imu" and config.lidar is None
        status: Any = "tipped" if config.seed > 100 else "ok"
        made = record("simple", ate=0.02 if works else 1.0, status=status)
        folder = saved_whole(out, replace(made, config=config))
        for name in ("truth", "estimate"):
            write_tum(folder / f"{name}.tum", PATH)
        return Outcome(task=experiment.name, status=status, written=True)

    scenario = build_scenario(RunConfig(source=room))
    scenario = replace(scenario, world=replace(scenario.world, name="simple"))
    monkeypatch.setattr(ScenarioCache, "scenario", lambda _, config: replace(scenario, config=config))
    monkeypatch.setattr("lirs_extensions.decide.decide.forecast", lambda *_: 0.7)
    monkeypatch.setattr(RunTask, "run", perform)
    monkeypatch.setattr("lirs_validation.sweep.sweep.damaged_files", lambda *_: [])
    return configs


def test_drives_end_with_the_decision_and_then_changes_are_tried(
    driven: list[RunConfig], tmp_path: Path
) -> None:
    configs = [CONFIG, replace(CONFIG, mapper="hector_original")]
    works, fails = decide(configs, tmp_path, ENGINE, budget=60)
    assert (works.trial.decision, len(works.trial.drives)) == ("works", 10)
    assert (fails.trial.decision, len(fails.trial.drives)) == ("does not work", 3)
    assert [drive.seed for drive in works.trial.drives] == list(range(1, 11))
    assert {label: trial.decision for label, trial in works.changed} == {
        "without IMU attitude": "does not work",
        "lidar rplidar_a1 (12 m)": "does not work",
        "twice the odometry noise": "works",
    }
    assert dict(fails.changed)["terrain-aware hector"].decision == "works"
    assert "hector on husky works on simple: it worked in 10 of 10 drives" in works.sentence
    assert "It fails without IMU attitude (0 of 3), with lidar rplidar_a1 (12 m) (0 of 3)." in works.sentence
    assert "at least 80 %" not in works.sentence
    assert "Most frequent failure: loses its way (3 of 3), as with seed 1." in fails.sentence
    assert "It works with terrain-aware hector (10 of 10)." in fails.sentence


def test_waypoints_are_checked_before_any_drive(driven: list[RunConfig], tmp_path: Path) -> None:
    waypoints = tmp_path / "way.csv"
    waypoints.write_text("x,y\n0,0\n1000,0\n")
    with pytest.raises(WctError, match=r"way\.csv"):
        decide([replace(CONFIG, driver=f"waypoints:{waypoints}")], tmp_path / "out", ENGINE, budget=60)
    assert not driven
    assert not (tmp_path / "out").exists()


def test_without_time_nothing_is_decided(driven: list[RunConfig], tmp_path: Path) -> None:
    (answer,) = decide([CONFIG], tmp_path, ENGINE, budget=0)
    assert not driven
    assert answer.trial.decision == "undecided"
    assert answer.sentence.startswith("hector on husky is undecided on simple: no drive was evaluated.")
    assert answer.sentence.endswith("The forecast is that it works in 70 % of the drives.")


def test_a_terrain_that_the_robot_cannot_drive_ends_the_drives(
    driven: list[RunConfig], tmp_path: Path
) -> None:
    (answer,) = decide([replace(CONFIG, seed=101)], tmp_path, ENGINE, budget=60)
    assert (answer.trial.decision, len(answer.trial.drives), answer.changed) == ("cannot be driven", 10, ())
    assert answer.sentence == (
        "husky cannot drive simple: 10 of 10 drives were not evaluated; most often (10): it ended: tipped."
    )


def test_a_robot_without_room_is_refused_before_any_drive(hills: dict[str, Any], tmp_path: Path) -> None:
    tiny = replace(CONFIG, source=hills["source"], build=replace(CONFIG.build, size=1.0))
    with pytest.raises(ConfigError, match="husky"):
        decide([tiny], tmp_path, ENGINE, budget=60)
    assert not list(tmp_path.iterdir())


def drives(kinds: str) -> tuple[TrialDrive, ...]:
    names: dict[str, Any] = {"w": "works", "l": "loses its way", "n": "not evaluated"}
    return tuple(TrialDrive(k, names[letter], "", "", "", "") for k, letter in enumerate(kinds, start=1))


@pytest.mark.parametrize(
    ("kinds", "decision", "more"),
    [
        ("", "undecided", 3),
        ("w", "undecided", 3),
        ("www", "undecided", 4),
        ("wwwwwwwww", "undecided", 1),
        ("w" * 10, "works", 0),
        ("lll", "does not work", 0),
        ("nnnnn", "undecided", 3),
        ("nnnnnnnnn", "undecided", 1),
        ("nnnnnnwwww", "cannot be driven", 0),
        ("nnnnnwwwww", "undecided", 4),
    ],
)
def test_drives_that_were_not_evaluated_are_repeated(kinds: str, decision: str, more: int) -> None:
    trial = Trial(CONFIG, drives(kinds))
    assert trial.decision == decision
    configs = trial.next_configs()
    assert [config.seed for config in configs] == [1 + len(kinds) + k for k in range(more)]


def test_drives_that_are_too_short_are_no_fault_of_the_terrain() -> None:
    sentence = Answer("simple", Trial(CONFIG, drives("n" * 10))).sentence
    assert sentence == (
        "husky drives too short a path on simple: 10 of 10 drives were not evaluated; raise --seconds."
    )


def test_the_most_frequent_failure_is_named_with_its_cause() -> None:
    made = tuple(replace(drive, reason="no walls within 20 m") for drive in drives("nll"))
    assert Answer("quarry", Trial(CONFIG, made)).sentence.endswith(
        "Most frequent failure: loses its way (2 of 2), as with seed 2: no walls within 20 m."
    )


def test_a_promise_needs_the_whole_interval() -> None:
    sentence = Answer("simple", Trial(CONFIG, drives("w" * 10))).sentence
    assert "at least 80 %" not in sentence
    assert "at least 80 %" in Answer("simple", Trial(CONFIG, drives("w" * 17))).sentence


def test_changes_of_clouds_and_of_foreign_mappers() -> None:
    cloud = replace(CONFIG, mapper="genz-icp", lidar="vlp16")
    assert list(changes(cloud, works=False)) == ["half the odometry noise"]
    blind = replace(CONFIG, attitude="none")
    assert list(changes(blind, works=False)) == [
        "with IMU attitude",
        "lidar lms1xx (30 m)",
        "half the odometry noise",
    ]


def test_a_failure_is_where_the_drive_ended_or_the_error_exceeded_the_limit() -> None:
    entry = {
        "status": "ok",
        "verdict": {"class": "loses its way", "reasons": [{"figure": "trajectory error", "limit": 0.5}]},
    }
    assert failure_place(entry, PATH, path(0.3)) == pytest.approx((2.0, 0.0))
    assert failure_place(entry, PATH, PATH) is None
    assert failure_place(entry | {"status": "tipped"}, PATH, PATH) == pytest.approx((4.0, 0.0))


def test_page_picture_and_json_are_written(driven: list[RunConfig], tmp_path: Path) -> None:
    answers = decide([CONFIG], tmp_path, ENGINE, budget=60)
    page = write_decision(tmp_path, answers, "lirs-wct verdict simple <x>")
    html = page.read_text(encoding="utf-8")
    assert answers[0].sentence in html
    assert "lirs-wct verdict simple &lt;x&gt;" in html
    assert (tmp_path / "verdict.png").stat().st_size > 10_000
    (answer,) = json.loads((tmp_path / "verdict.json").read_text(encoding="utf-8"))["answers"]
    assert (answer["decision"], answer["share"], len(answer["drives"])) == ("works", 1.0, 10)
    assert answer["interval"] == pytest.approx([0.6915, 1.0], abs=1e-4)
