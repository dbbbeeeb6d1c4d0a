"""A drive in a page is the drive of `validate`: same record, whatever is looked at in between."""

import json
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_validation.config import MANUAL, RunConfig
from lirs_validation.experiment.run import run
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.construction import zip_folder
from lirs_validation.gui.controls import to_goal
from lirs_validation.gui.playback import LiveDrive, ate, read_playback, runs_in, unpacked_run
from lirs_validation.record.run_record import read_record, schema_error
from lirs_validation.record.verdict import judge
from lirs_wct.errors import ConfigError, SourceError
from slam_baselines.watch import Watch
from tests.kit import SMALL

FAILING = """
from slam_baselines.hector import HectorMapper
class Failing(HectorMapper):
    def update(self, scan, odometry, imu):
        if scan.stamp > 0.5: raise ValueError("no more")
        return super().update(scan, odometry, imu)
"""
LOOPING = """
from dataclasses import replace
from slam_baselines.hector import HectorMapper
class Looping(HectorMapper):
    @property
    def stats(self):
        found = super().stats
        return replace(found, lost=int(found.received > 50), counts={"loops": int(found.received > 25)})
"""
TIMED = {"rtf", "cost", "machine", "versions", "mapper"}
"""What is measured by the clock, or names the machine."""


pytestmark = pytest.mark.usefixtures("plain_pictures")


@pytest.fixture(scope="module")
def scenarios() -> ScenarioCache:
    return ScenarioCache()


def results(folder: Path) -> dict[str, Any]:
    entry = read_record(folder)
    counts = {key: value for key, value in entry["mapper"].items() if "ms" not in key and "milli" not in key}
    return {key: value for key, value in entry.items() if key not in TIMED} | {"mapper": counts}


