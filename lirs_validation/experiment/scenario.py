"""Scenario of a run: its config and its world, and the simulation of a robot in it."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace

from lirs_envs.lidar.ray_casting import resolve_rays
from lirs_envs.robots.robot import Robot
from lirs_envs.sensing.imu import InertialNoise
from lirs_envs.sensing.sensors import SensorNoise, resolve_noise
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_validation.config import RunConfig
from lirs_validation.record.run_record import source_files
from lirs_wct import BuildOptions, Pose2, World, build_world
from lirs_wct.errors import LogSourceError
from lirs_wct.ground import Window

MAX_WORLDS = 2
"""Worlds that a cache holds at a time; memory stays flat over a long sweep."""
LARGE_SIDE, DRIVEN_SIDE = 200.0, 50.0
"""Side from which a terrain is driven on a square only, and the side of that square, meters."""


@dataclass(frozen=True)
class Scenario:
    """A config and its world.

    Attributes:
        window: Square that was cut out of a larger world, if any.
        files: Path and digest of each file of the world's source; none of a bundled world.
        whole_size: Size of the world that the window was cut out of, eastward and northward, meters.
    """

    config: RunConfig
    world: World
    window: Window | None
    files: tuple[dict[str, str], ...] = ()
    whole_size: tuple[float, float] | None = None

    def simulation(self, robot: Robot, *, inertial: bool = False) -> Simulation:
        """Put the robot into the world, with inertial readings near 200 Hz on request."""
        c = self.config
        rolling = None if c.scan_time is None else c.scan_time == "rolling"
        config = SimulationConfig(
            robot=robot,
            lidar=c.lidar,
            contact_geometry=c.terrain,
            rays=resolve_rays(c.rays),
            actors=c.actors,
            noise=replace(sensor_noise(c), rolling_scan=rolling),
            inertial=InertialNoise() if inertial else None,
        )
        return Simulation(self.world, config, seed=c.seed)


def sensor_noise(config: RunConfig) -> SensorNoise:
    """Return the noise of a run's sensors."""
    return resolve_noise(config.noise).with_odometry_noise(config.odometry_noise)


def build_scenario(config: RunConfig) -> Scenario:
    """Build the config's world.

    Of a terrain larger than 200 m, a window of 50 m is used, in the middle or around the start.
    """
    try:
        files, world = source_files(config), build_world(config.source, config.build)
    except LogSourceError as error:
        raise LogSourceError(
            f"{error}: lirs-wct build does both, and so does lirs_validation.resolve_source"
        ) from None
    if not is_large(world) or config.build.window is not None:
        return Scenario(config, world, config.build.window, files)
    west, south, east, north = world.surface.bounds
    middle = world.start or Pose2((west + east) / 2, (south + north) / 2)
    window = (middle.x, middle.y, DRIVEN_SIDE)
    cut = build_world(config.source, replace(config.build, window=window))
    return Scenario(config, cut, window, files, world.surface.size)


def is_large(world: World) -> bool:
    """Whether a run takes a window of a terrain only."""
    return world.kind != "map" and not world.overhangs and max(world.surface.size) > LARGE_SIDE


class ScenarioCache:
    """Gives configs their scenarios, and keeps the last worlds for the next configs in them."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[str, BuildOptions], Scenario] = OrderedDict()

    def scenario(self, config: RunConfig) -> Scenario:
        """Return the config's scenario (see `build_scenario`)."""
        key = (config.source, config.build)
        if key not in self._kept:
            self.put(build_scenario(config))
        self._kept.move_to_end(key)
        return replace(self._kept[key], config=config)

    def put(self, scenario: Scenario) -> None:
        """Keep a scenario that was built elsewhere."""
        self._kept[(scenario.config.source, scenario.config.build)] = scenario
        while len(self._kept) > MAX_WORLDS:
            self._kept.popitem(last=False)

    def clear(self) -> None:
        """Forget the worlds: files that they were made of have changed."""
        self._kept.clear()
