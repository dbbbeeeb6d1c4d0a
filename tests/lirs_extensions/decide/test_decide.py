"""Decision: drives until decided, which count, what is tried then, and the files of the result."""

import json
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_extensions.decide.decide import (
    Answer,
    Budget,
    Change,
    Question,
    TimedDrives,
    Trial,
    TrialDrive,
    decide,
)
from lirs_extensions.decide.forecast import NO_INFORMATION, DriveSite, SiteFeatures, changes
from lirs_extensions.decide.page import conclusion, drives_table, failure_place, write_decision
from lirs_validation.config import EngineOptions, RunConfig
from lirs_validation.experiment.scenario import ScenarioCache, build_scenario
from lirs_validation.sweep.sweep import Outcome
from lirs_validation.sweep.tasks import RunTask
from lirs_wct.errors import ConfigError, WctError
from lirs_wct.formats.drive_files import write_tum
from lirs_wct.geometry import Pose2, Trajectory
from tests.lirs_validation.records import record, saved_whole

CONFIG = RunConfig(source="simple", mapper="hector", seconds=20)
SEEN = SiteFeatures(
    **{"walls": 0.3, "walls_low": 0.2, "ground": 0.1, "position_information": -1.0, "yaw_information": -1.0},
    **{"loops": 0.1, "wall_scans": 1.0},
)


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
    monkeypatch.setattr(DriveSite, "features", lambda self, config=None: SEEN)
    monkeypatch.setattr(RunTask, "run", perform)
    monkeypatch.setattr("lirs_validation.sweep.sweep.damaged_files", lambda *_: [])
    return configs


class Slow:
    """Drives by a clock that only they move: wall seconds of a drive by mapper; negative = Ctrl-C."""

    def __init__(self) -> None:
        self.now, self.costs, self.order = 0.0, dict[str, float](), list[str]()

    def run(self, task: RunTask, out: Path, scenarios: object, progress: Any, **_: Any) -> Outcome:
        cost = self.costs[task.config.mapper]
        if cost < 0:
            raise KeyboardInterrupt
        for share in np.linspace(0.0, 1.0, 101):
            progress("drive", share)
            self.now += cost / 100
        self.order.append(task.config.mapper)
        made = replace(record("simple", ate=0.02), config=task.config)
        saved_whole(out, replace(made, rtf=made.rtf | {"wall_seconds": cost}))
        return Outcome(task=task.name, status="ok", written=True)


@pytest.fixture
def slow(driven: list[RunConfig], monkeypatch: pytest.MonkeyPatch) -> Slow:
    made = Slow()
    monkeypatch.setattr(RunTask, "run", lambda task, *given, **named: made.run(task, *given, **named))
    monkeypatch.setattr(time, "monotonic", lambda: made.now)
    return made


def ask_all(configs: list[RunConfig], out: Path, budget: float = 60.0, **engine: Any) -> tuple[Answer, ...]:
    options, timed = EngineOptions(**engine), Budget(budget, time.monotonic())
    return decide(configs, out, options, timed, scenarios=ScenarioCache(), again=AGAIN)


def AGAIN(budget: str | None) -> str:
    return f"lirs-wct verdict simple --budget {budget}"


def test_drives_end_with_the_decision_and_a_failing_method_gets_a_next_step(
    driven: list[RunConfig], tmp_path: Path
) -> None:
    configs = [CONFIG, replace(CONFIG, mapper="hector_original")]
    works, fails = ask_all(configs, tmp_path)
    assert (works.trial.decision, len(works.trial.drives), works.changes) == ("works", 10, ())
    assert (fails.trial.decision, len(fails.trial.drives)) == ("does not work", 3)
    assert [drive.seed for drive in works.trial.drives] == list(range(1, 11))
    assert conclusion(works).startswith("hector on husky works on simple: it worked in 10 of 10 drives")
    assert "at least 80 %" not in conclusion(works)
    assert "Most frequent failure: loses its way (3 of 3), as with seed 1." in conclusion(fails)
    command = "lirs-wct validate simple --robot husky --mapper hector --seed 1 --seconds 20"
    assert conclusion(fails).endswith(f"Next: `{command}` worked in 3 of 3 drives.")
    assert len(driven) == 13, "the change has drives in common with the other method"
    assert len({(config.mapper, config.seed) for config in driven}) == 13


