"""Every robot does what its data sheet says: on the flat, on slopes, against obstacles."""

import math
from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from lirs_envs.robots.robot import ROBOTS, Robot, Twist
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.world import World
from tests.kit import started

GROUND = [robot for robot in ROBOTS.values() if not robot.flies]
CLIMBS = {"husky": 30.0, "jackal": 45.0}
"""Degrees; the others 10."""
TICK = 0.04


@pytest.fixture(params=GROUND, ids=lambda robot: robot.name)
def robot(request: pytest.FixtureRequest) -> Robot:
    return request.param


def simulation(world: World, robot: Robot, start: Pose2 | None = None) -> Simulation:
    """All robots with the same LRF, hence the same 40 ms a tick."""
    return started(world, start, robot=robot, lidar="lms111")


def body_twist(sim: Simulation) -> tuple[float, float]:
    """True speed ahead and turn rate."""
    v = sim.body.data.qvel
    yaw = sim.pose().yaw
    return float(v[0] * math.cos(yaw) + v[1] * math.sin(yaw)), float(v[5])


@pytest.mark.parametrize("ground", ["plane", "flat_field"])
def test_at_rest_for_ten_seconds(ground: str, robot: Robot, request: pytest.FixtureRequest) -> None:
    sim = simulation(request.getfixturevalue(ground), robot, Pose2(1.0, 2.0, 0.7))
    start = sim.pose()
    for _ in range(250):
        sim.advance(Twist())
    end = sim.pose()
    assert math.hypot(end.x - start.x, end.y - start.y) < 1e-3
    assert abs(end.yaw - start.yaw) * robot.radius < 1e-3
    assert end.z == pytest.approx(robot.base_height, abs=1e-3)
    assert abs(end.pitch) < math.radians(0.3)
    assert (start.x, start.y, start.yaw) == pytest.approx((1.0, 2.0, 0.7), abs=2e-3)


@pytest.mark.parametrize("ground", ["plane", pytest.param("flat_field", marks=pytest.mark.slow)])
def test_commanded_is_driven(ground: str, robot: Robot, request: pytest.FixtureRequest) -> None:
    sim = simulation(request.getfixturevalue(ground), robot)
    for ahead, turn in ((1, 0), (-1, 0), (0, 1), (0, -1), (0, 0.1), (0.5, 0.5), (1, -0.25)):
        command = Twist(ahead * robot.max_speed, turn * robot.max_turn_rate)
        sim.reset()
        ramp = abs(command.v) / robot.max_acceleration + abs(command.omega) / robot.max_turn_acceleration
        for _ in range(math.ceil((ramp + 1.2) / TICK)):
            sim.advance(command)
        # By way and not by samples of the speed: skidding wheels chatter in step with the ticks.
        way = turned = 0.0
        for _ in range(50):
            before = sim.pose().to_pose2()
            sim.advance(command)
            moved = before.inverse() @ sim.pose().to_pose2()
            way, turned = way + moved.x, turned + moved.yaw
        v, omega = way / (50 * TICK), turned / (50 * TICK)
        assert v == pytest.approx(command.v, abs=0.05 * robot.max_speed), command
        assert omega == pytest.approx(command.omega, abs=max(0.05 * abs(command.omega), 0.01)), command


def test_speeds_up_and_stops_within_the_limit(plane: World, robot: Robot) -> None:
    sim = simulation(plane, robot)
    speeds = [0.0]
    stop = math.ceil(robot.max_speed / robot.max_acceleration / TICK)
    for k in range(2 * stop + 36):
        sim.advance(Twist(robot.max_speed) if k < stop + 12 else Twist())
        speeds.append(body_twist(sim)[0])
    assert np.abs(np.diff(speeds)).max() / TICK <= 1.1 * robot.max_acceleration
    assert speeds[stop + 12] == pytest.approx(robot.max_speed, rel=0.05)
    assert abs(speeds[2 * stop + 34]) < 0.02 * max(robot.max_speed, 0.5)


