"""The Husky does what its data sheet says: on the flat, on slopes, against obstacles."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from lirs_envs.drive import Twist
from lirs_envs.robots import ROBOTS, Robot
from lirs_envs.simulation import Simulation
from lirs_wct.pose import Pose2
from lirs_wct.world import World, build_world


def body_twist(sim: Simulation) -> tuple[float, float]:
    """True speed ahead and turn rate."""
    v = sim.body.data.qvel
    yaw = sim.T_world_base.yaw
    return float(v[0] * math.cos(yaw) + v[1] * math.sin(yaw)), float(v[5])


@pytest.mark.parametrize("ground", ["plane", "flat_field"])
def test_at_rest_for_ten_seconds(ground: str, husky: Robot, request: pytest.FixtureRequest) -> None:
    sim = Simulation(request.getfixturevalue(ground), husky)
    sim.reset(Pose2(1.0, 2.0, 0.7))
    start = sim.T_world_base
    for _ in range(250):
        sim.advance(Twist())
    end = sim.T_world_base
    assert math.hypot(end.x - start.x, end.y - start.y) < 1e-3
    assert abs(end.yaw - start.yaw) * husky.radius < 1e-3
    assert end.z == pytest.approx(husky.base_height, abs=1e-3)
    assert (start.x, start.y, start.yaw) == pytest.approx((1.0, 2.0, 0.7), abs=2e-3)


@pytest.mark.parametrize("ground", ["plane", "flat_field"])
@pytest.mark.parametrize(
    ("v", "omega"), [(1.0, 0.0), (-1.0, 0.0), (0.0, 2.0), (0.0, -2.0), (0.0, 0.2), (0.5, 1.0), (1.0, -0.5)]
)
def test_commanded_is_driven(
    v: float, omega: float, ground: str, husky: Robot, request: pytest.FixtureRequest
) -> None:
    sim = Simulation(request.getfixturevalue(ground), husky)
    sim.reset()
    for _ in range(25):
        sim.advance(Twist(v, omega))
    reached = []
    for _ in range(50):
        sim.advance(Twist(v, omega))
        reached.append(body_twist(sim))
    mean = np.mean(reached, axis=0)
    assert mean[0] == pytest.approx(v, abs=0.05 * husky.max_speed * max(abs(v), 0.4))
    assert mean[1] == pytest.approx(omega, abs=max(0.05 * abs(omega), 0.01))


def test_commands_beyond_the_limits_are_clipped(plane: World, husky: Robot) -> None:
    sim = Simulation(plane, husky)
    sim.reset()
    for _ in range(50):
        sim.advance(Twist(5.0, 0.0))
    assert body_twist(sim)[0] == pytest.approx(husky.max_speed, rel=0.05)


def test_speeds_up_and_stops_within_the_limit(plane: World, husky: Robot) -> None:
    sim = Simulation(plane, husky)
    sim.reset()
    speeds = [0.0]
    for k in range(45):
        sim.advance(Twist(1.0) if k < 20 else Twist())
        speeds.append(body_twist(sim)[0])
    assert np.abs(np.diff(speeds)).max() / sim.period <= 1.1 * husky.max_acceleration
    stop = husky.max_speed / husky.max_acceleration
    assert abs(speeds[20 + math.ceil((stop + 0.1) / sim.period)]) < 0.01
    assert speeds[8] > 0.9


def test_turns_up_within_the_limit(plane: World, husky: Robot) -> None:
    sim = Simulation(plane, husky)
    sim.reset()
    rates = [0.0]
    for _ in range(20):
        sim.advance(Twist(0.0, 2.0))
        rates.append(body_twist(sim)[1])
    assert max(rates) < 1.15 * husky.max_turn_rate
    # From the fourth tick on the robot is no longer breaking loose.
    assert rates[4] < 1.3 * husky.max_turn_acceleration * 4 * sim.period


def test_climbs_thirty_degrees(make_world, husky: Robot) -> None:
    slope = math.tan(math.radians(30))
    world = make_world(lambda x, y: np.maximum(0.0, x + 5) * slope)
    sim = Simulation(world, husky)
    sim.reset(Pose2(-7.0, 0.0, 0.0))
    while sim.time < 15 and sim.T_world_base.x < 3.5:
        sim.advance(Twist(1.0))
    assert sim.T_world_base.x > 3.5
    assert sim.T_world_base.z > 8.5 * slope
    assert not sim.tipped
    assert abs(sim.T_world_base.y) < 0.3


@pytest.mark.parametrize(("offset", "stays"), [(-3.0, True), (3.0, False)])
def test_slides_at_the_angle_of_its_friction(offset: float, stays: bool, plane: World, husky: Robot) -> None:
    angle = math.atan(husky.friction) + math.radians(offset)
    sim = Simulation(plane, husky)
    sim.reset()
    sim.body.model.opt.gravity[:] = (0.0, -9.81 * math.sin(angle), -9.81 * math.cos(angle))
    for _ in range(50):
        sim.advance(Twist())
    speed = math.hypot(*sim.body.data.qvel[:2])
    # A held slope lets soft tyres creep by millimetres a second, a lost one gains 0.5 m/s each second.
    assert speed < 0.1 if stays else speed > 0.5


@pytest.mark.parametrize("where", ["rough", "advanced"])
def test_random_driving_never_tunnels(where: str, husky: Robot, request: pytest.FixtureRequest) -> None:
    world = build_world("advanced") if where == "advanced" else request.getfixturevalue(where)
    sim = Simulation(world, husky)
    sim.reset()
    rng = np.random.default_rng(4)
    driven, last = 0.0, sim.T_world_base
    for k in range(1500):
        if k % 40 == 0:
            v = rng.choice((-1.0, 1.0, 1.0))
            command = Twist(v, rng.uniform(-2, 2) * rng.integers(2))
        sim.advance(command)
        here = sim.T_world_base
        driven += math.hypot(here.x - last.x, here.y - last.y)
        last = here
        assert here.z > world.surface.height_at(here.x, here.y) - 0.05
        if sim.off_world or sim.tipped:
            break
    found = sim.collisions
    assert driven > 10
    assert found.body_contacts > 0, "it never met an obstacle, so that nothing was tested"
    assert found.penetration_p999 <= 0.010
    assert found.max_penetration <= 0.010
    energy = 0.5 * sim.body.data.qvel[:3] @ sim.body.data.qvel[:3]
    assert energy < 2.0


def test_full_speed_into_a_wall_of_boxes(husky: Robot, walled: World, T_world_wall: Pose2) -> None:
    sim = Simulation(walled, husky)
    sim.reset(T_world_wall)
    for _ in range(150):
        sim.advance(Twist(1.0))
    found = sim.collisions
    assert found.body_contacts >= 1
    assert found.max_penetration <= 0.010
    # The bumper, 0.49 m ahead of base_link, is at the wall's face.
    T = T_world_wall.inverse() @ sim.T_world_base.to_pose2()
    assert T.x + 0.4937 == pytest.approx(3.0, abs=0.01)


def test_mjcf_and_data_row_agree() -> None:
    for robot in ROBOTS.values():
        model = mujoco.MjModel.from_xml_path(str(robot.mjcf))
        touching = model.geom_contype != 0
        np.testing.assert_allclose(model.geom_friction[touching, 0], robot.friction)
        assert (model.geom_priority[touching] == 1).all()
        left, right = model.body(robot.left_wheels[0]).pos, model.body(robot.right_wheels[0]).pos
        assert left[1] - right[1] == pytest.approx(robot.track, abs=1e-4)
        xs = [model.body(name).pos[0] for name in robot.left_wheels]
        assert max(xs) - min(xs) == pytest.approx(robot.wheelbase, abs=1e-4)
        assert robot.wheel_radius - left[2] == pytest.approx(robot.base_height, abs=1e-4)
        assert model.opt.timestep <= 0.005
        assert model.opt.jacobian == mujoco.mjtJacobian.mjJAC_DENSE
        assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC


def test_husky_has_the_published_masses() -> None:
    model = mujoco.MjModel.from_xml_path(str(ROBOTS["husky"].mjcf))
    assert model.body("base_link").mass[0] == pytest.approx(46.034)
    assert model.body_mass.sum() == pytest.approx(46.034 + 4 * 2.637)
    np.testing.assert_allclose(model.body("base_link").inertia, (0.6022, 1.7386, 2.0296))


def test_the_laser_never_sees_the_robot(plane: World, husky: Robot) -> None:
    sim = Simulation(plane, husky)
    scan = sim.reset().scan
    model, data = sim.body.model, sim.body.data
    mujoco.mj_forward(model, data)
    T = sim.T_world_base @ scan.T_base_laser
    beams = np.stack((np.cos(scan.angles), np.sin(scan.angles), np.zeros(len(scan.angles))), axis=1)
    groups = np.array((1, 1, 1, 0, 1, 1), np.uint8)
    hit = np.zeros(1, np.int32)
    for beam in beams @ T.rotation.T:
        mujoco.mj_ray(model, data, T.position, beam, groups, 1, -1, hit)
        assert hit[0] == -1
    # The same rays straight down do meet it: the test can see.
    mujoco.mj_ray(model, data, T.position, np.array((0.0, 0.0, -1.0)), groups, 1, -1, hit)
    assert hit[0] >= 0
