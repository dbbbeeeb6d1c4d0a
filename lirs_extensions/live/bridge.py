"""Exchange of a drive with its client, scan by scan."""

from __future__ import annotations

import itertools
import math
import time
import warnings
from array import array
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lirs_envs.robots.robot import Robot, Twist
from lirs_envs.sensing.sensors import Observation
from lirs_envs.simulation import Simulation
from lirs_extensions.live.graph import (
    MAP_TYPE,
    POSE,
    POSE_TYPE,
    TRANSFORMS_TYPE,
    TWIST,
    TWIST_STAMPED,
    Middleware,
    Received,
    typestore,
)
from lirs_extensions.live.options import LiveOptions
from lirs_validation.config import RunConfig
from lirs_validation.driving.path_driver import Frame
from lirs_validation.experiment.drive import Driver, planar
from lirs_validation.experiment.mapper_under_test import Estimate, LocalMapper, SensorReadings
from lirs_validation.experiment.run import bag_tick
from lirs_validation.processes import Cost
from lirs_wct import (
    ConfigError,
    FloatArray,
    LaserScan,
    OccupancyGrid,
    Pose2,
    Pose3,
    Trajectory,
    covariance_fault,
    in_axes_of,
)
from lirs_wct.formats.rosbag import frames, messages
from lirs_wct.formats.rosbag.messages import SensorErrors, TickMessages, nanoseconds, occupancy_grid
from lirs_wct.formats.rosbag.topics import MAP_TOPIC
from slam_baselines.mapper import CloudMapper, Mapper, MapperStats

MAP_PERIOD = 2.0
"""Simulated seconds between two maps of our mapper."""
LOOK = 0.5
"""Seconds between two looks whether the user ended the drive."""
NO_ANSWER = "no answer within the limit"


class Bridge:
    """Exchange of one drive with a client.

    With `lockstep`, simulated time waits for the answer to a scan; messages then depend on the client's
    commands alone, not on its speed. Otherwise scans are published at the rate of the clock.

    Attributes:
        published: Number of scans so far.
        expected: Number of those that need an answer.
        answered: Number of scans answered before the next one was published.
        late: Number of scans answered later.
        delays: Wall seconds from each scan to its answer.
        jitter: Seconds by which each scan was published too late, without lockstep.
    """

    def __init__(
        self,
        middleware: Middleware,
        options: LiveOptions,
        simulation: Simulation,
        errors: SensorErrors,
        T_map_start: Pose2,
    ) -> None:
        self._middleware, self.options, self.simulation = middleware, options, simulation
        self.client = Client(options, simulation.robot, simulation.period, T_map_start)
        self._messages = TickMessages(simulation.period, errors)
        self.T_map_start = T_map_start
        self._T_map_world: Pose3 | None = None
        self._begun = math.nan
        self._unanswered: dict[int, float] = {}
        self.published = self.expected = self.answered = self.late = 0
        self.delays, self.jitter = array("d"), array("d")

    def exchange(self, observation: Observation, estimate: Pose2 | None = None) -> None:
        """Publish a scan's messages and take in the client's; with lockstep, wait for its answer.

        `estimate` is `T_map_base` of our mapper; None = the client publishes map -> odom.
        """
        stamp = observation.scan.stamp
        if not self.options.lockstep:
            self._keep_pace(stamp)
        self.receive()
        T_world_base = self.simulation.pose()
        if self._T_map_world is None:
            self._T_map_world = Pose3.from_pose2(self.T_map_start @ T_world_base.to_pose2().inverse())
        tick = bag_tick(observation, self._T_map_world @ T_world_base, estimate)
        for topic, _, message in self._messages.of(tick):
            self._middleware.publish(topic, message)
        self.client.drove(stamp, observation.odometry)
        if self.published % self.options.every == 0:
            self.expected += 1
            self._unanswered[nanoseconds(stamp)] = time.perf_counter()
            if self.options.lockstep:
                self._await(nanoseconds(stamp))
        self.published += 1

    def publish_map(self, stamp: float, grid: OccupancyGrid) -> None:
        """Publish our mapper's map, in the map frame."""
        self._middleware.publish(MAP_TOPIC, occupancy_grid(stamp, grid))

    @property
    def missed(self) -> int:
        """Number of scans without the answer that they need."""
        return self.expected - self.answered - self.late

    @property
    def stats(self) -> MapperStats:
        """Scans and answers of the client in the terms of a mapper."""
        ms = 1e3 * np.array(self.delays if self.delays else [0.0])
        return MapperStats(
            received=self.published,
            used=self.answered + self.late,
            skipped={NO_ANSWER: self.missed} if self.missed else {},
            ms_p50=float(np.median(ms)),
            ms_p95=float(np.percentile(ms, 95)),
            ms_max=float(ms.max()),
            counts={"late answers": self.late, "messages of the client": self.client.messages},
        )

    def _await(self, stamp: int) -> None:
        """Wait until a scan is answered, at most the limit."""
        end = time.perf_counter() + self.options.limit
        while stamp in self._unanswered and not (self.client.reset or self.client.ended):
            left = end - time.perf_counter()
            if left <= 0.0:
                warnings.warn(
                    f"no answer within {self.options.limit:g} s (option limit): scans are skipped",
                    stacklevel=2,
                )
                return
            self.receive(min(left, LOOK))

    def receive(self, seconds: float = 0.0) -> None:
        """Take in messages, and count the scans that they answer."""
        received = self._middleware.receive(seconds)
        if not received:
            return
        now, last = time.perf_counter(), next(reversed(self._unanswered), 0)
        stamp = self.client.take(received, self.simulation.time())
        if not stamp:
            return
        for scan in [scan for scan in self._unanswered if scan <= stamp]:
            self.delays.append(now - self._unanswered.pop(scan))
            if scan == last:
                self.answered += 1
            else:
                self.late += 1

    def _keep_pace(self, stamp: float) -> None:
        """Wait for the wall time of a scan, and take in messages meanwhile."""
        now = time.perf_counter()
        if math.isnan(self._begun):
            self._begun = now - stamp / self.options.rate
        due = self._begun + stamp / self.options.rate
        while (left := due - time.perf_counter()) > 0.0:
            # Sleeping for the whole time would add the clients' late answers to the next scan's.
            self.receive(left)
        self.jitter.append(time.perf_counter() - due)


