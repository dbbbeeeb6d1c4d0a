"""A mapper changes nothing that it is judged by, and ends nothing but its own run."""

import json
from contextlib import closing
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest

from lirs_envs.sensing.sensors import Observation
from lirs_validation.config import RunConfig
from lirs_validation.experiment.mapper_under_test import LocalMapper, MapperProcess
from lirs_validation.metrics.trajectory import trajectory_errors
from lirs_validation.record.run_record import read_record
from lirs_validation.sweep.sweep import Serial, Sweep
from lirs_validation.sweep.tasks import RunTask
from lirs_wct.errors import ConfigError, MapperError
from lirs_wct.geometry import FloatArray
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import Imu, LaserScan
from slam_baselines.mapper import make_mapper
from tests.command_line import run_command
from tests.lirs_validation.experiment import own_mappers
from tests.lirs_validation.experiment.own_mappers import Own

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(Path(__file__).parent)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def statuses(out: Path) -> dict[str, tuple[str, str]]:
    records = [read_record(path.parent) for path in out.glob("*/record.json")]
    return {r["config"]["mapper"].rpartition(":")[2]: (r["status"], r["reason"]) for r in records}


def use(mapper: LocalMapper, observations: list[Observation]) -> None:
    for observation in observations:
        mapper.observe(observation)
    mapper.map()


@pytest.mark.parametrize(
    ("mapper", "message"),
    [
        ("Exits", r"mapper 'own': update\(\) failed for the scan at 0.160 s: SystemExit$"),
        ("Rages", r"update\(\) failed for the scan at 0.160 s: BaseException: no exception$"),
        ("ExitsAtTheEnd", r"mapper 'own': map\(\) failed: SystemExit: 0$"),
    ],
)
def test_what_no_mapper_may_do_is_its_error(
    mapper: str, message: str, observations: list[Observation]
) -> None:
    guarded = LocalMapper(getattr(own_mappers, mapper)(), "own")
    with pytest.raises(MapperError, match=message):
        use(guarded, observations)


def test_what_a_mapper_changes_by_force_is_its_own_copy(here: Path, observations: list[Observation]) -> None:
    """`scan.ranges[:] = 1.0` earned a better F1 than dead reckoning: the judge read the same arrays."""
    before = deepcopy(observations)
    with closing(MapperProcess(RunConfig(source="simple", mapper="own_mappers:Forces"))) as process:
        for observation in observations:
            process.observe(observation)
    for old, new in zip(before, observations, strict=True):
        assert np.array_equal(old.scan.ranges, new.scan.ranges)
        assert (old.scan.stamp, old.scan.T_base_laser) == (new.scan.stamp, new.scan.T_base_laser)
        assert (old.odometry, old.imu) == (new.odometry, new.imu)


def test_a_serial_sweep_goes_on_past_a_mapper_that_exits(here: Path, room: str, plain_pictures: None) -> None:
    """`sys.exit` ended the sweep with exit code 0 and nothing written."""
    configs = [RunConfig(source=room, mapper=name, seconds=0.4) for name in ("own_mappers:Exits", "hector")]
    sweep = Sweep([RunTask(config) for config in configs], here / "out")
    wrong, right = sweep.run(Serial())
    assert (wrong.status, right.status) == ("error", "ok")
    assert wrong.reason.startswith("mapper 'own_mappers:Exits': update() failed for the scan at 0.160 s")
    assert statuses(here / "out")["Exits"] == ("error", wrong.reason)
    assert len(json.loads((here / "out" / "sweep.json").read_text())["cells"]) == 2


@pytest.mark.parametrize("mapper", ["Replaces", "Looks"])
def test_no_mapper_reaches_the_evaluation_or_the_drive(
    here: Path, mapper: str, observations: list[Observation]
) -> None:
    """A mapper that replaced `trajectory_errors` had an ATE of 0, and so had every later run."""
    from lirs_validation.experiment import evaluation

    before = dict(np.geterr())
    with closing(MapperProcess(RunConfig(source="simple", mapper=f"own_mappers:{mapper}"))) as process:
        found = [process.observe(observation).pose for observation in observations]
    assert found == [observation.odometry for observation in observations]
    assert evaluation.trajectory_errors is trajectory_errors
    assert dict(np.geterr()) == before
    assert Path.cwd() == here


def test_a_module_that_exits_when_imported_is_bad_input(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "script.py").write_text("import sys\nsys.exit(0)\n")
    assert run_command("validate", "simple", "--mapper", "script:Slam") == 2
    assert "importing script failed: SystemExit: 0" in capsys.readouterr().err


SCAN = LaserScan(np.ones(3, np.float32), 0.0, 0.1, 0.1, 9.0, 1.5, Pose3(0.1, 0.0, 0.3))
SEEN = Observation(SCAN, Pose2(1.0, 2.0, 0.3), Imu(pitch=0.02))


class Raises(Own):
    def __init__(self, error: BaseException) -> None:
        self.error = error

    def update(self, *_: object) -> Pose2:
        raise self.error


def test_ctrl_c_and_our_own_errors_pass_the_guard() -> None:
    wrapped = SystemError("a kernel returned a result with an exception set")
    wrapped.__cause__ = KeyboardInterrupt()
    for error, expected in (
        (KeyboardInterrupt(), KeyboardInterrupt),
        (wrapped, KeyboardInterrupt),
        (ConfigError("needs odometry"), ConfigError),
        (SystemError("odd"), MapperError),
    ):
        with pytest.raises(expected):
            LocalMapper(Raises(error), "wrong").observe(SEEN)


class Claims(Own):
    def __init__(self, covariance: object) -> None:
        super().__init__()
        self.covariance = covariance


def test_a_covariance_is_taken_over_as_a_copy() -> None:
    claimed = np.diag((0.04, 0.01, 0.001))
    answer = LocalMapper(Claims(claimed), "own").observe(SEEN)
    assert answer.covariance is not None
    assert np.array_equal(answer.covariance, claimed)
    assert not np.shares_memory(answer.covariance, claimed)
    assert LocalMapper(Claims(None), "own").observe(SEEN).covariance is None
    assert LocalMapper(Own(), "own").observe(SEEN).covariance is None


@pytest.mark.parametrize(
    "covariance",
    [np.eye(2), np.diag((1.0, np.nan, 1.0)), np.diag((1.0, -0.1, 1.0)), np.triu(np.ones((3, 3)))],
)
def test_an_invalid_covariance_is_the_mappers_error(covariance: FloatArray) -> None:
    message = r"^covariance must be 3 x 3, finite, symmetric and positive semidefinite, got \[.*1.5"
    with pytest.raises(MapperError, match=message) as error:
        LocalMapper(Claims(covariance), "own").observe(SEEN)
    assert "\n" not in str(error.value)


def test_a_covariance_that_is_no_matrix_is_the_mappers_error() -> None:
    with pytest.raises(MapperError, match=r"mapper 'own': covariance failed for the scan at 1.500 s"):
        LocalMapper(Claims("wide"), "own").observe(SEEN)


def test_the_guard_changes_no_answer() -> None:
    plain, guarded = make_mapper("hector"), LocalMapper(make_mapper("hector"), "hector")
    assert plain.update(SCAN, SEEN.odometry, SEEN.imu) == guarded.observe(SEEN).pose
    assert guarded.stats.received == 1
    assert np.array_equal(plain.map().log_odds, guarded.map().log_odds, equal_nan=True)
