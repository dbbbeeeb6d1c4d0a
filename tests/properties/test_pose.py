"""The group axioms of poses, and agreement with SciPy's rotations."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lirs_wct.geometry.pose import Pose2, Pose3, wrap_angle

metres = st.floats(-100, 100)
angles = st.floats(-10, 10) | st.floats(-1e-9, 1e-9)
poses2 = st.builds(Pose2, metres, metres, angles)
poses3 = st.builds(Pose3.from_rpy, metres, metres, metres, angles, angles, angles)
points3 = st.tuples(metres, metres, metres)


@given(angles)
def test_wrapped_angles_are_the_same_direction(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)


@given(poses2, poses2, st.tuples(metres, metres))
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


@given(poses3, points3)
def test_spatial_inverse(T: Pose3, point: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(T.inverse().apply(T.apply(point)), point, atol=1e-8)
    np.testing.assert_allclose((T @ T.inverse()).rotation, np.eye(3), atol=1e-12)


@given(angles, angles, angles)
def test_roll_pitch_yaw_are_scipys_fixed_axes(roll: float, pitch: float, yaw: float) -> None:
    T = Pose3.from_rpy(0, 0, 0, roll, pitch, yaw)
    expected = Rotation.from_euler("xyz", (roll, pitch, yaw))
    np.testing.assert_allclose(T.rotation, expected.as_matrix(), atol=1e-12)


@given(metres, metres, st.floats(-3, 3), st.floats(-1.4, 1.4), st.floats(-3, 3))
def test_angles_read_back(x: float, y: float, roll: float, pitch: float, yaw: float) -> None:
    T = Pose3.from_rpy(x, y, 0, roll, pitch, yaw)
    np.testing.assert_allclose((T.roll, T.pitch, T.yaw), (roll, pitch, yaw), atol=1e-9)
    np.testing.assert_allclose(T.to_pose2().as_array(), (x, y, yaw), atol=1e-9)