class ClientMapper:
    """The client as mapper of a drive, by its transforms and /map (see `MapperUnderTest`)."""

    requires_odometry, reads_inertial = False, True

    def __init__(self, bridge: Bridge, name: str) -> None:
        self.name, self.reads_clouds = name, bridge.simulation.preset.rings > 1
        self._bridge, self._T_start_map = bridge, bridge.T_map_start.inverse()

    def observe(self, observation: Observation | SensorReadings) -> Estimate:
        """Exchange a scan with the client; return its pose estimate."""
        assert isinstance(observation, Observation)
        begun = time.perf_counter()
        self._bridge.exchange(observation)
        pose = Pose3.from_pose2(self._T_start_map) @ self._bridge.client.estimate(observation.odometry)
        seconds, covariance = time.perf_counter() - begun, self._bridge.client.covariance
        if covariance is not None:
            covariance = in_axes_of(self._bridge.T_map_start, covariance)
        return Estimate(pose if self.reads_clouds else pose.to_pose2(), False, seconds, covariance)

    def map(self) -> OccupancyGrid:
        """Return the client's last map; a single unknown cell if it sent none."""
        if self.reads_clouds:
            raise ConfigError("a client that is given point clouds has no occupancy map")
        grid = self._bridge.client.grid
        if grid is None:
            return OccupancyGrid(np.full((1, 1), np.nan, np.float32), 0.05)
        return grid.moved(self._T_start_map)

    def trajectory(self) -> Trajectory:
        """Return the client's poses at the scans, with its last messages."""
        self._bridge.receive()
        return self._bridge.client.trajectory().moved(self._T_start_map)

    @property
    def stats(self) -> MapperStats:
        """Scans and answers of the client."""
        return self._bridge.stats

    def cost(self) -> Cost:
        """Return nothing: the client's cost is unknown."""
        return Cost(0.0, 0)

    def close(self) -> None:
        """Do nothing: the client is not ours."""