def slope_world(make_world: Callable[..., World], degrees: float) -> World:
    """Level ground, from x = -5 on a bend of 2 m radius, then a slope."""
    angle, bend = math.radians(degrees), 2.0
    end = bend * math.sin(angle)

    def z(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        s = x + 5
        arc = bend - np.sqrt(bend**2 - np.clip(s, 0, end) ** 2)
        return arc + np.maximum(s - end, 0) * math.tan(angle)

    return make_world(z)


def test_climbs(make_world: Callable[..., World], robot: Robot) -> None:
    degrees = CLIMBS.get(robot.name, 10.0)
    sim = simulation(slope_world(make_world, degrees), robot, Pose2(-5.0 - 2 * robot.radius, 0.0, 0.0))
    speed = min(0.3, robot.max_speed)
    while sim.time() < 30 and sim.pose().x < -2.5:
        sim.advance(Twist(speed))
    assert sim.pose().x >= -2.5
    assert -math.degrees(sim.pose().pitch) == pytest.approx(degrees, abs=1.0)
    assert not sim.find_tipped()[0]
    assert abs(sim.pose().y) < 0.3


@pytest.mark.parametrize(("offset", "stays"), [(-3.0, True), (3.0, False)])
def test_slides_at_the_angle_of_its_friction(offset: float, stays: bool, plane: World, robot: Robot) -> None:
    sim = simulation(plane, robot)
    tilt_gravity(sim, math.atan(robot.friction) + math.radians(offset))
    for _ in range(50):
        sim.advance(Twist())
    speed = math.hypot(*sim.body.data.qvel[:2])
    # A held slope lets soft tyres creep by millimeters a second, a lost one gains 0.5 m/s each second.
    assert speed < 0.1 if stays else speed > 0.5


def tilt_gravity(sim: Simulation, angle: float) -> None:
    """Turn gravity as if the ground sloped down to the robot's right."""
    sim.body.model.opt.gravity[:] = (0.0, -9.81 * math.sin(angle), -9.81 * math.cos(angle))


def tip_angle(sim: Simulation) -> float:
    """Sideways angle at which the center of mass is above the edge of what the robot stands on."""
    model, data = sim.body.model, sim.body.data
    mujoco.mj_forward(model, data)
    x, y, z = data.subtree_com[model.body("base_link").id]
    feet = [data.geom_xpos[g][:2] for g in sim.body.wheel_geoms if model.geom_contype[g]]
    hull = ConvexHull(np.array(feet))
    # Each row (a, b, c): a x + b y + c <= 0 inside.
    half = min(y + (a * x + c) / b for a, b, c in hull.equations if b < -1e-6)
    return math.atan(half / z)


def lean(sim: Simulation, angle: float) -> float:
    """Turn gravity by an angle and hold it there; return the largest roll, degrees."""
    tilted = 0.0
    for k in range(150):
        tilt_gravity(sim, angle * min(1.0, (k + 1) / 75))
        sim.advance(Twist())
        tilted = max(tilted, abs(math.degrees(sim.pose().roll)))
    return tilted


@pytest.mark.parametrize(("offset", "stays"), [(-2.0, True), (2.0, False)])
def test_tips_at_the_geometric_angle(offset: float, stays: bool, plane: World, robot: Robot) -> None:
    sim = simulation(plane, robot, Pose2())
    sim.body.model.geom_friction[:, 0] = 5.0  # else it would slide first
    sim.body.model.opt.impratio = 100  # else it would creep, and turn to a wider stance
    lean(sim, tip_angle(sim) - math.radians(10))  # on its springs, if it has any
    angle = tip_angle(sim) + math.radians(offset)
    tilt_gravity(sim, 0.0)
    sim.reset(Pose2())
    tilted = lean(sim, angle)
    assert tilted < 6 if stays else tilted > 15


def test_full_speed_into_a_wall_of_boxes(robot: Robot, walled: World, T_world_wall: Pose2) -> None:
    sim = simulation(walled, robot, T_world_wall @ Pose2(1.5))
    for _ in range(math.ceil((1.5 / robot.max_speed + 0.5) / TICK)):
        sim.advance(Twist(robot.max_speed))
    found = sim.collisions
    assert found.max_penetration <= 0.010 * max(robot.max_speed, 1.0)
    # Its front is at the wall's face; all but the Jackal, whose tyres begin to climb, stay level.
    T = T_world_wall.inverse() @ sim.pose().to_pose2()
    assert 3.0 - robot.radius < T.x < 3.0
    assert abs(sim.pose().pitch) < math.radians(50 if robot.friction > 1 else 5)


def test_mjcf_and_data_row_agree(robot: Robot) -> None:
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf))
    touching = [g for g in range(model.ngeom) if model.geom_contype[g]]
    casters = [g for g in touching if model.geom(g).name.endswith("caster")]
    wheels = [g for g in touching if "wheel" in model.geom(g).name]
    for g in touching:
        assert model.geom_priority[g] >= 1
        if g in casters:
            assert model.geom_friction[g, 0] < 0.05
        elif g in wheels and casters:
            # What the casters carry does not hold: the tyres make up for it.
            assert robot.friction < model.geom_friction[g, 0] < 1.4 * robot.friction
        else:
            assert model.geom_friction[g, 0] == pytest.approx(robot.friction)
    left, right = model.body(robot.left_wheels[0]).pos, model.body(robot.right_wheels[0]).pos
    assert left[1] - right[1] == pytest.approx(robot.track, abs=1e-4)
    xs = [model.body(name).pos[0] for name in robot.left_wheels]
    assert max(xs) - min(xs) == pytest.approx(robot.wheelbase, abs=1e-4)
    assert robot.wheel_radius - left[2] == pytest.approx(robot.base_height, abs=1e-4)
    assert model.opt.timestep <= 0.005
    for actuator, joint in enumerate(model.actuator_trnid[:, 0]):  # see husky.xml
        armature = model.dof_armature[model.jnt_dofadr[joint]]
        assert model.actuator_gainprm[actuator, 0] * model.opt.timestep < armature
    assert model.opt.jacobian == mujoco.mjtJacobian.mjJAC_DENSE
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC


