"""Lidar, wheels and inertial unit fused in space: its parts, and their sum on synthetic ground."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lirs_envs.lidar.lidar import moved_frames
from lirs_extensions.clouds.wheel_lio.mapper import (
    GRAVITY,
    Motion,
    WheelLioConfig,
    WheelLioMapper,
    gained_velocity,
    level,
)
from lirs_extensions.clouds.wheel_lio.registration import (
    NOTHING,
    BodyTwist,
    MatchRule,
    SpatialPrior,
    SweepPoints,
    deskew,
    find_edges,
    find_weak,
    linearize,
    register,
    thin,
)
from lirs_extensions.clouds.wheel_lio.voxel_map import LineMap, LocalMap, PlaneMap
from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import Imu, ImuReadings, PointCloud, Pose2, Pose3
from slam_baselines.mapper import make_cloud_mapper

RULE = MatchRule(0.02, 0.05, 0.5, 0.001, 0.03)
MOUNT = Pose3.from_rpy(0.2, 0.1, 0.4, 0.05, -0.1, 0.3)
LOOSE = np.repeat((0.3, 0.1), 3)
AT_ORIGIN = SpatialPrior(np.eye(3), np.zeros(3), LOOSE)
NO_READINGS = ImuReadings(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))


def surfaces(rng: np.random.Generator, *, length: float, walls: bool, ends: bool) -> FloatArray:
    """Return points on a floor 8.4 m wide, and on the walls at its sides and ends."""
    n, half = 20000, length / 2
    floor = np.column_stack((rng.uniform(-half, half, n), rng.uniform(-4.2, 4.2, n), np.full(n, -0.4)))
    side = np.column_stack((rng.uniform(-half, half, n), rng.choice((-4.2, 4.2), n), rng.uniform(-0.4, 2, n)))
    end = np.column_stack((rng.choice((-half, half), n), rng.uniform(-4.2, 4.2, n), rng.uniform(-0.4, 2, n)))
    parts = [floor, *([side] if walls else []), *([end] if ends else [])]
    return np.concatenate(parts) + rng.normal(0.0, 0.01, (n * len(parts), 3))


def mapped(points: FloatArray, cell: float = 0.5) -> LocalMap:
    local = LocalMap(PlaneMap(cell, 300.0), LineMap(cell, 300.0))
    local.planes.insert(points, np.zeros(3))
    return local


def seen_points(points: FloatArray, cell: float = 0.3) -> SweepPoints:
    return SweepPoints(thin(points, cell), np.zeros((0, 3)), np.zeros(3))


@pytest.mark.parametrize(
    ("scene", "weak"),
    [
        ({"length": 12.6, "walls": True, "ends": True}, []),
        ({"length": 60.0, "walls": True, "ends": False}, [(1, 0, 0, 0, 0, 0)]),
        ({"length": 60.0, "walls": False, "ends": False}, np.eye(6)[[0, 1, 5]]),
    ],
    ids=("room", "corridor", "plane"),
)
def test_the_weak_directions_are_those_of_the_scene(scene: dict[str, float], weak: FloatArray) -> None:
    rng = np.random.default_rng(1)
    voxels = mapped(surfaces(rng, **scene))  # type: ignore[arg-type]
    seen = surfaces(rng, **scene)  # type: ignore[arg-type]
    seen = seen_points(seen[np.abs(seen[:, 0]) < 10.0], 0.3)
    match = register(seen, voxels, AT_ORIGIN, RULE)
    constraint, expected = match.constraint, np.array(weak, dtype=float).reshape(-1, 6)
    found = constraint.directions[:, constraint.weak].T
    assert len(found) == len(expected)
    # Both span the same directions.
    np.testing.assert_allclose(found.T @ found, expected.T @ expected, atol=0.05)


def test_turns_are_weighed_by_the_arc_of_the_points() -> None:
    rng = np.random.default_rng(2)
    scene = {"length": 12.6, "walls": True, "ends": True}
    values = []
    for scale in (1.0, 3.0):
        points = scale * surfaces(rng, **scene)  # type: ignore[arg-type]
        voxels = mapped(points, 0.5 * scale)
        rule = MatchRule(0.02 * scale, 0.05, 0.5 * scale, 0.001, 0.03)
        match = register(seen_points(points, 0.3 * scale), voxels, AT_ORIGIN, rule)
        values.append(match.constraint.values)
    np.testing.assert_allclose(values[0], values[1], rtol=0.1)


def test_eigenvalues_below_the_limit_are_weak() -> None:
    turn = Rotation.random(random_state=3).as_matrix()
    information = np.diag((0.5, 0.5, 0.5, 0.3, 0.3, 0.3))
    information[:3, :3] = turn @ np.diag((0.02**2, 0.04**2, 0.9)) @ turn.T
    constraint = find_weak(information, 0.03)
    np.testing.assert_allclose(constraint.values[:2], (0.02**2, 0.04**2))
    assert constraint.weak.tolist() == [True] + 5 * [False]
    np.testing.assert_allclose(abs(constraint.directions[:3, 0] @ turn[:, 0]), 1.0)


def test_registration_recovers_a_known_transform() -> None:
    rng = np.random.default_rng(4)
    scene = {"length": 12.6, "walls": True, "ends": True}
    voxels = mapped(surfaces(rng, **scene))  # type: ignore[arg-type]
    R, t = Rotation.from_rotvec((0.02, -0.03, 0.06)).as_matrix(), np.array((0.2, -0.15, 0.05))
    seen = (surfaces(rng, **scene) - t) @ R  # type: ignore[arg-type]
    match = register(seen_points(seen, 0.3), voxels, AT_ORIGIN, RULE)
    np.testing.assert_allclose(match.t, t, atol=2e-3)
    assert Rotation.from_matrix(match.R @ R.T).magnitude() < 1e-3


def test_the_prior_alone_decides_in_a_weak_direction() -> None:
    rng = np.random.default_rng(5)
    scene = {"length": 60.0, "walls": True, "ends": False}
    voxels = mapped(surfaces(rng, **scene))  # type: ignore[arg-type]
    seen = surfaces(rng, **scene)  # type: ignore[arg-type]
    expected = np.array((0.37, 0.1, -0.05))
    prior = SpatialPrior(np.eye(3), expected, LOOSE)
    match = register(seen_points(seen[np.abs(seen[:, 0]) < 10.0], 0.3), voxels, prior, RULE)
    assert match.t[0] == pytest.approx(0.37, abs=0.01)
    np.testing.assert_allclose(match.t[1:], 0.0, atol=3e-3)


def test_the_linearization_is_the_derivative_of_the_distances() -> None:
    rng = np.random.default_rng(6)
    planes = mapped(surfaces(rng, length=12.0, walls=False, ends=False)).planes
    points, t = np.array(((1.2, 0.7, -0.35), (3.3, -2.2, -0.45))), np.array((0.02, 0.01, 0.03))
    soft = MatchRule(100.0, 0.05, 0.5, 0.001, 0.03)  # all weights alike
    step = np.array((0.0, 0.0, 1e-3, 1e-3, -2e-3, 0.0))

    def gradient(x: FloatArray) -> FloatArray:
        R = Rotation.from_rotvec(x[3:]).as_matrix()
        found: FloatArray = linearize(points, np.zeros(3), planes.table, planes.cell, R, t + x[:3], soft)[1]
        return found

    H = linearize(points, np.zeros(3), planes.table, planes.cell, np.eye(3), t, soft)[0]
    np.testing.assert_allclose(gradient(np.zeros(6)) - gradient(step), H @ step, rtol=0.02, atol=1e-9)


def test_the_other_face_of_a_thin_wall_is_not_taken_for_the_first() -> None:
    """The first face is at x = 4, seen from the origin; the other one is 0.3 m behind it."""
    rng = np.random.default_rng(8)
    yz = rng.uniform((-4, -0.4), (4, 2), (4000, 2))
    voxels = mapped(np.column_stack((np.full(4000, 4.0), yz)))
    planes = voxels.planes.table.planes.copy()
    R, t = Rotation.from_rotvec((0, 0, math.pi)).as_matrix(), np.array((8.0, 0.0, 0.0))
    other = (np.column_stack((np.full(4000, 4.3), yz)) - t) @ R
    match = register(seen_points(other), voxels, SpatialPrior(R, t, LOOSE), RULE)
    assert match.points == 0
    voxels.planes.insert(np.column_stack((np.full(4000, 4.3), yz)), t)
    flat = planes[:, 6] > 0
    np.testing.assert_array_equal(voxels.planes.table.planes[flat], planes[flat])


def test_too_few_planes_constrain_nothing() -> None:
    voxels = mapped(np.zeros((0, 3)))
    prior = SpatialPrior(np.eye(3), np.ones(3), LOOSE)
    match = register(SweepPoints(np.ones((100, 3)), np.zeros((0, 3)), np.zeros(3)), voxels, prior, RULE)
    assert match.constraint is NOTHING
    assert (match.points, match.t.tolist()) == (0, [1.0, 1.0, 1.0])


def test_a_ring_on_the_ground_makes_no_plane() -> None:
    angles = np.linspace(0, math.tau, 4000)
    ring = np.column_stack((4 * np.cos(angles), 4 * np.sin(angles), np.zeros(4000)))
    voxels = mapped(ring)
    assert not voxels.planes.table.planes[:, 6].any()
    voxels.planes.insert(1.05 * ring, np.zeros(3))
    voxels.planes.insert(1.1 * ring, np.zeros(3))
    assert voxels.planes.table.planes[:, 6].any()


def test_deskewing_at_constant_twist_gives_the_cloud_of_one_instant() -> None:
    rng = np.random.default_rng(7)
    instant = rng.uniform(-20, 20, (3000, 3))
    time = np.sort(rng.uniform(0.0, 0.1, 3000)).astype(np.float32)
    twist = BodyTwist(np.array((1.5, -0.3, 0.2)), np.array((0.3, -0.4, 1.8)))
    R, p = moved_frames(time, twist.linear, twist.angular)
    at_time = np.einsum("nji,nj->ni", R, instant - p)
    xyz = MOUNT.inverse().apply(at_time).astype(np.float32)
    cloud = PointCloud(xyz, np.zeros(3000, np.uint16), time, 5.0, MOUNT)
    assert np.abs(MOUNT.apply(xyz) - instant).max() > 1.0
    np.testing.assert_allclose(deskew(cloud, twist), instant, atol=1e-4)
    still = BodyTwist(np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(deskew(cloud, still), MOUNT.apply(xyz), atol=1e-5)


def test_points_are_thinned_to_the_mean_of_each_cell() -> None:
    points = np.random.default_rng(8).uniform(-3, 3, (2000, 3))
    found = thin(points, 1.0)
    cells = np.unique(np.floor(points), axis=0)
    assert len(found) == len(cells)
    for mean in found[:20]:
        inside = points[(np.floor(points) == np.floor(mean)).all(axis=1)]
        np.testing.assert_allclose(mean, inside.mean(axis=0))


def wall_sweep(x: float) -> tuple[FloatArray, FloatArray]:
    """Return points and rings of a sweep at (x, 0) to a wall from (-3, 6) to (4, 6)."""
    azimuth = np.arange(-np.pi, np.pi, math.tau / 1800)
    c, s = np.cos(azimuth), np.sin(azimuth)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where((s > 0) & (x + 6 / s * c > -3) & (x + 6 / s * c < 4), 6 / s, np.inf)
    rings = []
    for k, slope in enumerate(np.tan(np.radians((-3, -1, 1, 3)))):
        met = np.isfinite(distance)
        rings.append(np.column_stack((distance * c, distance * s, distance * slope, np.full(1800, k)))[met])
    rows = np.concatenate(rings)
    return rows[:, :3], rows[:, 3].astype(np.uint16)


@pytest.mark.parametrize("x", [-1.0, 0.0, 2.5])
def test_the_ends_of_a_wall_are_edges(x: float) -> None:
    points, ring = wall_sweep(x)
    edges = find_edges(points, ring, np.zeros(3)) + np.array((x, 0.0, 0.0))
    assert len(edges) == 8
    np.testing.assert_allclose(np.sort(edges[:, 0]), 4 * [-3.0] + 4 * [4.0], atol=0.04)
    np.testing.assert_allclose(edges[:, 1], 6.0, atol=1e-6)


def test_edges_find_the_place_along_a_wall() -> None:
    points, ring = wall_sweep(0.0)
    local = mapped(surfaces(np.random.default_rng(11), length=60.0, walls=False, ends=False))
    for x in (-0.4, -0.2, 0.0, 0.2):
        points, ring = wall_sweep(x)
        local.lines.insert(find_edges(points, ring, np.zeros(3)) + np.array((x, 0.0, 0.0)), np.zeros(3))
    points, ring = wall_sweep(0.7)
    ground = surfaces(np.random.default_rng(12), length=20.0, walls=False, ends=False)
    seen = SweepPoints(thin(ground, 0.3), find_edges(points, ring, np.zeros(3)), np.zeros(3))
    for expected in (0.5, 0.9):
        prior = SpatialPrior(np.eye(3), np.array((expected, 0.1, 0.0)), np.repeat((1.0, 0.02), 3))
        match = register(seen, local, prior, RULE)
        np.testing.assert_allclose(match.t, (0.7, 0.0, 0.0), atol=0.03)


def test_far_voxels_are_dropped_before_the_map_grows() -> None:
    rng, voxels = np.random.default_rng(9), PlaneMap(0.5, 30.0)
    sizes = []
    for k in range(60):
        center = np.array((10.0 * k, 0.0, 0.0))
        voxels.insert(center + rng.uniform((-20, -20, -1), (20, 20, 1), (5000, 3)), center)
        sizes.append(voxels.memory)
    assert sizes[-1] == sizes[len(sizes) // 2]


def circle(
    slope: float, seconds: float, bias: FloatArray | None = None
) -> list[tuple[Imu, ImuReadings, Pose2, Pose3]]:
    """Return sensor data and true poses, ten a second, of a robot that circles on an incline at 1 m/s."""
    tilt, rate, radius = Rotation.from_euler("y", -slope), 200, 3.0
    rows = []
    for k in range(int(10 * seconds) + 1):
        yaw = 0.1 * k / radius
        turn = tilt * Rotation.from_euler("z", yaw)
        place = tilt.apply((radius * math.sin(yaw), radius * (1 - math.cos(yaw)), 0.0))
        truth = Pose3.from_arrays(place, turn.as_quat(scalar_first=True))
        n = 20 if k else 0
        stamps = 0.1 * (k - 1) + (np.arange(n) + 1) / rate
        middle = tilt * Rotation.from_rotvec(np.outer(stamps - 0.5 / rate, (0, 0, 1 / radius)))
        rates = np.tile((0.0, 0.0, 1 / radius), (n, 1))
        forces = middle.inv().apply(np.tile(GRAVITY, (n, 1))) + np.array((0.0, 1 / radius, 0.0))
        planar = Pose2(truth.x, truth.y, truth.yaw)
        rows.append(
            (Imu(truth.roll, truth.pitch, stamp=0.1 * k), ImuReadings(stamps, rates, forces), planar, truth)
        )
    return rows


def test_dead_reckoning_integrates_a_circle_on_an_incline() -> None:
    rows, motion = circle(0.3, 18.0), Motion(2.0)
    start = rows[0][3].yaw
    for imu, readings, odometry, truth in rows:
        predicted = motion.predict(imu.stamp, odometry, imu, readings)
        motion.correct(predicted.R, predicted.t)
        expected = Rotation.from_euler("z", -start).as_matrix() @ truth.position
        np.testing.assert_allclose(predicted.t, expected, atol=0.02)
        if predicted.seconds:
            np.testing.assert_allclose(predicted.twist.linear, (1.0, 0.0, 0.0), atol=0.03)
            np.testing.assert_allclose(predicted.twist.angular, (0.0, 0.0, 1 / 3), atol=1e-6)
    turned = Rotation.from_matrix(rows[-1][3].rotation.T @ predicted.R)
    assert turned.magnitude() < 0.01


def test_the_velocity_at_the_end_of_a_step_includes_the_acceleration() -> None:
    R = Rotation.from_euler("xyz", (0.1, 0.2, 0.7)).as_matrix()
    forces = np.tile(R.T @ (GRAVITY + np.array((2.0, -1.0, 0.5))), (20, 1))
    readings = ImuReadings(0.005 * np.arange(1, 21), np.zeros((20, 3)), forces)
    np.testing.assert_allclose(gained_velocity(readings, R, 0.1), (0.1, -0.05, 0.025), atol=1e-12)


def test_the_bias_of_the_gyro_is_learned_while_the_wheels_stand() -> None:
    bias, motion = np.array((0.001, -0.002, 0.003)), Motion(2.0)
    for k in range(11):
        rates = np.tile(bias, (20, 1))
        motion.predict(
            0.1 * k, Pose2(), Imu(), ImuReadings(np.arange(20.0), rates, np.tile(GRAVITY, (20, 1)))
        )
    np.testing.assert_allclose(motion.bias, bias)
    creeping = Motion(2.0)
    for k in range(11):
        rates = np.tile(bias, (20, 1))
        readings = ImuReadings(np.arange(20.0), rates, np.tile(GRAVITY, (20, 1)))
        creeping.predict(0.1 * k, Pose2(1e-4 * k), Imu(), readings)
    assert not creeping.bias.any()


def test_turning_on_the_spot_is_no_bias_of_the_gyro() -> None:
    motion, yaw = Motion(2.0), 0.0
    for k in range(40):
        rate = 1.0 if k >= 20 else 0.0
        yaw += 0.1 * rate
        rates = np.tile((0.0, 0.0, rate), (20, 1))
        motion.predict(
            0.1 * k, Pose2(0.0, 0.0, yaw), None, ImuReadings(np.zeros(20), rates, np.zeros((20, 3)))
        )
    assert not motion.bias.any()


def test_leveling_takes_the_tilt_and_leaves_the_heading() -> None:
    imu, R = Imu(roll=0.1, pitch=-0.2), Pose3.from_rpy(0, 0, 0, 0.15, -0.1, 0.8).rotation
    for _ in range(100):
        R = level(R, imu, 0.2)
    pose = Pose3.from_arrays(np.zeros(3), Rotation.from_matrix(R).as_quat(scalar_first=True))
    assert (pose.roll, pose.pitch) == pytest.approx((0.1, -0.2), abs=1e-6)
    assert pose.yaw == pytest.approx(0.8, abs=0.02)


def empty(stamp: float) -> PointCloud:
    none = np.zeros(0)
    return PointCloud(
        np.zeros((0, 3), np.float32), none.astype(np.uint16), none.astype(np.float32), stamp, MOUNT
    )


def test_without_returns_the_pose_is_dead_reckoning() -> None:
    mapper, motion = WheelLioMapper(WheelLioConfig()), Motion(2.0)
    first = Pose3()
    for k, (imu, readings, odometry, _) in enumerate(circle(0.2, 5.0)):
        found = mapper.update(empty(imu.stamp), imu, readings, odometry)
        predicted = motion.predict(imu.stamp, odometry, imu, readings)
        motion.correct(predicted.R, predicted.t)
        pose = Pose3.from_arrays(predicted.t, Rotation.from_matrix(predicted.R).as_quat(scalar_first=True))
        first = first if k else pose.inverse()
        np.testing.assert_allclose(found.position, (first @ pose).position, atol=1e-12)
    assert mapper.stats.used == 0
    meters, radians = (np.sqrt(np.diag(mapper.covariance)[k]) for k in (0, 2))
    assert meters > WheelLioConfig().shift_per_meter * math.sqrt(4.5)
    assert radians > WheelLioConfig().turn_per_second * math.sqrt(4.9)
    assert mapper.trajectory().length > 4.5


def sweeps(seed: int) -> list[tuple[PointCloud, Imu, ImuReadings, Pose2]]:
    """Return a straight drive of 2 m through a corridor, with wheels that measure 5 % too much."""
    rng, rows = np.random.default_rng(seed), []
    for k in range(20):
        x = 0.1 * k
        seen = surfaces(rng, length=60.0, walls=True, ends=False) - (x, 0.0, 0.0)
        seen = seen[np.abs(seen[:, 0]) < 12.0].astype(np.float32)
        n = len(seen)
        cloud = PointCloud(seen, np.zeros(n, np.uint16), np.zeros(n, np.float32), 0.1 * k)
        held = 20 if k else 0
        readings = ImuReadings(np.arange(1.0 * held), np.zeros((held, 3)), np.tile(GRAVITY, (held, 1)))
        rows.append((cloud, Imu(stamp=0.1 * k), readings, Pose2(1.05 * x, 0.03 * x, 0.0)))
    return rows


def test_a_corridor_corrects_all_but_the_distance() -> None:
    mapper = WheelLioMapper(WheelLioConfig())
    for row in sweeps(1):
        pose = mapper.update(*row)
    assert pose.x == pytest.approx(1.05 * 1.9, abs=0.02)
    assert (pose.y, pose.z) == pytest.approx((0.0, 0.0), abs=0.01)
    along, across = np.sqrt(np.diag(mapper.covariance)[:2]).tolist()
    assert across < 1.5 * WheelLioConfig().noise < along


def test_the_same_sweeps_give_the_same_bytes() -> None:
    found = []
    for _ in range(2):
        mapper = make_cloud_mapper("wheel_lio", seed=1)
        for row in sweeps(2)[:8]:
            mapper.update(*row)  # type: ignore[call-arg]
        found.append(mapper.trajectory())
    assert found[0].positions.tobytes() == found[1].positions.tobytes()
    assert found[0].quaternions.tobytes() == found[1].quaternions.tobytes()


def test_missing_odometry_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"wheel_lio needs odometry, the scan at 2.0 s has none"):
        WheelLioMapper(WheelLioConfig()).update(empty(2.0), Imu(), NO_READINGS, None)
