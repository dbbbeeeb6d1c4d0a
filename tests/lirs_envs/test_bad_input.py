"""What cannot be is refused in one clear sentence, before MuJoCo is entered; the simulation stays usable."""

import math
from typing import Any

import numpy as np
import pytest

from lirs_envs.robots.robot import Robot, Twist, Waypoint
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.errors import ConfigError, SimulationError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.world import World
from tests.kit import started


@pytest.mark.parametrize(
    "start", [Pose2("a", 0.0), Pose2(0.0, None), Pose2(math.nan, 0.0), Pose2(0.0, 0.0, math.inf), (0.0, 0.0)]
)  # type: ignore[arg-type]
def test_a_start_that_is_no_pose(start: Any, plane: World, husky: Robot) -> None:
    with pytest.raises(ConfigError, match="a start"):
        Simulation(plane, SimulationConfig(robot=husky)).reset(start)


@pytest.mark.parametrize(
    "command",
    [
        None,
        (1.0, 0.0),
        Twist(math.nan),
        Twist(0.0, math.inf),
        Twist("1"),  # type: ignore[arg-type]
        Twist(1j),  # type: ignore[arg-type]
        Twist(np.array([0.5, 1.0])),  # type: ignore[arg-type]
        Waypoint(1.0, 1.0, 1.0),
    ],
)
def test_a_command_that_cannot_be(command: Any, plane: World, husky: Robot) -> None:
    sim = started(plane, robot=husky)
    before = sim.pose()
    with pytest.raises(ConfigError, match=r"a command must|husky drives: it takes a Twist"):
        sim.advance(command)
    assert sim.pose() == before
    assert sim.time() == 0
    sim.advance(Twist(np.float32(0.5)))  # type: ignore[arg-type]


@pytest.mark.parametrize("where", ["qpos", "qvel"])
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e20])
def test_a_state_that_is_not_finite_stops_it(
    where: str, value: float, plane: World, husky: Robot, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file where it stands
    sim = started(plane, robot=husky)
    getattr(sim.body.data, where)[2] = value
    with pytest.raises(SimulationError, match=r"the simulation diverged at \d"):
        sim.advance(Twist(0.5))
    seen = sim.reset()
    assert np.isfinite(sim.body.data.qpos).all()
    assert not np.isnan(seen.scan.ranges).any()