def test_the_robot_is_within_its_radius(robot: Robot) -> None:
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    lidar = np.array(robot.T_base_laser.position[:2])
    assert np.hypot(*lidar) < robot.radius
    for g in range(model.ngeom):
        if not model.geom_contype[g]:
            continue
        # Corners of the geom's own box.
        center, half = model.geom_aabb[g, :3], model.geom_aabb[g, 3:]
        corners = center + half * np.array(np.meshgrid(*3 * ((-1, 1),))).reshape(3, -1).T
        xy = (corners @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g])[:, :2]
        assert np.hypot(*xy.T).max() <= robot.radius + 0.02, model.geom(g).name


def test_the_lidar_never_sees_the_robot(plane: World, robot: Robot) -> None:
    sim = Simulation(plane, SimulationConfig(robot=robot))
    scan = sim.reset().scan
    model, data = sim.body.model, sim.body.data
    mujoco.mj_forward(model, data)
    T = sim.pose() @ scan.T_base_laser
    beams = np.stack((np.cos(scan.angles), np.sin(scan.angles), np.zeros(len(scan.angles))), axis=1)
    groups = np.array((1, 1, 1, 0, 1, 1), np.uint8)
    hit = np.zeros(1, np.int32)
    for beam in beams @ T.rotation.T:
        mujoco.mj_ray(model, data, T.position, beam, groups, 1, -1, hit)
        assert hit[0] == -1
    # The same rays straight down do meet it: the test can see.
    mujoco.mj_ray(model, data, T.position, np.array((0.0, 0.0, -1.0)), groups, 1, -1, hit)
    assert hit[0] >= 0


def test_a_row_needs_wheels_on_both_sides_or_rotors() -> None:
    figures = {key: getattr(ROBOTS["husky"], key) for key in vars(ROBOTS["husky"])}
    for changes, words in (
        ({"left_wheels": ()}, "wheels on both sides, or rotors"),
        ({"left_wheels": (), "right_wheels": ()}, "wheels on both sides, or rotors"),
        ({"rotors": ("a",)}, "wheels on both sides, or rotors"),
        ({"track": 0.0}, "track of robot 'husky' must be a finite number above 0"),
        ({"track": math.inf}, "track of robot 'husky' must be a finite number above 0"),
        ({"friction": math.nan}, "friction of robot 'husky' must be"),
        ({"wheelbase": -1.0}, "wheelbase of robot 'husky' must be a finite number at least 0"),
    ):
        with pytest.raises(ConfigError, match=words):
            Robot(**(figures | changes))
