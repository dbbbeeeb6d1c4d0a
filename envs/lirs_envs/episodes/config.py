"""Options of an environment: plain JSON, except a `World`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from lirs_envs.lidar.noise import NoiseLevel
from lirs_envs.lidar.ray_casting import resolve_rays
from lirs_envs.robots.robot import make_robot
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.sensing.wheel_odometry import Method, OdometryConfig
from lirs_envs.simulation_config import Prop, SimulationConfig
from lirs_envs.tasks.task import Rewards
from lirs_wct import ConfigError, Pose2, World, require_known
from lirs_wct.contact import ContactGeometry
from lirs_wct.errors import Checked, is_finite, limited, of_type

RANDOMIZED: dict[str, tuple[float, float] | None] = {
    "friction": (0.7, 1.3),
    "mass": (0.9, 1.2),
    "sensor": (0.5, 2.0),
    "pushes": (0.1, 0.4),
    "latency": (0.0, 0.1),
    "slip": (0.0, 0.1),
    "start": None,
    "terrain": None,
}
"""Quantities that an episode may randomize, with their default ranges.

Friction, mass and sensor: factors. Pushes: changes of velocity, m/s. Latency: seconds. Slip: share of the
distance.
"""
LARGEST = {"pushes": 2.0, "latency": 1.0, "slip": 1.0}
"""Largest legal values; these may also be 0."""


@dataclass(frozen=True, kw_only=True)
class EnvConfig(Checked, of="the environment"):
    """Options of an environment.

    Attributes:
        world: a bundled name, any other source's path, or a `World`.
        robot: name of the robot.
        terrain: contact geometry (see `SimulationConfig`).
        lidar: name of a lidar preset; None = the robot's own.
        noise: noise of the lidar: `none`, `simulated` or `datasheet`.
        odometry: `gyro` or `ekf` (see `OdometryConfig`).
        sweep: whether scans are rolling (see `SensorNoise.rolling_scan`).
        control_hz: steps a second, 5 to 50; the lidar keeps its own rate, and an observation holds its last
            scan.
        observe: groups of observations (see `lirs_envs.episodes.observations.GROUPS`); None = the task's own.
        randomize: names from `RANDOMIZED`, or a mapping from names to (lowest, highest) value, None = the
            default; None = the task's own. `start`: anywhere free, else the world's first spawn pose;
            `terrain`: a new course in each episode; `sensor`: deviations of the lidar; `pushes`: horizontal
            impulses about every 5 s; `latency`: time until an action takes effect, drawn for each episode;
            `slip`: share by which the odometry's distance is too long, drawn about every 5 s.
        rays: ray caster: `builtin` or `mujoco` (see `SimulationConfig`).
        props: bodies in the world: each a `Prop`, or a mapping of its fields with `place` as x, y, yaw.
        actors: number of walkers (see `lirs_envs.walkers`).
        difficulty: 0 to 1, for tasks with a difficulty.
        time_limit: seconds until an episode is truncated; None = the task's own.
        rewards: weights that differ from the defaults, by name (see `lirs_envs.tasks.task.Rewards`).

    Raises:
        ConfigError: a value is not legal.
    """

    world: str | World = "medium"
    robot: str = "husky"
    terrain: ContactGeometry = "hfield"
    lidar: str | None = None
    noise: NoiseLevel = "simulated"
    odometry: Method = "gyro"
    sweep: bool = False
    control_hz: float = limited(10.0, "[5, 50]", "Hz")
    observe: Sequence[str] | None = None
    randomize: Sequence[str] | Mapping[str, Sequence[float] | None] | None = None
    rays: str = "builtin"
    props: Sequence[Prop | Mapping[str, Any]] = ()
    actors: int = 0
    difficulty: float = limited(0.5, "[0, 1]")
    time_limit: float | None = limited(None, "(0, inf)", "s")
    rewards: Mapping[str, float] = field(default_factory=dict)
    simulation: SimulationConfig = field(init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        of_type(World | str)(self.world, "world of the environment")
        noise = SensorNoise(
            odometry=OdometryConfig(method=self.odometry), lidar=self.noise, rolling_scan=self.sweep
        )
        robot = make_robot(self.robot)
        if robot.flies:  # Speeds that suit worlds of about 50 m, whatever the command.
            robot = replace(robot, max_speed=3.0, max_acceleration=3.0, max_turn_rate=1.5)
        config = SimulationConfig(
            robot=robot,
            lidar=self.lidar,
            noise=noise,
            rays=resolve_rays(self.rays),
            contact_geometry=self.terrain,
            props=[_prop(given) for given in self.props],
            actors=self.actors,
        )
        object.__setattr__(self, "simulation", config)
        _ = self.factors, self.weights

    @property
    def weights(self) -> Rewards:
        """Weights of the rewards."""
        if not isinstance(self.rewards, Mapping):
            raise ConfigError(f"rewards must be a mapping of names to weights, got {self.rewards!r}")
        names = [weight.name for weight in fields(Rewards)]
        for name in self.rewards:
            require_known("reward", name, names)
        return Rewards(**self.rewards)

    @property
    def factors(self) -> dict[str, tuple[float, float] | None] | None:
        """Randomized quantities with their ranges; None = the task's own."""
        if self.randomize is None:
            return None
        if isinstance(self.randomize, str):
            raise ConfigError(f"randomize must be a list or a mapping of names, got {self.randomize!r}")
        ranges: Mapping[str, Any]
        ranges = self.randomize if isinstance(self.randomize, Mapping) else dict.fromkeys(self.randomize)
        for name in ranges:
            require_known("name to randomize", name, RANDOMIZED)
        return {name: RANDOMIZED[name] if r is None else _range(name, r) for name, r in ranges.items()}


def _prop(given: Any) -> Prop:
    """Return a prop from a mapping of its fields."""
    if isinstance(given, Prop):
        return given
    try:
        fields = dict(given)
        size, place = tuple(map(float, fields["size"])), Pose2(*map(float, fields["place"]))
        shape, mass = fields["shape"], float(fields.get("mass", 0.0))
    except (TypeError, ValueError, KeyError):
        fields = {}
    if not fields or fields.keys() - {"shape", "size", "place", "mass"}:
        raise ConfigError(
            f"a prop must be a mapping of shape, size, place (x, y, yaw) and perhaps mass, got {given!r}"
        )
    return Prop(shape=shape, size=size, place=place, mass=mass)


def _range(name: str, factors: Any) -> tuple[float, float]:
    if RANDOMIZED[name] is None:
        raise ConfigError(f"randomize {name!r} takes no factors, got {factors!r}")
    try:
        low, high = factors
    except (TypeError, ValueError):
        raise ConfigError(f"randomize {name!r} needs (lowest, highest), got {factors!r}") from None
    if not (is_finite(low) and is_finite(high) and low <= high):
        raise ConfigError(f"randomize {name!r} needs lowest <= highest, finite, got {factors!r}")
    if name in LARGEST and not (low >= 0 and high <= LARGEST[name]):
        raise ConfigError(f"randomize {name!r} needs values from 0 to {LARGEST[name]:g}, got {factors!r}")
    if name not in LARGEST and low <= 0:
        raise ConfigError(f"randomize {name!r} needs factors above 0, got {factors!r}")
    return float(low), float(high)
