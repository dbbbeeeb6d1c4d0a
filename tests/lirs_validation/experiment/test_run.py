"""A whole run: what it writes, that it repeats to the byte, that failures are told."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_envs.robots.robot import Twist, make_robot
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.simulation import Simulation
from lirs_validation import RunConfig, read_record, validate
from lirs_validation.config import ATTITUDES, Attitude
from lirs_validation.experiment.evaluation import evaluate_rtf, per_second, reference_rtf
from lirs_validation.experiment.mapper_under_test import LOST_SECONDS
from lirs_validation.experiment.run import Run, prepare
from lirs_validation.experiment.scenario import ScenarioCache, build_scenario
from lirs_validation.sweep.tasks import RunTask
from lirs_wct.errors import MapperError, SimulationError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.progress import no_progress
from slam_baselines.hector import HectorMapper
from tests.lirs_validation.experiment.puppets import Puppet, SlowPuppet, drive_log

FILES = {
    "record.json", "overview.png", "rtf.csv", "commands.csv", "truth.tum", "estimate.tum", "odometry.tum",
    "map.pgm", "map.yaml", "map_true_pose.pgm", "map_true_pose.yaml", "scans.clf.gz", "imu.csv.gz",
    "manifest-sha256.txt",
}  # fmt: skip


@pytest.fixture(scope="module")
def run(room: str, tmp_path_factory: pytest.TempPathFactory, plain_pictures: None) -> Run:
    return validate(room, seconds=4, seed=3, out=tmp_path_factory.mktemp("out"))


def test_the_folder_holds_everything_and_nothing_else(run: Run) -> None:
    assert run.folder is not None
    assert {p.name for p in run.folder.iterdir()} == FILES
    assert run.folder.name == f"room-husky-hector-s3-{run.record.config.digest}"
    assert [p for p in run.folder.parent.iterdir() if p.name.startswith(".")] == []


def test_the_record_holds_the_figures_of_the_definitions(run: Run) -> None:
    assert run.folder is not None
    record = read_record(run.folder)
    assert record["status"] == "ok"
    assert record["rtf"]["mean"] > 0.3
    assert set(record["rtf"]["parts"]) == {"physics", "sensors", "mapper", "rest"}
    assert sum(record["rtf"]["parts"].values()) == pytest.approx(1 / record["rtf"]["mean"])
    assert record["rtf"]["timestep"] == 0.005
    assert len(record["rtf"]["series"]) == 4
    assert record["trajectory"]["length"] > 2
    assert record["trajectory"]["ate_rmse"] < 0.15
    assert record["map"]["f1"] > 0.5
    assert record["map"]["f1_input"] > 0.9
    assert record["collisions"]["max_penetration"] < 0.02
    assert record["world"]["contact"]["vertical"] <= 0.01
    assert record["seed"] == record["config"]["seed"] == 3
    assert set(record["cost"]) == {"cpu_seconds", "peak_memory", "compile_seconds", "scans_dropped"}
    assert record["cost"]["scans_dropped"] == 0
    assert record["rtf"]["extrapolated"] is False
    assert record["rtf"]["load_average"] >= 0
    assert record["rtf"]["concurrent"] is False
    assert {"mujoco", "numpy", "python"} <= set(record["versions"])


def test_the_reference_physics_is_replayed_where_nothing_else_runs(room: str) -> None:
    ready = prepare(RunConfig(source=room, seconds=1.0))
    with closing(ready.mapper):
        log = drive_log(ready.simulation, ready.driver, ready.mapper, 1.0)
    found = evaluate_rtf(replace(log, load=0.5), ready.simulation)
    assert found["physics_reference"] > max(0.3, found["mean"])
    for shared in (replace(log, concurrent=True, load=0.5), replace(log, load=1e4)):
        assert evaluate_rtf(shared, ready.simulation)["physics_reference"] is None


def test_a_reference_physics_that_diverges_has_no_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, Any]] = []

    def replay(self: Simulation, **given: Any) -> None:
        asked.append(given)
        raise SimulationError("diverged")

    monkeypatch.setattr(Simulation, "replay", replay)
    assert reference_rtf(build_scenario(RunConfig(source="simple")).simulation(make_robot("husky"))) is None
    assert asked == [{"reference": True, "seconds": 10.0}]


def test_a_brief_run_is_complete_without_its_picture(room: str, tmp_path: Path) -> None:
    experiment = RunTask(RunConfig(source=room, seconds=0.5), brief=True)
    experiment.run(tmp_path, ScenarioCache(), no_progress, concurrent=False)
    assert not (tmp_path / experiment.name / "overview.png").exists()
    assert experiment.find_outcome(tmp_path) is not None


@pytest.mark.parametrize("world", ["room", pytest.param("medium", marks=pytest.mark.slow)])
def test_the_same_seed_gives_the_same_bytes(
    world: str, room: str, tmp_path: Path, plain_pictures: None
) -> None:
    def made(name: str, seed: int) -> Path:
        source = room if world == "room" else world
        return validate(source, seconds=1 if world == "room" else 3, seed=seed, out=tmp_path / name).folder  # type: ignore[return-value]

    one, two, other = made("one", 3), made("two", 3), made("other", 4)
    for name in ("truth.tum", "estimate.tum", "odometry.tum", "map.pgm", "map.yaml", "map_true_pose.pgm"):
        assert (one / name).read_bytes() == (two / name).read_bytes(), name
    assert (one / "truth.tum").read_bytes() != (other / "truth.tum").read_bytes()


def test_a_large_terrain_is_cut_to_its_middle(hills: dict[str, Any]) -> None:
    source, options = hills["source"], hills["options"]
    scenario = build_scenario(RunConfig(source=source, build=replace(options, size=300.0)))
    assert scenario.window == (0.0, 0.0, 50.0)
    assert max(scenario.world.surface.size) <= 53
    assert build_scenario(RunConfig(source=source, build=options)).window is None


@pytest.mark.parametrize("fails", ["tipped", "off world", "stuck", "diverged", "lost"])
def test_a_failure_ends_the_run_and_is_in_the_log(fails: str) -> None:
    puppet, mapper = Puppet(fails, 10), SlowPuppet(0.0, lost=(0.4 if fails == "lost" else 1e9, 1e9))
    log = drive_log(puppet, puppet, mapper.under_test, 20.0)  # type: ignore[arg-type]
    assert log.status == fails
    assert log.reason
    assert puppet.ticks <= 12 + (LOST_SECONDS / puppet.period if fails == "lost" else 0)
    assert len(log.observations) == len(log.truth) == len(log.estimates)


def test_a_driver_with_nothing_left_to_drive_ends_the_run() -> None:
    puppet = Puppet("nothing", 0, finished="the last waypoint is reached")
    log = drive_log(puppet, puppet, SlowPuppet().under_test, 20.0)  # type: ignore[arg-type]
    assert (log.status, log.reason) == ("ok", "the last waypoint is reached at 0.0 s")
    assert len(log.commands) == 1


def test_seconds_are_summed_by_simulated_second() -> None:
    np.testing.assert_allclose(per_second([0.01] * 50, 0.04), [0.25, 0.25])
    np.testing.assert_allclose(per_second([0.01] * 30, 0.04), [0.25, 0.25])


def test_a_drive_stops_at_its_wall_limit_and_says_so() -> None:
    puppet = Puppet("nothing", 0)
    log = drive_log(puppet, puppet, SlowPuppet(0.01).under_test, 20.0, wall_limit=0.2)  # type: ignore[arg-type]
    assert log.status == "wall limit"
    assert 0.2 <= sum(log.tick_seconds) < 0.4
    assert "of 20 simulated seconds" in log.reason


def test_a_pose_of_nan_ends_the_drive_with_the_scans_stamp() -> None:
    puppet, mapper = Puppet("nothing", 0), SlowPuppet()
    mapper.update = lambda *_: Pose2(float("nan"), 0, 0)  # type: ignore[method-assign]
    with pytest.raises(MapperError, match=r"scan at 0\.000 s"):
        drive_log(puppet, puppet, mapper.under_test, 1.0)  # type: ignore[arg-type]


class QueueingMapper(HectorMapper):
    """A mapper that drops every fourth scan, as one with a full queue does, and says what it received."""

    given = 0

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        self.given += 1
        dropped = self.given % 4 == 0
        return self.trajectory().pose2(-1) if dropped else super().update(scan, odometry, imu)


def test_scans_that_a_mapper_does_not_receive_are_counted(room: str, monkeypatch: pytest.MonkeyPatch) -> None:
    mapper = QueueingMapper()
    monkeypatch.setattr("lirs_validation.experiment.mapper_under_test.mapper_named", lambda *_: mapper)
    record = validate(room, mapper="hector", seconds=1).record
    assert mapper.given == 26
    assert record.cost["scans_dropped"] == 6


def test_compile_seconds_hold_neither_planning_nor_driving(
    room: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    validate(room, seconds=1)
    monkeypatch.setattr("lirs_validation.experiment.run._WARM", set())
    record = validate(room, seconds=1).record
    assert record.cost["compile_seconds"] == record.rtf["compile_seconds"] == 0.0


def test_a_robot_stands_still_before_it_drives(room: str) -> None:
    log = validate(room, robot="jackal", seconds=1.5, stand=1.5).log
    period = log.stamps[1] - log.stamps[0]
    still = round(1.5 / period)
    assert set(list(log.commands)[:still]) == {Twist()}
    assert log.commands[still] != Twist()
    gone = [float(np.hypot(*(pose.position - log.truth[0].position)[:2])) for pose in log.truth]
    assert max(gone[: still + 1]) < 0.01
    assert gone[-1] > 0.2


def test_rolling_scans_roll_and_other_sensors_keep_their_readings(room: str) -> None:
    runs = [validate(room, seconds=2.0, scan_time=each) for each in ("instant", "rolling")]
    instant, rolling = (found.log.observations for found in runs)
    assert {o.scan.time_increment for o in instant} == {0.0}
    assert min(o.scan.time_increment for o in rolling) > 0
    assert [o.odometry for o in instant] == [o.odometry for o in rolling]
    assert np.isclose(instant[0].scan.ranges, rolling[0].scan.ranges, atol=0.01).mean() > 0.99, "at rest"
    assert instant[-1].scan.ranges.tobytes() != rolling[-1].scan.ranges.tobytes()


@pytest.mark.slow
def test_walls_correct_wheels_that_measure_too_much() -> None:
    """A steady error of the wheels is no hillside."""
    record = validate("simple", mapper="cartographer", seconds=60, odometry_noise=5.0).record
    assert record.trajectory["odometry_ate_rmse"] > 0.5
    assert record.trajectory["ate_rmse"] < 0.05


def test_odometry_noise_scales_wheels_and_gyro_alone(room: str) -> None:
    husky = make_robot("husky")
    configs = [RunConfig(source=room, odometry_noise=factor) for factor in (1.0, 0.5)]
    usual, half = [build_scenario(config).simulation(husky).config.noise for config in configs]
    assert usual == SensorNoise()
    assert half.odometry == replace(usual.odometry, scale_sigma=usual.odometry.scale_sigma / 2)
    rates = {"rate_sigma": usual.imu.rate_sigma / 2, "rate_bias": usual.imu.rate_bias / 2}
    assert half == replace(usual, odometry=half.odometry, imu=replace(usual.imu, **rates))


def test_the_true_map_holds_no_walker_and_the_mappers_map_does(room: str) -> None:
    run = validate(room, seconds=6, seed=3, actors=6)
    assert run.record.config.actors == 6
    met = np.array(run.log.walker_beams)
    assert len(met) == len(run.log.observations)
    assert 0.02 < met.mean() < 0.5
    # What is occupied at the true poses is a wall or a block of the world.
    assert run.maps.scores["reference_false_occupied"] < 0.005
    assert run.maps.scores["false_occupied"] > 0.01


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_a_users_mapper_is_given_the_readings_or_none(
    hills: dict[str, Any], monkeypatch: pytest.MonkeyPatch, attitude: Attitude
) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parent)
    run = validate(**hills, mapper="own_mappers:Own", seconds=1, attitude=attitude)
    assert len(run.log.observations) > 20
    given = len(run.log.observations) if attitude == "imu" else 0
    assert run.record.mapper["counts"] == {"attitudes": given}
    assert run.record.config.attitude == attitude
    # What was recorded, and the map at the true poses, have the attitude in either case.
    assert any(abs(observation.imu.pitch) > 0.01 for observation in run.log.observations)


def test_only_the_mapper_loses_the_attitude(hills: dict[str, Any]) -> None:
    runs = [validate(**hills, seconds=2, attitude=attitude) for attitude in ATTITUDES]
    truths, estimates = ([run.log.trajectories()[k].positions for run in runs] for k in (0, 1))
    np.testing.assert_array_equal(*truths)
    np.testing.assert_array_equal(*(run.maps.true_pose.log_odds for run in runs))
    assert not np.array_equal(*estimates)


@pytest.mark.slow
def test_walls_stay_in_the_map_of_a_robot_that_leans_as_it_brakes() -> None:
    """The TurtleBot 2 rears up by 0.8 deg at its sharpest stops."""
    office = Path(__file__).resolve().parents[3] / "examples" / "data" / "office.yaml"
    run = validate(office, robot="turtlebot2", mapper="hector", seconds=120)
    assert run.record.map is not None
    assert run.record.map["occupied_cells"] > 2000
