"""Anybody's mapper by `module:name`: what is missing is said, and what it hands over is looked at."""

import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from lirs_validation import validate
from lirs_validation.experiment.loading import RESOLUTION, own_source_file
from lirs_validation.experiment.mapper_under_test import LocalMapper, SensorReadings, mapper_named
from lirs_wct.errors import ConfigError, MapperError
from lirs_wct.geometry.pose import Pose2, Trajectory
from lirs_wct.geometry.scan import LaserScan
from slam_baselines.mapper import ALL_CLOUD_MAPPERS, MAPPERS

OWN = "module:name of your own"
ROOT = Path(__file__).resolve().parents[3]
MODULE = """
from slam_baselines.mapper import MapperStats

class Whole:
    stats, lost = MapperStats(), False
    def __init__(self, **given): self.given = given
    def update(self, scan, odometry, imu): ...
    def map(self): ...
    def trajectory(self): ...

class Seeded(Whole):
    def __init__(self, seed): self.given = {"seed": seed}

class Half:
    lost = False
    def update(self, scan, odometry, imu): ...

class Greedy(Whole):
    def __init__(self, weights): ...

NOT_A_CLASS = 3
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with a module of a user in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", ["", *__import__("sys").path])
    for name in ("their_slam", "their_broken", "their_needy"):
        monkeypatch.delitem(__import__("sys").modules, name, raising=False)
    (tmp_path / "their_slam.py").write_text(MODULE)
    (tmp_path / "their_broken.py").write_text("x = 1 / 0")
    (tmp_path / "their_needy.py").write_text("import gtsam_that_is_not_here")
    return tmp_path


@pytest.mark.usefixtures("here")
def test_a_constructor_gets_what_it_takes() -> None:
    assert mapper_named("their_slam:Whole", 7).given == {  # type: ignore[attr-defined]
        "seed": 7,
        "resolution": RESOLUTION,
    }
    assert mapper_named("their_slam:Seeded", 7).given == {"seed": 7}  # type: ignore[attr-defined]


@pytest.mark.usefixtures("here")
def test_a_library_call_leaves_the_import_path_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])
    before = list(sys.path)
    mapper_named("their_slam:Whole", 7)
    assert own_source_file("their_slam:Whole") == Path.cwd() / "their_slam.py"
    with pytest.raises(ConfigError):
        mapper_named("their_broken:X", 7)
    assert sys.path == before


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere.slam:X", r"mapper 'nowhere.slam:X': no module 'nowhere' is installed or in /"),
        ("their_needy:X", r"their_needy imports 'gtsam_that_is_not_here', which is not installed"),
        ("their_broken:X", r"importing their_broken failed: ZeroDivisionError: division by zero"),
        (
            "their_slam:Hole",
            r"their_slam has no class 'Hole'; classes with update: Greedy, Half, Seeded, Whole$",
        ),
        ("their_slam:NOT_A_CLASS", r"has no class 'NOT_A_CLASS'"),
        ("their_slam:Half", r"lacks map\(\), trajectory\(\), stats; a mapper has update\(\), map\(\)"),
        ("their_slam:Greedy", r"cannot be made: TypeError: .*'weights'"),
        (
            "hektor",
            f"unknown mapper 'hektor'; legal: {', '.join(sorted((*MAPPERS, *ALL_CLOUD_MAPPERS, OWN)))}; "
            "did you mean hector",
        ),
    ],
)
def test_what_is_no_mapper_is_said_in_one_line(name: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        mapper_named(name, 1)
    assert "\n" not in str(error.value)


def test_what_a_mapper_hands_over_is_looked_at() -> None:
    class Wrong:
        stats: object = {}

        def update(self, scan: object, odometry: object, imu: object) -> object:
            return (0, 0, 0)

        def map(self) -> object:
            return np.zeros((3, 3))

        def trajectory(self) -> object:
            return Trajectory.from_poses([0.0, 0.5], [Pose2(), Pose2(math.nan, 0, 0)])

    mapper = LocalMapper(Wrong(), "wrong")  # type: ignore[arg-type]
    with pytest.raises(MapperError, match="OccupancyGrid, got ndarray"):
        mapper.map()
    with pytest.raises(MapperError, match="MapperStats, got dict"):
        _ = mapper.stats
    with pytest.raises(MapperError, match=r"not finite at 0\.500 s"):
        mapper.trajectory()
    with pytest.raises(MapperError, match="Pose2, got tuple"):
        mapper.observe(SensorReadings(LaserScan(np.ones(3, np.float32), 0.0, 0.1, 0.1, 9.0, 0.0)))


def test_the_documented_mapper_maps(room: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "docs" / "bring_your_own_mapper.md").read_text(encoding="utf-8")
    code = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0]
    (tmp_path / "my_slam.py").write_text(code)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", list(__import__("sys").path))
    monkeypatch.delitem(__import__("sys").modules, "my_slam", raising=False)
    monkeypatch.setattr("lirs_validation.experiment.mapper_under_test.needs_process", lambda mapper: False)
    run = validate(room, mapper="my_slam:DeadReckoning", seconds=1)
    assert run.record.status == "ok"
    assert run.record.name.startswith("room-husky-DeadReckoning-s1-")
    errors = run.record.trajectory
    assert errors["ate_rmse"] == pytest.approx(errors["odometry_ate_rmse"], abs=1e-9)
    assert run.record.mapper["received"] == 1 + 25
    assert run.record.map["f1"] > 0.5