class PublishedMapper(LocalMapper):
    """One of our mappers, whose frame `map` and map the client gets."""

    def __init__(self, bridge: Bridge, mapper: Mapper | CloudMapper, config: RunConfig) -> None:
        super().__init__(mapper, config.mapper, config.attitude)
        self._bridge, self._next_map = bridge, 0.0

    def observe(self, observation: Observation | SensorReadings) -> Estimate:
        """Map a scan, then exchange it with the client."""
        assert isinstance(observation, Observation)
        estimate = super().observe(observation)
        stamp = observation.scan.stamp
        if stamp >= self._next_map:
            self._bridge.publish_map(stamp, self.map())
            self._next_map = stamp + MAP_PERIOD
        self._bridge.exchange(observation, planar(estimate.pose))
        return estimate

    @property
    def stats(self) -> MapperStats:
        """Statistics of our mapper, and the client's answers among its counts."""
        client, ours = self._bridge.stats, super().stats
        answers = {"scans answered": client.used, **client.counts}
        return replace(ours, counts={**ours.counts, **answers})


class ClientDriver:
    """Driver that follows /cmd_vel, or one of ours.

    A client that asks for a new start ends the drive.
    """

    def __init__(self, start: Pose2, client: Client, driver: Driver | None) -> None:
        self.start, self._client, self._driver = start, client, driver
        self.frame: Frame = "world" if driver is None else driver.frame

    @property
    def stuck(self) -> bool:
        """Whether our driver gave up."""
        return self._driver is not None and self._driver.stuck

    @property
    def finished(self) -> str:
        """Reason for the end of the drive; empty before the end."""
        if self._client.ended:
            return "ended by Ctrl-C"
        if self._client.reset:
            return "the client asked for a new start"
        return "" if self._driver is None else self._driver.finished

    def command(self, pose: Pose2, time: float, scan: LaserScan, odometry: Pose2) -> Twist:
        """Return the command for the next tick."""
        if self._driver is None:
            return self._client.command(time)
        return self._driver.command(pose, time, scan, odometry)


STOPPED_AFTER = 0.5
"""Simulated seconds after which a robot without new commands stops, as ros2_control's diff drive does."""