def driven(config: RunConfig, scenarios: ScenarioCache, ticks: int | None = None) -> LiveDrive:
    drive = LiveDrive(config, scenarios)
    while not drive.over and (ticks is None or drive.scans <= ticks):
        drive.step()
        if drive.scans % 50 == 0:
            drive.moment(drive.scans // 2)  # somebody looks back
    return drive


@pytest.mark.parametrize(
    ("mapper", "driver"),
    [
        ("hector", "tour"),
        pytest.param("cartographer", "tour", marks=pytest.mark.slow),
        pytest.param("hector", "frontier", marks=pytest.mark.slow),
    ],
)
def test_a_saved_drive_is_validates_run(
    tmp_path: Path, scenarios: ScenarioCache, mapper: str, driver: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lirs_validation.gui.playback.MAP_WALL_SECONDS", 0.0)
    config = RunConfig(source="simple", build=SMALL, mapper=mapper, driver=driver, seconds=1.0, seed=2)
    by_validate = run(config, out=tmp_path / "validate", scenarios=scenarios).folder
    drive = driven(config, scenarios)
    by_page = drive.save(tmp_path / "page").folder
    assert by_validate is not None
    assert by_page is not None
    assert by_page.name == by_validate.name
    assert results(by_page) == results(by_validate)
    assert drive.moment(drive.scans - 1).verdict == f"Verdict: {judge(read_record(by_validate))}"
    for name in ("truth.tum", "estimate.tum", "odometry.tum", "commands.csv", "map.pgm", "map.yaml"):
        assert (by_page / name).read_bytes() == (by_validate / name).read_bytes(), name
    assert schema_error(json.loads((by_page / "record.json").read_text())) is None
    assert read_record(by_page)["rtf"]["concurrent"] is True
    replay = read_playback(by_page, scenarios)
    assert (replay.scans, replay.world is None) == (drive.scans, False)
    for k in (0, drive.scans // 2, drive.scans - 1):
        seen, replayed = drive.moment(k), replay.moment(k)
        assert replayed.time == pytest.approx(seen.time, abs=1e-4)
        np.testing.assert_allclose(replayed.truth, seen.truth, atol=1e-4)
        np.testing.assert_allclose(replayed.scan, seen.scan, atol=0.02)
    assert "simple, husky, " in dict(replay.moment(3).facts)["run"]


def test_a_failing_mapper_ends_the_drive_with_reason_and_verdict(
    tmp_path: Path, scenarios: ScenarioCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "page_slam.py").write_text(FAILING)
    monkeypatch.syspath_prepend(str(tmp_path))
    drive = driven(RunConfig(source="simple", mapper="page_slam:Failing", seconds=1.0), scenarios)
    assert drive.failed
    scans = drive.scans
    drive.step()
    assert drive.scans == scans
    moment = drive.moment(scans - 1)
    assert "failed for the scan at 0.52" in dict(moment.facts)["status"]
    assert moment.verdict.startswith("Verdict: Failing on husky gives no result on simple: mapper ")
    assert drive.marks == [(pytest.approx(0.5, abs=0.05), "error")]


@pytest.mark.slow
def test_closed_loops_and_lost_places_are_marked(
    tmp_path: Path, scenarios: ScenarioCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lirs_validation.gui.playback.MAP_WALL_SECONDS", 0.0)
    (tmp_path / "looping_slam.py").write_text(LOOPING)
    monkeypatch.syspath_prepend(str(tmp_path))
    drive = driven(RunConfig(source="simple", mapper="looping_slam:Looping", seconds=2.5), scenarios)
    assert [name for _, name in drive.marks] == ["loop closed", "lost"]
    assert [time for time, _ in drive.marks] == pytest.approx([1.0, 2.0], abs=0.1)


@pytest.mark.slow
def test_verdict_curve_and_events_follow_the_drive(scenarios: ScenarioCache) -> None:
    config = to_goal(RunConfig(source="simple", seconds=60.0), (-7.0, -13.0), (7.0, -11.0))
    drive = driven(config, scenarios, ticks=50)
    drive.log.watch = Watch(0.02)  # the start-up refinement moves the path
    early = drive.moment(50).verdict
    assert early.startswith("Verdict so far: hector on husky was not evaluated on simple: it drove ")
    while not drive.over:
        drive.step()
    last = drive.moment(drive.scans - 1)
    assert last.verdict.startswith("Verdict: hector on husky works on simple. ")
    curve = drive.curve()
    assert curve[:, 0] == pytest.approx(np.arange(1, len(curve) + 1))
    assert len(curve) == int(drive.time)
    scan = round(curve[4, 0] * 25)
    assert curve[4, 1] == ate(*drive.paths_until(scan))
    assert (curve[:, 2] > 0).all()
    assert last.errors[0] == 0.0
    assert last.errors == pytest.approx(np.hypot(*(last.truth[:, :2] - last.estimate).T))
    assert [name for _, name in drive.marks] == ["alarm"] * len(drive.log.watch.alarms) != []


def test_the_pretrained_policy_drives_to_the_clicked_goal(scenarios: ScenarioCache) -> None:
    chosen = RunConfig(source="simple", driver="pretrained", seconds=60.0)
    config = to_goal(chosen, (-7.0, -13.0), (-3.9, -12.8))
    assert config.driver == "pretrained:-3.9,-12.8"
    drive = driven(config, scenarios)
    while not drive.over:
        drive.step()
    assert drive.moment(drive.scans - 1).truth[-1, :2] == pytest.approx((-3.9, -12.8), abs=0.7)


def test_a_drive_goes_on_after_it_was_saved(tmp_path: Path, scenarios: ScenarioCache) -> None:
    config = RunConfig(source="simple", build=SMALL, seconds=1.0)
    once = driven(config, scenarios).save(tmp_path / "once").record
    drive = driven(config, scenarios, ticks=10)
    early = drive.save(tmp_path / "twice").record
    assert early.status == "ok"
    assert early.reason.startswith("stopped by hand at 0.4")
    while not drive.over:
        drive.step()
    late = drive.save(tmp_path / "twice").record
    assert (late.status, late.reason) == ("ok", "")
    assert late.trajectory == once.trajectory
    assert late.map == once.map


def test_a_person_takes_over_and_the_record_says_so(tmp_path: Path, scenarios: ScenarioCache) -> None:
    config = RunConfig(source="simple", build=SMALL, seconds=1.0)
    drive = driven(config, scenarios, ticks=5)
    drive.driver.by_hand = True
    drive.driver.steer(1.0, 5.0)  # beyond its limits
    for _ in range(10):
        drive.step()
    drive.driver.by_hand = False
    for _ in range(10):
        drive.step()
    saved = drive.save(tmp_path)
    assert saved.record.config.driver == MANUAL
    commands = saved.log.commands
    assert {(c.v, c.omega) for c in list(commands)[5:15]} == {(1.0, 2.0)}
    assert saved.folder is not None
    assert schema_error(json.loads((saved.folder / "record.json").read_text())) is None
    again = run(
        RunConfig(source="simple", build=SMALL, seconds=0.5, driver=f"replay:{saved.folder}"),
        scenarios=scenarios,
    )
    assert [p.position.tolist() for p in again.log.truth] == [
        p.position.tolist() for p in list(saved.log.truth)[: len(again.log.truth)]
    ]
    with pytest.raises(ConfigError, match="replay:RUN drives the same again"):
        run(RunConfig(source="simple", driver=MANUAL), scenarios=scenarios)


def test_moments_are_the_drive(scenarios: ScenarioCache) -> None:
    drive = driven(RunConfig(source="simple", build=SMALL, seconds=3.0), scenarios)
    assert drive.scans == 76  # 25 Hz
    begin, middle, end = (drive.moment(k) for k in (0, 25, 75))
    assert (begin.time, middle.time, end.time) == pytest.approx((0.0, 1.0, 3.0))
    assert len(middle.truth) == len(middle.estimate) == 26
    np.testing.assert_array_equal(end.truth[:26], middle.truth)
    assert begin.map is not None
    assert end.map is not None
    assert end.map.grid.known.sum() > begin.map.grid.known.sum()
    assert np.linalg.norm(end.truth[-1, :2] - end.estimate[-1]) < 0.1
    # The scan lies on the ground or on what stands there.
    x, y, z = end.scan.T
    around = [drive.world.surface.height_at(x + dx, y + dy) for dx in (-0.15, 0.15) for dy in (-0.15, 0.15)]
    met = (np.min(around, axis=0) < z + 0.1) & (z - 0.1 < np.max(around, axis=0))
    assert len(z) > 50
    assert met.mean() > 0.98
    assert dict(end.facts)["status"] == "ok"
    assert dict(begin.facts)["time"] == "0.0 of 3 s (0 %)"


def test_two_drives_at_a_time_do_not_disturb_each_other(tmp_path: Path, scenarios: ScenarioCache) -> None:
    configs = [RunConfig(source="simple", build=SMALL, seconds=0.6, seed=seed) for seed in (1, 2)]
    alone = [driven(config, scenarios).save(tmp_path / "alone").record for config in configs]
    together: dict[int, Any] = {}

    def drive(config: RunConfig) -> None:
        together[config.seed] = driven(config, scenarios).save(tmp_path / "together").record

    threads = [threading.Thread(target=drive, args=(config,)) for config in configs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for record in alone:
        assert together[record.config.seed].trajectory == record.trajectory
        assert together[record.config.seed].map == record.map


def test_an_uploaded_run_opens_no_file_of_the_server(
    finished_run: Path, tmp_path: Path, picture: Path
) -> None:
    unpacked = unpacked_run(zip_folder(finished_run), tmp_path / "run")
    record = json.loads((unpacked / "record.json").read_text())
    record["config"]["source"] = str(picture)
    (unpacked / "record.json").write_text(json.dumps(record))
    assert read_playback(unpacked).world is not None
    sent = read_playback(unpacked, uploaded=True)
    assert sent.world is None
    assert "not looked for" in sent.note
    assert sent.moment(10).map is not None


def test_a_run_is_sent_as_a_zip(finished_run: Path, tmp_path: Path, scenarios: ScenarioCache) -> None:
    unpacked = unpacked_run(zip_folder(finished_run), tmp_path / "run")
    assert read_playback(unpacked, scenarios).scans == 101
    for folder in (finished_run.parent, finished_run):
        assert runs_in(folder) == {finished_run.name: finished_run}
    with pytest.raises(SourceError, match="cannot be read"):
        unpacked_run(b"no zip", tmp_path / "none")
    with pytest.raises(SourceError, match="holds no run"):
        unpacked_run(zip_folder(unpacked.parent / "none"), tmp_path / "none")
