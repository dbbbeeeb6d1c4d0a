"""Mapper in space that fuses lidar, wheels and inertial unit.

Wheels, gyro and gravity predict the pose. Each sweep is deskewed by the predicted velocity and registered
with a local map of planes and vertical lines, with the prediction as prior. In directions that the planes do
not constrain, prediction and lines decide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lirs_extensions.clouds.wheel_lio.registration import (
    BodyTwist,
    MatchRule,
    PlaneMatch,
    SpatialPrior,
    SweepPoints,
    deskew,
    find_edges,
    register,
    thin,
)
from lirs_extensions.clouds.wheel_lio.voxel_map import LineMap, LocalMap, PlaneMap
from lirs_wct.errors import Checked, limited
from lirs_wct.geometry import FloatArray, Imu, ImuReadings, PointCloud, Pose2, Pose3, Trajectory
from slam_baselines.dead_reckoning import DriftCovariance, climb
from slam_baselines.mapper import MapperStats, Stopwatch, required_odometry

GRAVITY = np.array((0.0, 0.0, 9.80665))
STANDING = 1e-5
"""Motion of the wheels between two sweeps up to which the robot stands, meters."""
STILL = math.radians(1.0)
"""Yaw rate of the odometry up to which the robot stands, and does not turn on the spot, rad/s."""
REST = 100
"""Readings of a standing robot that are needed for the bias of its gyro."""
LATEST = 2
"""Last readings of the gyro that give the rate at a sweep's stamp."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """Expected state at a sweep's stamp, after a planar step by odometry of some seconds.

    Rotation R (3, 3) and position t (3,), meters, of the base are in the level map frame.
    """

    R: FloatArray
    t: FloatArray
    twist: BodyTwist
    step: Pose2
    seconds: float


class Motion:
    """Dead reckoning from sweep to sweep, from corrected poses.

    The bias of the gyro is its mean while the robot stands. The tilt follows the measured one within
    `tilt_time`, seconds.
    """

    def __init__(self, tilt_time: float) -> None:
        self._tilt_time = tilt_time
        self._R, self._t = np.eye(3), np.zeros(3)
        self._odometry: Pose2 | None = None
        self._stamp = 0.0
        self._resting_sum, self._resting = np.zeros(3), 0

    def correct(self, R: FloatArray, t: FloatArray) -> None:
        """Set the pose at the last stamp."""
        self._R, self._t = R, t

    def predict(self, stamp: float, odometry: Pose2, imu: Imu | None, readings: ImuReadings) -> Prediction:
        """Return the expected state at a stamp; the first position is the origin.

        Without roll and pitch of the IMU the tilt is the gyro's, whose readings are those since the last
        stamp.
        """
        before, self._odometry = self._odometry, odometry
        seconds, self._stamp = stamp - self._stamp, stamp
        if before is None:
            R = np.eye(3) if imu is None else Pose3.from_rpy(0, 0, 0, imu.roll, imu.pitch, 0).rotation
            return Prediction(R, np.zeros(3), BodyTwist(np.zeros(3), np.zeros(3)), Pose2(), 0.0)
        step = before.inverse() @ odometry
        if math.hypot(step.x, step.y) < STANDING and abs(step.yaw) < STILL * seconds:
            self._resting_sum = self._resting_sum + readings.angular_velocity.sum(axis=0)
            self._resting += len(readings)
        R = self._R @ self._turn(step, seconds, readings)
        if imu is not None:
            R = level(R, imu, -math.expm1(-seconds / self._tilt_time))
        shift = self._shift(step, R)
        velocity = shift / seconds
        if imu is not None:
            velocity = velocity + gained_velocity(readings, R, seconds)
        rates = np.array((0.0, 0.0, step.yaw / seconds))
        if len(readings):
            rates = readings.angular_velocity[-LATEST:].mean(axis=0) - self.bias
        twist = BodyTwist(R.T @ velocity, rates)
        return Prediction(R, self._t + shift, twist, step, seconds)

    @property
    def bias(self) -> FloatArray:
        """(3,) of the gyro, rad/s; 0 until the robot has stood."""
        return self._resting_sum / self._resting if self._resting >= REST else np.zeros(3)

    def _turn(self, step: Pose2, seconds: float, readings: ImuReadings) -> FloatArray:
        """Return the rotation of a step (3, 3) by the gyro, else by the odometry."""
        if not len(readings):
            return Pose3.from_pose2(step).rotation
        turn = Rotation.identity()
        for angle in (readings.angular_velocity - self.bias) * (seconds / len(readings)):
            turn = turn * Rotation.from_rotvec(angle)
        matrix: FloatArray = turn.as_matrix()
        return matrix

    def _shift(self, step: Pose2, R: FloatArray) -> FloatArray:
        """Return the shift of a step (3,) in the map frame."""
        yaw = math.atan2(self._R[1, 0], self._R[0, 0])
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = c * step.x - s * step.y, s * step.x + c * step.y
        return np.array((dx, dy, climb(dx, dy, self._R[:, 2] + R[:, 2])))


def gained_velocity(readings: ImuReadings, R: FloatArray, seconds: float) -> FloatArray:
    """Return the velocity (3,) gained from the mean to the end of a step, m/s.

    It is the integral of t a(t) / T over the step's T seconds, with the accelerations a at the attitude R.
    """
    n = len(readings)
    if not n:
        return np.zeros(3)
    share = (np.arange(n) + 0.5) / n
    gained: FloatArray = share @ (readings.linear_acceleration @ R.T - GRAVITY) * (seconds / n)
    return gained


def level(R: FloatArray, imu: Imu, share: float) -> FloatArray:
    """Return a rotation (3, 3) turned toward the measured roll and pitch by a share."""
    sr, cr, sp, cp = math.sin(imu.roll), math.cos(imu.roll), math.sin(imu.pitch), math.cos(imu.pitch)
    x, y, _ = R @ np.array((-sp, sr * cp, cr * cp))
    turned: FloatArray = Rotation.from_rotvec((share * y, -share * x, 0.0)).as_matrix() @ R
    return turned


@dataclass(frozen=True, kw_only=True)
class WheelLioConfig(Checked, of="wheel_lio"):
    """Parameters of map, registration and motion.

    Attributes:
        cell: edge of the map's smallest voxels, meters.
        thin: edge of the cells whose points are registered as their mean, meters.
        near: points nearer to the base are left out, meters.
        far: points farther are left out.
        radius: the map is kept up to this distance, meters.
        key_shift: a sweep goes into the map after this motion, meters.
        key_turn: or after this turn, radians.
        noise: standard deviation of a point on a surface, meters.
        edge: standard deviation of a point on a vertical edge, meters.
        gate: distance from its plane or line beyond which a point is left out, meters.
        error: standard deviation of the error that the points of a sweep share, meters.
        weak: root mean square of the share of a motion that the planes see, below which its direction is
            left to the prediction. Planes of bare, level ground pretend to see about .01.
        shift_per_meter: standard deviation of the predicted shift after one meter, meters.
        shift_per_radian: after turning one radian.
        shift_per_second: after one second.
        turn_per_second: standard deviation of the predicted rotation after one second, radians.
        tilt_time: seconds within which roll and pitch follow gravity.
    """

    cell: float = limited(0.5, "(0, inf)")
    thin: float = limited(0.3, "(0, inf)")
    near: float = limited(0.5, "(0, inf)")
    far: float = limited(60.0, "(0, inf)")
    radius: float = limited(80.0, "(0, inf)")
    key_shift: float = limited(0.1, "(0, inf)")
    key_turn: float = limited(0.05, "(0, inf)")
    noise: float = limited(0.02, "(0, inf)")
    edge: float = limited(0.05, "(0, inf)")
    gate: float = limited(0.5, "(0, inf)")
    error: float = limited(0.001, "(0, inf)")
    weak: float = limited(0.03, "(0, inf)")
    shift_per_meter: float = limited(0.04, "(0, inf)")
    shift_per_radian: float = limited(0.1, "(0, inf)")
    shift_per_second: float = limited(0.005, "(0, inf)")
    turn_per_second: float = limited(0.0016, "(0, inf)")
    tilt_time: float = limited(2.0, "(0, inf)")


class WheelLioMapper:
    """Mapper of point clouds with odometry and inertial readings.

    Attributes:
        covariance: (3, 3) of `T_map_base` in the plane, see `Mapper`.
    """

    reads_clouds = reads_inertial = reads_odometry = requires_odometry = True
    lost = False

    def __init__(self, config: WheelLioConfig) -> None:
        c = self.config = config
        self._motion = Motion(c.tilt_time)
        self._map = LocalMap(PlaneMap(c.cell, c.radius), LineMap(c.cell, c.radius))
        self._rule = MatchRule(c.noise, c.edge, c.gate, c.error, c.weak)
        self._key: PlaneMatch | None = None
        self._stamps: list[float] = []
        self._poses: list[Pose3] = []
        self._drift, self._used = DriftCovariance(c.noise), 0
        self.covariance = self._drift.covariance
        self._watch = Stopwatch()

    def update(
        self, cloud: PointCloud, imu: Imu | None, readings: ImuReadings, odometry: Pose2 | None
    ) -> Pose3:
        """Register a sweep; return `T_map_base` at its stamp.

        Raises:
            ConfigError: there is no odometry.
        """
        started = self._watch.start()
        odometry = required_odometry("wheel_lio", odometry, cloud.stamp)
        predicted = self._motion.predict(cloud.stamp, odometry, imu, readings)
        sweep = deskew(cloud, predicted.twist)
        points = self._in_range(sweep)
        origin = cloud.T_base_laser.position
        edges = self._in_range(find_edges(sweep, cloud.ring, origin))
        seen = SweepPoints(thin(points, self.config.thin), edges, origin)
        prior = self._prior(predicted)
        match = register(seen, self._map, prior, self._rule)
        self._motion.correct(match.R, match.t)
        quaternion = Rotation.from_matrix(match.R).as_quat(scalar_first=True)
        pose = Pose3.from_arrays(match.t, quaternion)
        planar = pose.to_pose2()
        if self._poses:
            self._drift.move(self._poses[-1].to_pose2(), planar, prior.planar, predicted.seconds)
            self._drift.match(planar, prior.planar, match.covariance, points)
        self.covariance = self._drift.covariance
        if self._is_key(match):
            self._key = match
            self._drift.add_keyframe(planar, points)
            center = match.R @ origin + match.t
            self._map.planes.insert(points @ match.R.T + match.t, center)
            self._map.lines.insert(edges @ match.R.T + match.t, center)
        self._stamps.append(cloud.stamp)
        self._poses.append(pose)
        self._used += not match.constraint.weak.all()
        self._watch.stop(started)
        return self._poses[0].inverse() @ self._poses[-1]

    def _in_range(self, points: FloatArray) -> FloatArray:
        square = np.einsum("ij,ij->i", points, points)
        kept: FloatArray = points[(square >= self.config.near**2) & (square <= self.config.far**2)]
        return kept

    def _prior(self, predicted: Prediction) -> SpatialPrior:
        """Return the prediction with its standard deviations, which grow with motion and time."""
        c, step, seconds = self.config, predicted.step, max(predicted.seconds, 1e-3)
        shift = (
            c.shift_per_meter**2 * math.hypot(step.x, step.y)
            + c.shift_per_radian**2 * abs(step.yaw)
            + c.shift_per_second**2 * seconds
        )
        sigmas = np.repeat((math.sqrt(shift), c.turn_per_second * math.sqrt(seconds)), 3)
        return SpatialPrior(predicted.R, predicted.t, sigmas)

    def _is_key(self, match: PlaneMatch) -> bool:
        """Return whether the robot has moved far enough for another sweep in the map."""
        if self._key is None:
            return True
        moved = float(np.linalg.norm(match.t - self._key.t))
        turned = Rotation.from_matrix(match.R @ self._key.R.T).magnitude()
        return moved >= self.config.key_shift or bool(turned >= self.config.key_turn)

    def trajectory(self) -> Trajectory:
        """Return the poses of all sweeps; none is corrected later."""
        T_map_level = self._poses[0].inverse() if self._poses else Pose3()
        return Trajectory.from_poses(self._stamps, [T_map_level @ pose for pose in self._poses])

    @property
    def stats(self) -> MapperStats:
        """Sweeps, times and memory."""
        memory = self._map.planes.memory + self._map.lines.memory
        stats = MapperStats(received=len(self._stamps), used=self._used, memory=memory)
        return self._watch.add_to(stats)