def test_every_drive_is_listed_once_with_its_change(driven: list[RunConfig], tmp_path: Path) -> None:
    answers = ask_all([CONFIG, replace(CONFIG, mapper="hector_original")], tmp_path)
    rows = {row[0]: row[1] for row in drives_table(answers).rows}
    assert sorted(rows) == sorted(path.name for path in tmp_path.iterdir())
    assert len(drives_table(answers).rows) == len(rows)
    assert Counter(rows.values()) == {"-": 10, "-, terrain-aware hector": 3}


def test_nothing_is_named_if_nothing_tried_is_better(driven: list[RunConfig], tmp_path: Path) -> None:
    (answer,) = ask_all([replace(CONFIG, mapper="gmapping", attitude="none")], tmp_path)
    assert len(answer.changes) > 2
    assert all(len(change.drives) == 1 for change in answer.changes), "the first drive shows no gain"
    assert "Next:" not in conclusion(answer)
    assert "Nothing tried is better: with IMU attitude, 60 s, wheel_lio with lidar vlp16" in conclusion(
        answer
    )


def test_methods_advance_in_turn_by_their_time(slow: Slow, tmp_path: Path) -> None:
    slow.costs = {"hector": 1.0, "gmapping": 8.5}
    hector, gmapping = ask_all([CONFIG, replace(CONFIG, mapper="gmapping")], tmp_path, budget=40.0)
    assert hector.trial.decision == "works"
    assert slow.order[:10] == ["hector", "gmapping", *["hector"] * 8]
    assert gmapping.trial.decision == "undecided"
    assert slow.now <= 40.0


