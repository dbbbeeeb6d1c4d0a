"""Configuration of a simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lirs_envs.lidar.presets import LidarPreset, make_lidar_preset
from lirs_envs.lidar.ray_casting import Rays, resolve_rays
from lirs_envs.placement import check_start
from lirs_envs.props import Prop, StaticRobot
from lirs_envs.robots.robot import Robot
from lirs_envs.sensing.imu import InertialNoise
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.walkers import TOUCHABLE
from lirs_wct import ConfigError, Pose2
from lirs_wct.contact import CONTACT_GEOMETRIES, ContactGeometry
from lirs_wct.errors import Checked, check_field, is_finite, limited, of_type, one_of


@dataclass(frozen=True, kw_only=True)
class SimulationConfig(Checked):
    """Configuration of a simulation: robot, sensors, props and walkers.

    Attributes:
        lidar: name of a lidar preset; None = the robot's own.
        noise: errors of all sensors.
        rays: Caster of the rays: `builtin`, or `mujoco` for comparison, whose rays meet its
            hfield, or with contact geometry `mesh` those of its mesh.
        contact_geometry: contact ground in MuJoCo: `hfield`, `mesh` (the same, and its rays meet the mesh),
            `prisms` or `convex`.
        props: bodies and static robots that stand in the world; touched, and seen by the lidar.
        actors: number of walkers on seeded paths (see `lirs_envs.walkers`); touched, and seen by the
            lidar.
        start: pose where a reset sets the robot down; None = the world's first start pose.
        height_range: lowest and highest height that `replace_terrain` may write, meters; wheels
            then touch the surface itself, node by node. None = the ground stays.
        inertial: noise of inertial readings near 200 Hz, which observations then hold; None = none.

    Raises:
        ConfigError: a value is of the wrong type or not legal.
    """

    robot: Robot = check_field(of_type(Robot))
    lidar: str | None = None
    noise: SensorNoise = check_field(of_type(SensorNoise), default_factory=SensorNoise)
    rays: Rays = "builtin"
    contact_geometry: ContactGeometry = check_field(one_of(CONTACT_GEOMETRIES), default="hfield")
    props: Sequence[Prop | StaticRobot] = ()
    actors: int = limited(0, "[0, inf)", whole=True)
    start: Pose2 | None = None
    height_range: tuple[float, float] | None = None
    inertial: InertialNoise | None = check_field(of_type(InertialNoise), default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "rays", resolve_rays(self.rays))
        object.__setattr__(self, "props", tuple(self.props))
        for prop in self.props:
            if not isinstance(prop, Prop | StaticRobot):
                raise ConfigError(f"props must be Prop or StaticRobot, got {prop!r}")
        if self.start is not None:
            check_start(self.start)
        self._check_height_range()
        make_lidar_preset(self.preset_name)

    def _check_height_range(self) -> None:
        if self.height_range is None:
            return
        if len(self.height_range) != 2 or not all(is_finite(z) for z in self.height_range):
            raise ConfigError(f"height_range must be two finite heights in meters, got {self.height_range!r}")
        if not self.height_range[0] < self.height_range[1]:
            raise ConfigError(f"height_range must be lowest, highest, got {self.height_range!r}")
        if self.contact_geometry != "hfield":
            raise ConfigError(
                f"a terrain can be replaced with contact geometry hfield alone, got {self.contact_geometry}"
            )

    @property
    def walker_bodies(self) -> int:
        """Number of walkers with a MuJoCo body; with MuJoCo's rays, all of them."""
        return self.actors if self.rays == "mujoco" else min(self.actors, TOUCHABLE)

    @property
    def preset_name(self) -> str:
        """Name of the lidar preset."""
        return self.robot.lidar if self.lidar is None else self.lidar

    @property
    def preset(self) -> LidarPreset:
        """Specification of the lidar."""
        return make_lidar_preset(self.preset_name)