class Client:
    """Receiver of a client's messages.

    Damaged messages are ignored with one warning per topic.

    Attributes:
        grid: last map, in the client's map frame; None = none.
        covariance: (3, 3) of x, y, yaw on the last /pose, in the axes of the client's map frame.
        start: pose of a requested new start in the client's map frame; None = no new pose was requested.
        reset: whether a new start was requested.
        ended: whether the user ended the drive.

    Args:
        period: from scan to scan, seconds.
        T_map_start: start pose in the client's map frame; the odometry begins there.
    """

    def __init__(self, options: LiveOptions, robot: Robot, period: float, T_map_start: Pose2) -> None:
        self._store: Any = typestore(options.ros)
        self._answer, self._robot = options.answer, robot
        self._patience = max(STOPPED_AFTER, 2 * options.every * period)
        self._command, self._commanded = Twist(), -math.inf
        self._frames, self._lines = frames.Frames(), itertools.count(1)
        self._T_map_start, self._maps = T_map_start, False
        self._T_map_odom = Pose3.from_pose2(T_map_start)
        self._warned: set[str] = set()
        self.grid: OccupancyGrid | None = None
        self.start: Pose2 | None = None
        self.covariance: FloatArray | None = None
        self.reset, self.ended, self.messages = False, False, 0

    def take(self, received: Sequence[Received], time: float) -> int:
        """Take in messages; return the latest stamp that answers a scan, nanoseconds; 0 = none.

        The messages are in order of arrival; `time` is the present simulated time, seconds.
        """
        answered = 0
        for topic, cdr in received:
            self.messages += 1
            try:
                message = self._store.deserialize_cdr(cdr, topic.kind)
                if topic.name == POSE:
                    self._take_covariance(message)
                else:
                    answered = max(answered, self._take(topic.kind, message, time))
            except Exception as error:  # of any kind: the bytes are another program's
                if topic.name not in self._warned:
                    self._warned.add(topic.name)
                    warnings.warn(f"{topic.name}: a message is damaged and ignored: {error}", stacklevel=2)
        return answered

    def command(self, time: float) -> Twist:
        """Return the robot's command; it stops where the last one is too old."""
        return self._command if time - self._commanded <= self._patience else Twist()

    def estimate(self, T_odom_base: Pose2) -> Pose3:
        """Return `T_map_base` by the latest transform map -> odom; without one, the odometry."""
        return self._T_map_odom @ Pose3.from_pose2(T_odom_base)

    def drove(self, stamp: float, T_odom_base: Pose2) -> None:
        """Note the odometry at a scan, for the trajectory."""
        message = messages.transforms(stamp, messages.DRIVEN, (Pose3.from_pose2(T_odom_base),))
        self._frames.add(
            next(self._lines), self._store.deserialize_cdr(message, TRANSFORMS_TYPE), static=False
        )

    def trajectory(self) -> Trajectory:
        """Return `T_map_base` at the stamps of scans, of transforms interpolated as in tf2.

        Without map -> odom, return the odometry.
        """
        found = self._frames.trajectory(messages.BASE)
        return found if self._maps else found.moved(self._T_map_start)

    def _take(self, kind: str, message: Any, time: float) -> int:
        if kind in (TWIST, TWIST_STAMPED):
            twist = message.twist if kind == TWIST_STAMPED else message
            self._command, self._commanded = self._legal(twist), time
            stamped = kind == TWIST_STAMPED and self._answer != "tf"
            return _nanoseconds(message.header.stamp) if stamped else 0
        if kind == TRANSFORMS_TYPE:
            return self._take_frames(message)
        if kind == MAP_TYPE:
            self.grid = read_grid(message)
            return 0
        if kind == POSE_TYPE:
            self.start = frames.pose_of(message.pose.pose.position, message.pose.pose.orientation).to_pose2()
        self.reset = True
        return 0

    def _take_covariance(self, message: Any) -> None:
        given = frames.planar_covariance(message.pose)
        unknown = np.isnan(given).all()
        if not unknown and (fault := covariance_fault(given)):
            raise ConfigError(fault)
        self.covariance = None if unknown else given

    def _take_frames(self, message: Any) -> int:
        answered = 0
        for t in message.transforms:
            if (t.header.frame_id.lstrip("/"), t.child_frame_id.lstrip("/")) != (messages.MAP, messages.ODOM):
                continue
            T = frames.pose_of(t.transform.translation, t.transform.rotation)
            if not frames.is_finite(T):
                raise ConfigError("map -> odom is not finite")
            self._T_map_odom, self._maps = T, True
            if self._answer != "cmd_vel":
                answered = _nanoseconds(t.header.stamp)
            self._frames.add(next(self._lines), type(message)([t]), static=False)
        return answered

    def _legal(self, twist: Any) -> Twist:
        """Return a finite command within the robot's limits."""
        v, omega, climb = twist.linear.x, twist.angular.z, twist.linear.z
        if not all(map(math.isfinite, (v, omega, climb))):
            raise ConfigError("the command is not finite")
        most, turn = self._robot.max_speed, self._robot.max_turn_rate
        flown = float(climb) if self._robot.flies else 0.0
        return Twist(float(np.clip(v, -most, most)), float(np.clip(omega, -turn, turn)), flown)


def read_grid(message: Any) -> OccupancyGrid:
    """Return the grid of a `nav_msgs/OccupancyGrid`: -1 unknown, 0 to 100 percent occupied."""
    info = message.info
    if info.width * info.height != len(message.data):
        raise ConfigError(f"{info.width} x {info.height} cells, but {len(message.data)} values")
    cells = np.asarray(message.data, np.int8).reshape(info.height, info.width)
    p = np.where(cells < 0, np.nan, cells / 100.0)
    origin = frames.pose_of(info.origin.position, info.origin.orientation).to_pose2()
    return OccupancyGrid.from_probability(p, float(info.resolution), origin)


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
