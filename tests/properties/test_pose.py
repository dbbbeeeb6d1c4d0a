"""The group axioms of poses, and agreement with SciPy's rotations."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from lirs_wct.geometry.pose import Pose2, Pose3, wrap_angle

meters = st.floats(-100, 100)
angles = st.floats(-10, 10) | st.floats(-1e-9, 1e-9)
poses2 = st.builds(Pose2, meters, meters, angles)
poses3 = st.builds(Pose3.from_rpy, meters, meters, meters, angles, angles, angles)
points3 = st.tuples(meters, meters, meters)


@given(angles)
def test_wrapped_angles_are_the_same_direction(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)


@given(poses2, poses2, st.tuples(meters, meters))
def test_planar_composition_applies_right_to_left(
    T_ab: Pose2, T_bc: Pose2, point: tuple[float, float]
) -> None:
    np.testing.assert_allclose((T_ab @ T_bc).apply(point), T_ab.apply(T_bc.apply(point)), atol=1e-9)


@given(poses2)
def test_planar_inverse(T: Pose2) -> None:
    np.testing.assert_allclose((T @ T.inverse()).as_array(), 0, atol=1e-9)
    np.testing.assert_allclose((T.inverse() @ T).as_array(), 0, atol=1e-9)


@given(poses3, poses3, points3)
def test_spatial_composition_applies_right_to_left(
    T_ab: Pose3, T_bc: Pose3, point: tuple[float, float, float]
) -> None:
    np.testing.assert_allclose((T_ab @ T_bc).apply(point), T_ab.apply(T_bc.apply(point)), atol=1e-8)


@given(angles, angles, angles)
def test_roll_pitch_yaw_are_scipys_fixed_axes(roll: float, pitch: float, yaw: float) -> None:
    T = Pose3.from_rpy(0, 0, 0, roll, pitch, yaw)
    expected = Rotation.from_euler("xyz", (roll, pitch, yaw))
    np.testing.assert_allclose(T.rotation, expected.as_matrix(), atol=1e-12)


@given(meters, meters, st.floats(-3, 3), st.floats(-1.4, 1.4), st.floats(-3, 3))
def test_angles_read_back(x: float, y: float, roll: float, pitch: float, yaw: float) -> None:
    T = Pose3.from_rpy(x, y, 0, roll, pitch, yaw)
    np.testing.assert_allclose((T.roll, T.pitch, T.yaw), (roll, pitch, yaw), atol=1e-9)
    np.testing.assert_allclose(T.to_pose2().as_array(), (x, y, yaw), atol=1e-9)


@pytest.mark.parametrize(
    ("angle", "expected"),
    [(math.pi, math.pi), (-math.pi, math.pi), (3 * math.pi, math.pi), (0.0, 0.0), (3.5, 3.5 - math.tau)],
)
def test_wrapped_by_hand(angle: float, expected: float) -> None:
    assert wrap_angle(angle) == pytest.approx(expected, abs=1e-15)


def test_planar_poses_by_hand() -> None:
    assert Pose2() == Pose2(0.0, 0.0, 0.0)
    T = Pose2(1.0, 2.0, math.pi / 2)
    np.testing.assert_allclose(T.apply(((3.0, 5.0), (0.0, 0.0))), ((-4.0, 5.0), (1.0, 2.0)), atol=1e-12)
    np.testing.assert_allclose((T @ Pose2(3.0, 5.0, math.pi)).as_array(), (-4.0, 5.0, -math.pi / 2))
    np.testing.assert_allclose(T.inverse().as_array(), (-2.0, 1.0, -math.pi / 2), atol=1e-12)
    assert Pose2(1.0, -2.0, 9.0).distance(Pose2(4.0, 2.0, 0.0)) == 5.0
    assert Pose2(1.0, -2.0, 3.0).as_array().tolist() == [1.0, -2.0, 3.0]


@given(poses2, poses2)
def test_composed_yaws_are_wrapped(a: Pose2, b: Pose2) -> None:
    for yaw, expected in (((a @ b).yaw, a.yaw + b.yaw), (a.inverse().yaw, -a.yaw)):
        assert -math.pi < yaw <= math.pi
        assert yaw == pytest.approx(wrap_angle(expected), abs=1e-12)


def test_spatial_defaults_are_the_identity() -> None:
    assert Pose3() == Pose3(0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    np.testing.assert_array_equal(Pose3().rotation, np.eye(3))
    np.testing.assert_array_equal(Pose3().apply((1.0, 2.0, 3.0)), (1.0, 2.0, 3.0))
    assert Pose3.from_pose2(Pose2(1.0, 2.0, 0.0)) == Pose3(1.0, 2.0, 0.0)


@given(poses3, poses3)
def test_quaternions_are_scipys(a: Pose3, b: Pose3) -> None:
    """Product, inverse and angles of quaternions, wxyz here and xyzw there; signs may differ."""
    p, q = (Rotation.from_quat(np.roll(T.quaternion, -1)) for T in (a, b))
    for found, expected in ((a @ b, p * q), (a.inverse(), p.inv())):
        theirs = np.roll(expected.as_quat(), 1)
        assert abs(found.quaternion @ theirs) == pytest.approx(1.0)
        assert np.linalg.norm(found.quaternion) == pytest.approx(1.0)
    np.testing.assert_allclose(a.inverse().position, -p.inv().as_matrix() @ a.position, atol=1e-9)
    np.testing.assert_allclose((a @ b).position, p.apply(b.position) + a.position, atol=1e-9)
    if abs(a.pitch) < 1.5:
        np.testing.assert_allclose(
            Rotation.from_euler("xyz", (a.roll, a.pitch, a.yaw)).as_matrix(), p.as_matrix(), atol=1e-9
        )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_straight_up_and_down_have_a_pitch(sign: float) -> None:
    half = math.sqrt(0.5) * (1 + 1e-12)  # rounding beyond the unit sphere
    assert Pose3(0, 0, 0, half, 0, sign * half, 0).pitch == pytest.approx(sign * math.pi / 2)


@given(poses2, meters)
def test_a_planar_pose_lifted_stands_upright(T: Pose2, z: float) -> None:
    lifted = Pose3.from_pose2(T, z)
    assert (lifted.x, lifted.y, lifted.z) == (T.x, T.y, z)
    assert lifted == Pose3.from_rpy(T.x, T.y, z, 0.0, 0.0, T.yaw)
    np.testing.assert_allclose(lifted.to_pose2().as_array(), (T.x, T.y, wrap_angle(T.yaw)), atol=1e-9)


def test_arrays_become_a_pose_of_unit_length() -> None:
    pose = Pose3.from_arrays((1, 2, 3), (2.0, -4.0, 1.0, 2.0))
    assert pose == Pose3(1.0, 2.0, 3.0, 0.4, -0.8, 0.2, 0.4)
    assert (pose.position.tolist(), pose.quaternion.tolist()) == ([1, 2, 3], [0.4, -0.8, 0.2, 0.4])
    assert all(isinstance(v, float) for v in (pose.x, pose.qz))
