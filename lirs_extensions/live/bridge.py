"""Exchange of a drive with its client, scan by scan."""

from __future__ import annotations

import math
import time
import warnings
from array import array
from dataclasses import replace

import numpy as np

from lirs_envs.robots.robot import Twist
from lirs_envs.sensing.sensors import Observation
from lirs_envs.simulation import Simulation
from lirs_extensions.live.client import Client
from lirs_extensions.live.middleware import Middleware
from lirs_extensions.live.options import LiveOptions
from lirs_validation.config import RunConfig
from lirs_validation.driving.driver import Driver, Frame
from lirs_validation.experiment.cost import Cost
from lirs_validation.experiment.drive import planar
from lirs_validation.experiment.mapper_under_test import Estimate, LocalMapper, SensorReadings
from lirs_validation.experiment.recording import bag_tick
from lirs_wct import ConfigError, LaserScan, OccupancyGrid, Pose2, Pose3, Trajectory
from lirs_wct.formats.rosbag.messages import (
    MAP_TOPIC,
    BagTick,
    SensorErrors,
    TickMessages,
    nanoseconds,
    occupancy_grid,
)
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
        client: state of the client.
        published: scans so far.
        expected: scans of those that need an answer.
        answered: scans answered before the next one was published.
        late: scans answered later.
        delays: wall seconds from each scan to its answer.
        jitter: seconds by which each scan was published too late, without lockstep.
    """

    def __init__(
        self,
        middleware: Middleware,
        options: LiveOptions,
        simulation: Simulation,
        errors: SensorErrors,
        T_map_start: Pose2,
    ) -> None:
        self._middleware, self._options, self._simulation = middleware, options, simulation
        self.client = Client(options, simulation.robot, simulation.period, T_map_start)
        self._messages = TickMessages(simulation.period, errors)
        self._T_map_start = T_map_start
        self._T_map_world: Pose3 | None = None
        self._begun = math.nan
        self._unanswered: dict[int, float] = {}
        self.published = self.expected = self.answered = self.late = 0
        self.delays, self.jitter = array("d"), array("d")

    def exchange(self, observation: Observation, estimate: Pose2 | None = None) -> None:
        """Publish a scan's messages and take in the client's; with lockstep, wait for its answer.

        Args:
            observation: Sensor readings.
            estimate: `T_map_base` of our mapper; None = the client publishes map -> odom.
        """
        stamp = observation.scan.stamp
        if not self._options.lockstep:
            self._keep_pace(stamp)
        self._receive(0.0)
        for topic, _, message in self._messages.of(self._tick(observation, estimate)):
            self._middleware.publish(topic, message)
        self.client.drove(stamp, observation.odometry)
        if self.published % self._options.every == 0:
            self.expected += 1
            self._unanswered[nanoseconds(stamp)] = time.perf_counter()
            if self._options.lockstep:
                self._await(nanoseconds(stamp))
        self.published += 1

    def finish(self) -> None:
        """Take in the last messages."""
        self._receive(0.0)

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
        end = time.perf_counter() + self._options.limit
        while stamp in self._unanswered and not (self.client.reset or self.client.ended):
            left = end - time.perf_counter()
            if left <= 0.0:
                warnings.warn(
                    f"no answer within {self._options.limit:g} s (option limit): scans are skipped",
                    stacklevel=2,
                )
                return
            self._receive(min(left, LOOK))

    def _receive(self, seconds: float) -> None:
        """Take in messages, and count the scans that they answer."""
        received = self._middleware.receive(seconds)
        if not received:
            return
        now, last = time.perf_counter(), next(reversed(self._unanswered), 0)
        stamp = self.client.take(received, self._simulation.time())
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
            self._begun = now - stamp / self._options.rate
        due = self._begun + stamp / self._options.rate
        while (left := due - time.perf_counter()) > 0.0:
            # Sleeping for the whole time would add the clients' late answers to the next scan's.
            self._receive(left)
        self.jitter.append(time.perf_counter() - due)

    def _tick(self, observation: Observation, estimate: Pose2 | None) -> BagTick:
        T_world_base = self._simulation.pose()
        if self._T_map_world is None:
            self._T_map_world = Pose3.from_pose2(self._T_map_start @ T_world_base.to_pose2().inverse())
        return bag_tick(observation, self._T_map_world @ T_world_base, estimate)


class ClientMapper:
    """The client as the mapper of a drive, by its transforms and its /map (see `MapperUnderTest`)."""

    requires_odometry, reads_inertial = False, True

    def __init__(self, bridge: Bridge, name: str, *, reads_clouds: bool, T_start_map: Pose2) -> None:
        self.name, self.reads_clouds = name, reads_clouds
        self._bridge, self._T_start_map = bridge, T_start_map

    def observe(self, observation: Observation | SensorReadings) -> Estimate:
        """Exchange a scan with the client; return its pose estimate."""
        assert isinstance(observation, Observation)
        begun = time.perf_counter()
        self._bridge.exchange(observation)
        pose = Pose3.from_pose2(self._T_start_map) @ self._bridge.client.estimate(observation.odometry)
        seconds = time.perf_counter() - begun
        return Estimate(pose if self.reads_clouds else pose.to_pose2(), False, seconds)

    def map(self) -> OccupancyGrid:
        """Return the client's last map; a single unknown cell if it sent none.

        Raises:
            ConfigError: the lidar has rings.
        """
        if self.reads_clouds:
            raise ConfigError("a client that is given point clouds has no occupancy map")
        grid = self._bridge.client.grid
        if grid is None:
            return OccupancyGrid(np.full((1, 1), np.nan, np.float32), 0.05)
        return grid.moved(self._T_start_map)

    def trajectory(self) -> Trajectory:
        """Return the client's poses at the scans, with its last messages."""
        self._bridge.finish()
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

    @property
    def frame(self) -> Frame:
        """Frame of the poses that the driver gets."""
        return "world" if self._driver is None else self._driver.frame

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
