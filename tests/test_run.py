"""A whole run: what it writes, that it repeats to the byte, that failures are told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lirs_envs.drive import Twist
from lirs_envs.simulation import Observation
from lirs_validation import RunConfig, cli, read_record, validate
from lirs_validation.loop import LOST_SECONDS, drive, per_second
from lirs_validation.run import Run
from lirs_validation.stage import set_stage
from lirs_wct.errors import ConfigError, SimulationError, SourceError
from lirs_wct.formats.map_server import read_map
from lirs_wct.formats.tum import read_tum
from lirs_wct.pose import Pose2, Pose3
from lirs_wct.scan import Imu, LaserScan

FILES = {
    "record.json", "overview.png", "rtf.csv", "truth.tum", "estimate.tum", "odometry.tum",
    "map.pgm", "map.yaml", "map_true_pose.pgm", "map_true_pose.yaml", "scans.clf.gz",
}  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return validate("medium", seconds=12, seed=3, out=tmp_path_factory.mktemp("out"))


def test_the_folder_holds_everything_and_nothing_else(run: Run) -> None:
    assert run.folder is not None
    assert {p.name for p in run.folder.iterdir()} == FILES
    assert run.folder.name == f"medium-husky-hector-s3-{run.record.config.digest}"
    assert [p for p in run.folder.parent.iterdir() if p.name.startswith(".")] == []


def test_the_record_holds_the_figures_of_the_definitions(run: Run) -> None:
    assert run.folder is not None
    record = read_record(run.folder)
    assert record["status"] == "ok"
    assert record["rtf"]["mean"] > 0.3
    assert set(record["rtf"]["parts"]) == {"physics", "sensors", "mapper", "rest"}
    assert sum(record["rtf"]["parts"].values()) == pytest.approx(1 / record["rtf"]["mean"])
    assert record["rtf"]["physics_only"] > record["rtf"]["mean"]
    assert len(record["rtf"]["series"]) == 12
    assert record["trajectory"]["length"] > 4
    assert record["trajectory"]["ate_rmse"] < 0.15
    assert record["map"]["f1"] > 0.5
    assert record["map"]["f1_input"] is None
    assert record["collisions"]["max_penetration"] < 0.02
    assert record["world"]["contact"]["vertical"] <= 0.01
    assert record["seed"] == record["config"]["seed"] == 3
    assert {"mujoco", "numpy", "python"} <= set(record["versions"])


def test_the_files_open_where_they_should(run: Run) -> None:
    assert run.folder is not None
    truth, estimate = read_tum(run.folder / "truth.tum"), read_tum(run.folder / "estimate.tum")
    assert len(truth) == len(estimate) == 301
    np.testing.assert_allclose(truth.stamps, np.arange(301) * 0.04, atol=1e-9)
    np.testing.assert_allclose(truth.xy[0], estimate.xy[0], atol=1e-9)
    built = read_map(run.folder / "map.yaml")
    assert built.occupied.sum() == run.maps.built.occupied.sum()


def test_the_same_seed_gives_the_same_bytes(run: Run, tmp_path: Path) -> None:
    again = validate("medium", seconds=12, seed=3, out=tmp_path)
    assert run.folder is not None
    assert again.folder is not None
    for name in ("truth.tum", "estimate.tum", "odometry.tum", "map.pgm", "map.yaml", "map_true_pose.pgm"):
        assert (run.folder / name).read_bytes() == (again.folder / name).read_bytes(), name
    other = validate("medium", seconds=12, seed=4).log
    assert other.truth[-1] != again.log.truth[-1]


def test_a_large_terrain_is_cut_to_its_middle() -> None:
    from lirs_wct import BuildOptions

    stage = set_stage(RunConfig(source="medium", build=BuildOptions(size=300)))
    assert stage.window == (0.0, 0.0, 50.0)
    assert max(stage.world.surface.size) <= 51
    assert set_stage(RunConfig(source="medium")).window is None


def test_configs_differ_in_their_digest() -> None:
    config = RunConfig(source="simple")
    assert config.digest == RunConfig(source="simple").digest
    assert config.digest != replace(config, seconds=60.0).digest
    for wrong in ({"seconds": 0.0}, {"seconds": float("nan")}, {"seed": -1}):
        with pytest.raises(ConfigError):
            RunConfig(source="simple", **wrong)  # type: ignore[arg-type]


def test_a_record_that_is_none_is_named(tmp_path: Path) -> None:
    for text in ("", "{}", json.dumps({"schema": 0})):
        (tmp_path / "record.json").write_text(text)
        with pytest.raises(SourceError, match=r"record\.json: "):
            read_record(tmp_path)


class Puppet:
    """Simulation, driver and mapper in one, each of which can fail at a tick."""

    period = 0.04
    start = Pose2()
    T_world_base = Pose3()

    def __init__(self, fails: str, at: int) -> None:
        self.fails, self.at, self.ticks = fails, at, 0

    def _failing(self, name: str) -> bool:
        return self.fails == name and self.ticks >= self.at

    time = property(lambda self: self.ticks * self.period)
    tipped = property(lambda self: self._failing("tipped"))
    off_world = property(lambda self: self._failing("off world"))
    stuck = property(lambda self: self._failing("stuck"))
    lost = property(lambda self: self._failing("lost"))

    def reset(self, start: Pose2) -> Observation:
        return self.advance(Twist(0, 0))

    def advance(self, command: Twist) -> Observation:
        self.ticks += 1
        if self._failing("diverged"):
            raise SimulationError("the simulation diverged: NaN in qacc")
        scan = LaserScan(np.ones(3, np.float32), 0, 0.1, 0.1, 9, self.ticks * self.period)
        return Observation(scan, Pose2(), Imu())

    def command(self, pose: Pose2, time: float) -> Twist:
        return Twist(0, 0)

    def update(self, *_: object) -> Pose2:
        return Pose2()


@pytest.mark.parametrize("fails", ["tipped", "off world", "stuck", "diverged", "lost"])
def test_a_failure_ends_the_run_and_is_in_the_log(fails: str) -> None:
    puppet = Puppet(fails, 10)
    log = drive(puppet, puppet, puppet, 20.0)  # type: ignore[arg-type]
    assert log.status == fails
    assert log.reason
    assert puppet.ticks <= 11 + (LOST_SECONDS / puppet.period if fails == "lost" else 0)
    assert len(log.observations) == len(log.truth) == len(log.estimates)


def test_a_run_without_failure_lasts_its_time() -> None:
    puppet = Puppet("nothing", 0)
    assert drive(puppet, puppet, puppet, 2.0).status == "ok"  # type: ignore[arg-type]
    assert puppet.ticks == 1 + 50


def test_seconds_are_summed_by_simulated_second() -> None:
    np.testing.assert_allclose(per_second([0.01] * 50, 0.04), [0.25, 0.25])
    np.testing.assert_allclose(per_second([0.01] * 30, 0.04), [0.25, 0.25])


def test_a_failed_run_is_told_in_table_and_exit_code(
    run: Run, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    failed = replace(run, record=replace(run.record, status="tipped", reason="the robot tipped over at 3 s"))
    monkeypatch.setattr("lirs_validation.progress.run_with_progress", lambda *_: iter([run, failed]))
    monkeypatch.setattr("sys.argv", ["lirs-wct", "validate", "medium"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 3
    assert "tipped" in capsys.readouterr().out
