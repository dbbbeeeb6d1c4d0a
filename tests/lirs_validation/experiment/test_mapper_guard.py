"""A mapper changes nothing that it is judged by, and ends nothing but its own run."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lirs_envs.sensing.sensors import Observation
from lirs_validation import map_log, validate
from lirs_validation.experiment.mapper_under_test import MapperUnderTest
from lirs_validation.record.run_record import read_record
from lirs_wct.errors import ConfigError, MapperError
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import Imu, LaserScan
from slam_baselines.mapper import MapperStats, make_mapper
from tests.command_line import run_command

ROOT = Path(__file__).resolve().parents[3]
CHEAT = '''
import os
import sys
import numpy as np
from lirs_wct.geometry.pose import Pose2
from slam_baselines.hector.mapper import HectorMapper


class Honest(HectorMapper):
    seen = 0

    def update(self, scan, odometry, imu):
        self.seen += 1
        if self.seen == 5:
            self.act(scan, odometry, imu)
        return super().update(scan, odometry, imu)

    def act(self, scan, odometry, imu):
        pass


class Writes(Honest):
    def act(self, scan, odometry, imu):
        scan.ranges[:] = 1.0


class Freezes(Honest):
    def act(self, scan, odometry, imu):
        odometry.x = 3.0


class Forces(Honest):
    """Makes what it was given writable, and changes all of it, every time."""

    def update(self, scan, odometry, imu):
        held = scan.ranges.copy(), (odometry.x, odometry.y, odometry.yaw)
        answer = super().update(scan, odometry, imu)
        scan.ranges.flags.writeable = True
        scan.ranges[:] = 1.0
        for thing, name in ((scan, "stamp"), (scan.T_base_laser, "z"), (odometry, "x"), (imu, "pitch")):
            object.__setattr__(thing, name, 7.0)
        return answer


class Exits(Honest):
    def act(self, scan, odometry, imu):
        sys.exit()


class Rages(Honest):
    def act(self, scan, odometry, imu):
        raise BaseException("no exception")


class Dies(Honest):
    def act(self, scan, odometry, imu):
        os._exit(0)


class Replaces(Honest):
    """Makes the evaluation find no error, for itself and for later runs, and misleads what comes after."""

    def __init__(self):
        import warnings
        import lirs_validation.metrics.trajectory
        super().__init__()
        for module in list(sys.modules.values()):
            if hasattr(module, "trajectory_errors"):
                module.trajectory_errors = lambda *_, **__: None
        np.seterr(all="raise")
        warnings.simplefilter("error")
        os.chdir("/")


class Interrupts(Honest):
    def act(self, scan, odometry, imu):
        raise KeyboardInterrupt


class Looks(Honest):
    """Looks for the simulation in the frames of its callers."""

    def update(self, scan, odometry, imu):
        frame = sys._getframe()
        while frame is not None:
            for value in frame.f_locals.values():
                if type(value).__name__ == "Simulation":
                    return value.T_world_base.to_pose2()
            frame = frame.f_back
        return super().update(scan, odometry, imu)


class ExitsAtTheEnd(Honest):
    def map(self):
        sys.exit(0)
'''


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / "cheat.py").write_text(CHEAT)
    (tmp_path / "script.py").write_text("import sys\nsys.exit(0)\n")
    monkeypatch.chdir(tmp_path)
    for name in ("cheat", "script"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    yield tmp_path
    sys.modules.pop("cheat", None)


def statuses(out: Path) -> dict[str, tuple[str, str]]:
    records = [read_record(path.parent) for path in out.glob("*/record.json")]
    return {r["config"]["mapper"].rpartition(":")[2]: (r["status"], r["reason"]) for r in records}


def test_a_serial_sweep_goes_on_past_mappers_that_exit(here: Path) -> None:
    """`sys.exit` ended the sweep with exit code 0 and nothing written."""
    wrong = ("Exits", "Rages", "ExitsAtTheEnd", "Writes", "Freezes")
    names = ",".join(f"cheat:{name}" for name in (*wrong, "Honest"))
    assert run_command("validate", "simple", "--mapper", names, "--seconds", "1", "-o", "out") == 3
    found = statuses(here / "out")
    assert {name: status for name, (status, _) in found.items()} == dict.fromkeys(wrong, "error") | {
        "Honest": "ok"
    }
    reasons = {name: reason for name, (_, reason) in found.items()}
    assert "mapper 'cheat:Exits': update() failed for the scan at 0.160 s: SystemExit" in reasons["Exits"]
    assert "BaseException: no exception" in reasons["Rages"]
    assert "mapper 'cheat:ExitsAtTheEnd': map() failed: SystemExit: 0" in reasons["ExitsAtTheEnd"]
    for name in ("Writes", "Freezes"):
        assert f"mapper 'cheat:{name}': update() writes into what it was given" in reasons[name]
        assert "read-only, change a copy" in reasons[name]
    assert len(json.loads((here / "out" / "sweep.json").read_text())["cells"]) == 6


def test_no_mapper_reaches_the_evaluation_or_the_next_run(here: Path) -> None:
    """A mapper that replaced `trajectory_errors` had an ATE of 0, and so had every later run."""
    alone = validate("simple", mapper="cheat:Honest", seconds=2).record
    before = dict(np.geterr())
    names = ",".join(f"cheat:{name}" for name in ("Replaces", "Looks", "Interrupts", "Honest"))
    assert run_command("validate", "simple", "--mapper", names, "--seconds", "2", "-o", "out") == 3
    records = {
        r["config"]["mapper"].partition(":")[2]: r
        for r in (read_record(path.parent) for path in (here / "out").glob("*/record.json"))
    }
    assert {name: r["status"] for name, r in records.items()} == {
        "Replaces": "ok", "Looks": "ok", "Interrupts": "error", "Honest": "ok"
    }  # fmt: skip
    for name in ("Replaces", "Looks", "Honest"):
        assert records[name]["trajectory"] == alone.trajectory, name
        assert records[name]["map"] == alone.map, name
    assert dict(np.geterr()) == before
    assert Path.cwd() == here


def test_a_process_that_ends_itself_costs_its_own_run(here: Path) -> None:
    names = "cheat:Dies,cheat:Exits,hector"
    words = ("validate", "simple", "--mapper", names, "--seconds", "1", "--jobs", "2", "-o", "out")
    assert run_command(*words) == 3
    found = statuses(here / "out")
    assert {name: status for name, (status, _) in found.items()} == {
        "Dies": "error",
        "Exits": "error",
        "hector": "ok",
    }
    assert "SystemExit" in found["Exits"][1]


@pytest.mark.usefixtures("here")
def test_what_a_mapper_changes_by_force_is_its_own_copy() -> None:
    """`scan.ranges[:] = 1.0` earned a better F1 than dead reckoning: the judge read the same arrays."""
    honest = validate("simple", mapper="cheat:Honest", seconds=2)
    forced = validate("simple", mapper="cheat:Forces", seconds=2)
    for a, b in zip(honest.log.observations, forced.log.observations, strict=True):
        assert np.array_equal(a.scan.ranges, b.scan.ranges)
        assert (a.scan.stamp, a.scan.T_base_laser, a.odometry, a.imu) == (
            b.scan.stamp, b.scan.T_base_laser, b.odometry, b.imu
        )  # fmt: skip
    assert np.array_equal(honest.maps.true_pose.log_odds, forced.maps.true_pose.log_odds, equal_nan=True)


def test_logs_have_the_same_guard(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = str(ROOT / "examples" / "data" / "office.clf.gz")
    with pytest.raises(
        MapperError, match="mapper 'cheat:Writes': update\\(\\) writes into what it was given"
    ):
        map_log(log, mapper="cheat:Writes")
    assert run_command("map", log, "--mapper", "cheat:Exits", "-o", "out") == 3
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith("lirs-wct: mapper 'cheat:Exits': update() failed for the scan at ")
    assert not (here / "out").exists()


@pytest.mark.usefixtures("here")
def test_a_module_that_exits_when_imported_is_bad_input(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command("validate", "simple", "--mapper", "script:Slam") == 2
    assert "importing script failed: SystemExit: 0" in capsys.readouterr().err


class Wrong:
    """A mapper that raises what it is told to."""

    stats, lost = MapperStats(), False

    def __init__(self, error: BaseException) -> None:
        self.error = error

    def update(self, *_: object) -> Pose2:
        raise self.error


SCAN = LaserScan(np.ones(3, np.float32), 0.0, 0.1, 0.1, 9.0, 1.5, Pose3(0.1, 0.0, 0.3))
SEEN = Observation(SCAN, Pose2(1.0, 2.0, 0.3), Imu(pitch=0.02))


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
            MapperUnderTest(lambda: Wrong(error), "wrong").observe(SEEN)  # type: ignore[arg-type, return-value] # noqa: B023


def test_the_guard_changes_no_answer() -> None:
    plain, guarded = make_mapper("hector"), MapperUnderTest(lambda: make_mapper("hector"), "hector")
    assert plain.update(SCAN, SEEN.odometry, SEEN.imu) == guarded.observe(SEEN).pose
    assert SCAN.ranges.flags.writeable
    assert guarded.stats.received == 1
    assert np.array_equal(plain.map().log_odds, guarded.map().log_odds, equal_nan=True)
