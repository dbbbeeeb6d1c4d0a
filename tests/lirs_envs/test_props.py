"""Props and static robots: touched, seen by the lidar, and never mistaken for the robot itself."""

import math

import numpy as np
import pytest

from lirs_envs.robots.robot import Robot, Twist, make_robot
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import Prop, SimulationConfig, StaticRobot
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.world import World
from tests.kit import started

EXACT = SensorNoise(lidar="none")


def beam(sim: Simulation, degrees: float) -> float:
    scan = sim.reset().scan
    return float(scan.ranges[np.argmin(np.abs(scan.angles - math.radians(degrees)))])


def test_the_lidar_sees_boxes_cylinders_and_spheres(plane: World, husky: Robot) -> None:
    props = (
        Prop(shape="box", size=(0.2, 0.5, 0.5), place=Pose2(3.0, 0.0)),
        Prop(shape="cylinder", size=(0.1, 0.6), place=Pose2(0.2206, 2.0)),
        Prop(shape="sphere", size=(0.45226,), place=Pose2(0.2206, -2.0), mass=2.0),
    )
    sim = Simulation(plane, SimulationConfig(robot=husky, props=props, noise=EXACT))
    assert beam(sim, 0) == pytest.approx(3.0 - 0.2 - 0.2206, abs=2e-3)
    assert beam(sim, 90) == pytest.approx(1.9, abs=2e-3)
    assert beam(sim, -90) == pytest.approx(2.0 - 0.45226, abs=2e-3)
    assert beam(sim, 45) == np.inf


def test_the_lidar_sees_another_robot_and_not_its_own(plane: World) -> None:
    # The TurtleBot's lidar is 0.31 m above ground: among the Husky's body, above none of its own.
    other = StaticRobot(make_robot("husky"), Pose2(2.0, 0.0, math.pi / 2))
    sim = Simulation(plane, SimulationConfig(robot=make_robot("turtlebot2"), props=(other,), noise=EXACT))
    scan = sim.reset().scan
    met = np.abs(scan.angles[np.isfinite(scan.ranges)])
    # Its wheels are 0.33 m high and stand out farther than its body.
    assert float(np.nanmin(scan.ranges)) == pytest.approx(2.0 - 0.08 - 0.2854, abs=0.07)
    assert met.max() < math.radians(25)
    alone = Simulation(plane, SimulationConfig(robot=make_robot("turtlebot2"), noise=EXACT))
    assert np.isposinf(alone.reset().scan.ranges).all()


def test_props_do_not_change_the_robot(plane: World, husky: Robot) -> None:
    """Far away, they leave its motion as it is, and their contacts are not its own."""
    far = (
        Prop(shape="sphere", size=(0.3,), place=Pose2(8.0, 8.0), mass=1.0),
        StaticRobot(husky, Pose2(-8.0, 8.0)),
    )
    ends = []
    for props in ((), far):
        sim = started(plane, robot=husky, props=props)
        for k in range(50):
            sim.advance(Twist(1.0, math.sin(k / 10)))
        ends.append(sim.pose())
        assert sim.collisions.body_contacts == 0
        assert sim.replay().T_world_base == sim.pose()
    assert ends[0].x == pytest.approx(ends[1].x, abs=1e-4)
    assert ends[0].yaw == pytest.approx(ends[1].yaw, abs=1e-3)


def test_a_fixed_prop_stops_and_a_light_one_yields(plane: World, husky: Robot) -> None:
    for mass, stops in ((0.0, True), (1.0, False)):
        box = Prop(shape="box", size=(0.2, 0.5, 0.3), place=Pose2(1.5, 0.0), mass=mass)
        sim = started(plane, robot=husky, props=(box,))
        for _ in range(100):
            sim.advance(Twist(1.0))
        assert (sim.pose().x < 0.85) == stops
        assert sim.collisions.body_contacts > 0


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        ({"shape": "cone"}, "unknown shape of a prop 'cone'; legal: box, cylinder, sphere"),
        ({"size": (1.0,)}, "a box needs 3 finite sizes"),
        ({"size": (1.0, 1.0, math.nan)}, "finite sizes above 0 m"),
        ({"mass": -1.0}, "mass of a prop must be"),
        ({"place": Pose2(math.nan, 0.0)}, "place must be finite"),
    ],
)
def test_props_that_cannot_be(figures: dict[str, object], words: str) -> None:
    legal = {"shape": "box", "size": (1.0, 1.0, 1.0), "place": Pose2()}
    with pytest.raises(ConfigError, match=words):
        Prop(**(legal | figures))  # type: ignore[arg-type]