def test_a_drive_that_would_end_too_late_is_stopped_and_leaves_nothing(
    slow: Slow, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    slow.costs = {"hector": 120.0}
    (answer,) = ask_all([CONFIG], tmp_path, budget=60.0)
    assert slow.now < 10.0, "its first seconds show it"
    assert list(tmp_path.iterdir()) == []
    assert "hector on husky: 10 drives need 20 min: --budget 21min" in capsys.readouterr().err
    text = conclusion(answer)
    assert text.endswith("10 drives need 20 min: `lirs-wct verdict simple --budget 21min`.")


def test_the_command_that_continues_names_the_change_that_it_drives(slow: Slow, tmp_path: Path) -> None:
    site = DriveSite(ScenarioCache().scenario(CONFIG).world, replace(CONFIG, mapper="hector_original"))
    lost = Trial(replace(CONFIG, mapper="hector_original"), drives("lll"))
    question = Question(site, lost, [Change(CONFIG, label="hector", least=lost.rank)])
    timed = TimedDrives(tmp_path, EngineOptions(), ScenarioCache(), Budget(60.0, 0.0))
    assert question.answer(timed, AGAIN).continuation == (
        "hector was not decided: `lirs-wct verdict simple --budget 2min` continues"
    )


def test_the_cost_of_earlier_drives_is_known(slow: Slow, tmp_path: Path) -> None:
    slow.costs = {"hector": 20.0}
    ask_all([CONFIG], tmp_path, budget=30.0)
    assert slow.order == ["hector"]
    (answer,) = ask_all([CONFIG], tmp_path, budget=15.0)
    assert slow.order == ["hector"], "the second is not even begun"
    assert (answer.trial.decision, len(answer.trial.drives)) == ("undecided", 1)
    assert "9 drives need 3 min" in conclusion(answer)


def test_a_person_ends_drives_as_before(slow: Slow, tmp_path: Path) -> None:
    slow.costs = {"hector": -1.0}
    with pytest.raises(KeyboardInterrupt):
        ask_all([CONFIG], tmp_path)


def test_without_any_wall_in_sight_nothing_is_driven(
    driven: list[RunConfig], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    blind = replace(SEEN, walls=0.0, wall_scans=0.0, position_information=NO_INFORMATION)
    monkeypatch.setattr(DriveSite, "features", lambda self, config=None: blind)
    planar, cloud = ask_all([CONFIG, replace(CONFIG, mapper="wheel_lio", lidar="vlp16")], tmp_path)
    assert planar.trial.decision == "does not work"
    assert {config.mapper for config in driven} == {"wheel_lio"}
    assert conclusion(planar) == (
        "hector on husky does not work on simple: 100 % of the scans along its tours "
        "meet no wall within 20 m. "
        "There is no other method, lidar or drive to try."
    )
    assert cloud.trial.drives


def test_waypoints_are_checked_before_any_drive(driven: list[RunConfig], tmp_path: Path) -> None:
    waypoints = tmp_path / "way.csv"
    waypoints.write_text("x,y\n0,0\n1000,0\n")
    with pytest.raises(WctError, match=r"way\.csv"):
        ask_all([replace(CONFIG, driver=f"waypoints:{waypoints}")], tmp_path / "out")
    assert not driven
    assert not (tmp_path / "out").exists()


def test_without_time_nothing_is_decided(driven: list[RunConfig], tmp_path: Path) -> None:
    (answer,) = ask_all([CONFIG], tmp_path, budget=0)
    assert not driven
    assert answer.trial.decision == "undecided"
    assert conclusion(answer) == (
        "hector on husky is undecided on simple: no drive was evaluated. The forecast is that it works in "
        "70 % of the drives. `lirs-wct verdict simple --budget None` continues."
    )


def test_a_terrain_that_the_robot_cannot_drive_ends_the_drives(
    driven: list[RunConfig], tmp_path: Path
) -> None:
    (answer,) = ask_all([replace(CONFIG, seed=101)], tmp_path)
    assert (answer.trial.decision, len(answer.trial.drives), answer.changes) == ("cannot be driven", 10, ())
    assert conclusion(answer) == (
        "husky cannot drive simple: 10 of 10 drives were not evaluated; most often (10): it ended: tipped."
    )


def test_a_robot_without_room_is_refused_before_any_drive(hills: dict[str, Any], tmp_path: Path) -> None:
    tiny = replace(CONFIG, source=hills["source"], build=replace(CONFIG.build, size=1.0))
    with pytest.raises(ConfigError, match="husky"):
        ask_all([tiny], tmp_path)
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
    trial = Trial(CONFIG, drives("n" * 10))
    sentence = conclusion(Answer("simple", trial))
    assert sentence == "husky drives too short a path on simple: 10 of 10 drives were not evaluated."
    longer = Change(replace(CONFIG, seconds=60), drives("w"), label="60 s", least=trial.rank)
    assert conclusion(Answer("simple", trial, (longer,))).endswith("--seconds 60` worked in 1 of 1 drives.")


def test_a_change_that_was_not_evaluated_is_not_called_worse() -> None:
    trial = Trial(CONFIG, drives("lll"))
    short, worse = (
        Change(CONFIG, drives(kinds), label=label, least=5)
        for kinds, label in (("n", "60 s"), ("l", "kiss-icp"))
    )
    assert conclusion(Answer("simple", trial, (short,))).endswith(". Not evaluated: 60 s.")
    both = conclusion(Answer("simple", trial, (short, worse)))
    assert both.endswith("Nothing tried is better: kiss-icp. Not evaluated: 60 s.")


def test_the_most_frequent_failure_is_named_with_its_cause() -> None:
    _, second, third = drives("nll")
    made = (*drives("n"), second, replace(third, reason="no walls within 20 m"))
    text = "Most frequent failure: loses its way (2 of 2), as with seed 3: no walls within 20 m."
    assert text in conclusion(Answer("quarry", Trial(CONFIG, made)))


def test_a_promise_needs_the_whole_interval() -> None:
    sentence = conclusion(Answer("simple", Trial(CONFIG, drives("w" * 10))))
    assert "at least 80 %" not in sentence
    assert "at least 80 %" in conclusion(Answer("simple", Trial(CONFIG, drives("w" * 17))))


def spread_of(kinds: str, errors: list[float | None]) -> str:
    """Return the sentence on the path errors of drives over 1, 2, 3, ... m."""
    made = [
        replace(drive, error=error, distance=float(k))
        for k, (drive, error) in enumerate(zip(drives(kinds), errors, strict=True), start=1)
    ]
    text = conclusion(Answer("simple", Trial(CONFIG, tuple(made))))
    return next((sentence for sentence in text.split(". ") if "path error" in sentence), "").rstrip(".")


def test_the_spread_of_path_errors_is_told_for_all_evaluated_drives() -> None:
    text = spread_of("wwwlwwwlww", [0.03, 0.05, 0.02, 7.0, 0.04, 0.06, 0.01, 0.9, 0.02, 0.05])
    assert text == "In 8 of 10 drives the path error is between 0.020 and 0.900 m after 5.5 m"
    text = spread_of("wnl", [0.03, 99.0, 1.5])
    assert text == "In all 2 drives the path error is between 0.030 and 1.500 m after 2.0 m"
    assert spread_of("nw", [99.0, 0.03]) == "In this drive the path error is 0.030 m after 2.0 m"
    assert spread_of("www", [0.03, None, 0.05]).startswith("In 2 of 3 drives the path error is between 0.030")
    assert spread_of("nn", [0.1, 0.2]) == spread_of("", []) == spread_of("ww", [None, None]) == ""


@pytest.mark.parametrize(
    ("config", "walls", "expected"),
    [
        (CONFIG, 0.5, ["60 s", "lidar lms1xx (30 m)", "wheel_lio with lidar vlp16"]),
        (replace(CONFIG, attitude="none", seconds=60), 0.5, ["with IMU attitude", "lidar lms1xx (30 m)"]),
        (replace(CONFIG, mapper="hector_original", seconds=60), 0.5, ["terrain-aware hector"]),
        (replace(CONFIG, mapper="slam_toolbox_original", seconds=60), 0.5, ["terrain-aware hector"]),
        (CONFIG, 0.01, ["wheel_lio with lidar vlp16"]),
        (replace(CONFIG, mapper="wheel_lio", lidar="vlp16", seconds=60), 0.01, ["lidar os1_32 (120 m)"]),
    ],
)
def test_changes_follow_the_diagnosis(
    config: RunConfig, walls: float, expected: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def features(self: DriveSite, other: RunConfig | None = None) -> SiteFeatures:
        return replace(SEEN, walls=walls if other is None else 2 * walls)

    monkeypatch.setattr(DriveSite, "features", features)
    found = list(changes(DriveSite(None, config), short=False))  # type: ignore[arg-type]
    assert found[: len(expected)] == expected
    assert list(changes(DriveSite(None, CONFIG), short=True)) == ["60 s"]  # type: ignore[arg-type]


def test_a_failure_is_where_the_drive_ended_or_the_error_exceeded_the_limit() -> None:
    entry = {
        "status": "ok",
        "verdict": {"class": "loses its way", "reasons": [{"figure": "trajectory error", "limit": 0.5}]},
    }
    assert failure_place(entry, PATH, path(0.3)) == pytest.approx((2.0, 0.0))
    assert failure_place(entry, PATH, PATH) is None
    assert failure_place(entry | {"status": "tipped"}, PATH, PATH) == pytest.approx((4.0, 0.0))


def test_page_picture_and_json_are_written(driven: list[RunConfig], tmp_path: Path) -> None:
    answers = ask_all([CONFIG], tmp_path)
    page = write_decision(tmp_path, answers, "lirs-wct verdict simple <x>", ScenarioCache())
    html = page.read_text(encoding="utf-8")
    assert conclusion(answers[0]) in html
    assert "lirs-wct verdict simple &lt;x&gt;" in html
    assert (tmp_path / "verdict.png").stat().st_size > 10_000
    (answer,) = json.loads((tmp_path / "verdict.json").read_text(encoding="utf-8"))["answers"]
    assert (answer["decision"], answer["share"], len(answer["drives"])) == ("works", 1.0, 10)
    assert answer["interval"] == pytest.approx([0.6915, 1.0], abs=1e-4)
    assert "In 8 of 10 drives the path error is between 0.020 and 0.020 m after 24.0 m." in html
    assert answer["path_error"] == {"inside": 8, "total": 10, "low": 0.02, "high": 0.02}
    assert {(drive["error"], drive["distance"]) for drive in answer["drives"]} == {(0.02, 24.0)}
