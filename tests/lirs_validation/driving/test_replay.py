"""A replay: the same commands give the same truth bit for bit, whatever maps; what does not fit is named."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_envs.robots.robot import Twist
from lirs_validation import validate
from lirs_validation.config import RunConfig
from lirs_validation.driving.choice import ReplayDriver, replay
from lirs_validation.experiment.run import Run
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.drive_files import Commands
from lirs_wct.geometry.pose import Pose2
from tests.kit import SMALL


def test_commands_come_at_their_time_and_rest_follows() -> None:
    rows = np.array([(0.0, 0.1, 0.2), (0.04, 0.3, 0.4)])
    driver = ReplayDriver(Commands(Pose2(1.0, 2.0), rows), 0.04, "run")
    assert driver.command(Pose2(), 0.0) == Twist(0.1, 0.2)
    assert not driver.finished
    assert driver.command(Pose2(), 0.04) == Twist(0.3, 0.4)
    assert driver.finished == "the commands of run end"
    assert driver.command(Pose2(), 0.08) == Twist()


DRIVE: dict[str, Any] = {"seed": 2, "options": SMALL}
pytestmark = pytest.mark.usefixtures("plain_pictures")


@pytest.fixture(scope="module", params=["husky", pytest.param("quadrotor", marks=pytest.mark.slow)])
def recorded(
    request: pytest.FixtureRequest, plain_pictures: None, tmp_path_factory: pytest.TempPathFactory
) -> Run:
    out = tmp_path_factory.mktemp("recorded")
    return validate("simple", robot=request.param, mapper="hector", seconds=1.0, out=out, **DRIVE)


@pytest.mark.slow
def test_another_mapper_on_the_same_commands_has_the_same_truth(recorded: Run, tmp_path: Path) -> None:
    drive = DRIVE | {"robot": recorded.record.config.robot, "driver": f"replay:{recorded.folder}"}
    for mapper in ("hector", "examples.your_own_mapper:DeadReckoning"):
        again = validate("simple", mapper=mapper, seconds=1.0, out=tmp_path, **drive)
        assert (again.folder / "truth.tum").read_bytes() == (recorded.folder / "truth.tum").read_bytes()
        assert (again.folder / "commands.csv").read_bytes() == (recorded.folder / "commands.csv").read_bytes()
        assert again.record.config.driver == f"replay:{recorded.folder}"
        assert "-replay-" in again.record.name


def test_a_replay_ends_with_its_commands(recorded: Run) -> None:
    robot = recorded.record.config.robot
    again = validate("simple", robot=robot, driver=f"replay:{recorded.folder}", seconds=30.0, **DRIVE)
    assert again.record.status == "ok"
    assert again.record.reason.startswith("the commands of ")
    assert again.record.rtf["simulated_seconds"] == pytest.approx(1.0)


def test_what_does_not_fit_the_recorded_run_is_named(recorded: Run, tmp_path: Path) -> None:
    folder, robot = recorded.folder, recorded.record.config.robot
    assert folder is not None
    fits = RunConfig(source="simple", robot=robot, build=SMALL)
    assert replay(folder, fits, "simple").start == recorded.log.start
    with pytest.raises(ConfigError, match="the same is needed"):
        replay(folder, fits, "medium")
    with pytest.raises(ConfigError, match=r"drives '.*', this run 'jackal'"):
        replay(folder, replace(fits, robot="jackal"), "simple")
    with pytest.raises(ConfigError, match="the same lidar is needed"):
        replay(folder, replace(fits, lidar="lds01"), "simple")
    bare = tmp_path / "bare"
    shutil.copytree(folder, bare)
    (bare / "commands.csv").unlink()
    with pytest.raises(SourceError, match=r"commands\.csv: no such file"):
        replay(bare, fits, "simple")
    entry = json.loads((folder / "record.json").read_text())
    (bare / "record.json").write_text(json.dumps(entry | {"schema": 0}))
    with pytest.raises(SourceError, match=r"record\.json: schema 0"):
        replay(bare, fits, "simple")
