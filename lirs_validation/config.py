"""What can be asked for: a run of a robot through a world, a map of a log."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from lirs_wct.errors import ConfigError, unknown_name
from lirs_wct.field_validators import require_above, require_at_least, require_within
from lirs_wct.formats.rosbag.library import STORAGES, Storage
from lirs_wct.option import option
from lirs_wct.sources.options import MAP_PANEL, BuildOptions
from lirs_wct.sources.source_kind import SourceKind

if TYPE_CHECKING:
    from lirs_wct.contact.contact_geometry import ContactGeometry

Attitude = Literal["imu", "none"]
ATTITUDES: tuple[Attitude, ...] = get_args(Attitude)
"""What a mapper is told of roll and pitch: the IMU's readings, or nothing."""
TOUR, FRONTIER = "tour", "frontier"
DRIVERS = {TOUR: "", FRONTIER: "", "waypoints": "FILE", "replay": "RUN"}
"""Who drives, and what each needs: a file of waypoints, the folder of a finished run."""
THREADS = (1, 2)
"""Of a drive: one, or one for the simulation and one for the mapper."""
MANUAL = "manual"
"""What records say where a person drove in the live page; such a drive is repeated as `replay:RUN`."""
LATER: dict[str, Any] = {"attitude": "imu", "driver": TOUR, "actors": 0, "threads": 1}
"""Options of a run that came later: with these values they are in no digest, and folders keep their names."""
LATER_OF_BUILDS: dict[str, Any] = {
    "start": None,
    "zero": None,
    "nodata": None,
    "encoding": "gray",
    "cloud_surface": "ground",
    "ground_slope": None,
    "drape": False,
    "wall_texture": None,
}
"""The same of how a source becomes a world."""
OUTSIDE_DIGEST = ("wall_limit", "bag", "sensors_only")
"""Options of a run that say nothing of what is tried: how long one waits, and what is recorded."""
LATER_OF_MAPS: dict[str, Any] = {"attitude": "imu", "scan_topic": None, "odom_topic": None, "imu_topic": None}
"""The same of a log that is mapped."""
RECORDED_RAYS = {"builtin": "ours", "mujoco": "mujoco"}
"""Rays as records name them."""


@dataclass(frozen=True, kw_only=True)
class SourceOptions(BuildOptions):
    """How a source becomes a world, a laser log included, which is mapped first."""

    log_mapper: str = option(
        "cartographer",
        "SLAM method that makes the map of a laser log.",
        flags=("--log-mapper", "--mapper"),
        metavar="NAME|module:Class",
        panel=MAP_PANEL,
        kinds={SourceKind.LOG},
    )

    @classmethod
    def of(cls, options: BuildOptions) -> SourceOptions:
        """Return options that say nothing of logs with the default for them; others as they are."""
        if isinstance(options, SourceOptions):
            return options
        return cls(**{entry.name: getattr(options, entry.name) for entry in fields(options)})


def driver_parts(text: str) -> tuple[str, str]:
    """Return kind and path of a driver: `tour`, `frontier`, `waypoints:FILE`, `replay:RUN` or `manual`.

    Raises:
        ConfigError: it is none of these.
    """
    if text == MANUAL:
        return MANUAL, ""
    kind, colon, path = text.partition(":")
    if kind not in DRIVERS or bool(DRIVERS[kind]) != bool(path) or (colon and not path):
        legal = ", ".join(f"{name}:{what}" if what else name for name, what in DRIVERS.items())
        raise ConfigError(f"unknown driver {text!r}; legal: {legal}")
    return kind, path


def check_threads(threads: int, driver: str) -> None:
    """Tell whether a kind of driver can drive with so many threads.

    Raises:
        ConfigError: there are not 1 or 2, or the driver waits for the mapper.
    """
    if threads not in THREADS:
        raise ConfigError(f"threads must be 1 or 2 (the mapper beside the drive), got {threads}")
    if threads > 1 and driver == FRONTIER:
        raise ConfigError(
            f"driver {driver} waits for the mapper's map and pose: it drives with --threads 1, got {threads}"
        )


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """What to run.

    Attributes:
        source: a bundled world's name, a built folder, a picture or a map YAML.
        robot: name of a robot.
        mapper: name of a mapper, or `module:name` of your own.
        lidar: name of a lidar preset; None = the robot's own.
        terrain: what MuJoCo touches.
        rays: whose rays the lidar takes: `builtin`, which records name `ours`, or `mujoco` for comparison.
        seconds: simulated time to drive.
        seed: of every random number in the run.
        wall_limit: wall seconds after which the drive is stopped; None = never.
        attitude: what the mapper is told of roll and pitch: `imu`, or `none` (no inertial reading).
        driver: who drives: `tour`, `frontier`, `waypoints:FILE` or `replay:RUN` (docs/sweeps.md).
        actors: number of walkers in the world.
        bag: how the drive is recorded as a ROS 2 bag: `mcap` or `sqlite3`; None = it is not.
        sensors_only: whether the bag leaves out what the mapper makes: map -> odom and /map.
        threads: of the drive: 1, or 2, where the mapper works beside the simulation; results but times are
            the same.
        build: how the source becomes a world.

    Raises:
        ConfigError: seconds or the wall limit is not above 0, seed or actors is negative, there is no such
            terrain, rays, attitude, driver or storage, or the driver waits for the mapper and is to drive
            with two threads.
    """

    source: str
    robot: str = "husky"
    mapper: str = "hector"
    lidar: str | None = None
    terrain: ContactGeometry = "hfield"
    rays: str = "ours"
    seconds: float = 120.0
    seed: int = 1
    wall_limit: float | None = None
    attitude: Attitude = "imu"
    driver: str = TOUR
    actors: int = 0
    bag: Storage | None = None
    sensors_only: bool = False
    threads: int = 1
    build: BuildOptions = field(default_factory=SourceOptions)

    def __post_init__(self) -> None:
        # The names belong to the simulator, which who maps a log does not load.
        from lirs_envs.lidar.casters import resolve_rays
        from lirs_wct.contact.contact_geometry import CONTACT_GEOMETRIES

        object.__setattr__(self, "build", SourceOptions.of(self.build))
        require_above(self, 0, "seconds", finite=True)
        if self.wall_limit is not None:
            require_above(self, 0, "wall_limit", unit="s")
        require_at_least(self, 0, "seed", "actors")
        if self.terrain not in CONTACT_GEOMETRIES:
            raise unknown_name("terrain for MuJoCo", self.terrain, CONTACT_GEOMETRIES)
        if self.attitude not in ATTITUDES:
            raise unknown_name("attitude", self.attitude, ATTITUDES)
        check_threads(self.threads, driver_parts(self.driver)[0])
        if self.bag is not None and self.bag not in STORAGES:
            raise unknown_name("storage of a bag", self.bag, STORAGES)
        object.__setattr__(self, "rays", RECORDED_RAYS[resolve_rays(self.rays)])

    @property
    def digest(self) -> str:
        """Eight hex digits that distinguish this experiment from others.

        What says nothing of what is tried is left out (`OUTSIDE_DIGEST`).
        """
        entry = asdict(self) | {"seconds": float(self.seconds)}
        for name in OUTSIDE_DIGEST:
            del entry[name]
        entry = _without(LATER, entry) | {"build": _without(LATER_OF_BUILDS, entry["build"])}
        text = json.dumps(entry, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:8]


def _sha256(content: bytes | Path) -> str:
    """Return the digest of bytes, or of a file, which may be larger than the memory."""
    if isinstance(content, bytes):
        return hashlib.sha256(content).hexdigest()
    with content.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _without(later: dict[str, Any], entry: dict[str, Any]) -> dict[str, Any]:
    """Return a config's fields without those that came later and are as they would be without."""
    return {key: value for key, value in entry.items() if key not in later or value != later[key]}


def run_name(config: RunConfig, world: str) -> str:
    """Return the name of the run's folder; of `module:name` only the name, of a driver only the kind."""
    mapper = config.mapper.rpartition(":")[2]
    driver = "" if config.driver == TOUR else f"-{driver_parts(config.driver)[0]}"
    return f"{world}-{config.robot}-{mapper}{driver}-s{config.seed}-{config.digest}"


@dataclass(frozen=True, kw_only=True)
class MapConfig:
    """How a log is mapped.

    Attributes:
        log: path of a CARMEN log.
        mapper: name of a mapper, or `module:name` of your own.
        seed: of its random numbers.
        particles: of gmapping; None = its own number.
        resolution: edge of a cell, metres, 0.01 to 1: finer ones fill the memory, coarser ones hold no room;
            None = the mapper's own.
        fov: field of view of the laser, degrees; None = as the log says.
        range_max: ranges from here on are no return, metres; None = as the log says.
        relations: path of relative-pose constraints that are known to be true.
        reference: path of a reference trajectory: TUM, a bag, or a CARMEN log of corrected poses.
        imu: path of inertial readings, as a run records them (`imu.csv.gz`); None = the log has none.
        attitude: what the mapper is told of them: `imu`, or `none`.
        scan_topic: of a bag: where the scans are; None = the only topic of scans.
        odom_topic: of a bag: where the odometry is; None = the only topic of odometry, else /tf.
        imu_topic: of a bag: where inertial readings are; None = they are left alone.
        reference_topic: of a reference that is a bag: where its poses are; None = /tf, else the only topic.

    Raises:
        ConfigError: a value is not legal.
    """

    log: str
    mapper: str = "cartographer"
    seed: int = 1
    particles: int | None = None
    resolution: float | None = None
    fov: float | None = None
    range_max: float | None = None
    relations: str | None = None
    reference: str | None = None
    imu: str | None = None
    attitude: Attitude = "imu"
    scan_topic: str | None = None
    odom_topic: str | None = None
    imu_topic: str | None = None
    reference_topic: str | None = None

    def __post_init__(self) -> None:
        require_at_least(self, 0, "seed")
        if self.resolution is not None:
            require_within(self, "[0.01, 1]", "resolution", unit="m")
        if self.fov is not None:
            require_within(self, "(0, 360]", "fov", unit="deg")
        if self.range_max is not None:
            require_above(self, 0, "range_max", unit="m", finite=True)
        if self.attitude not in ATTITUDES:
            raise unknown_name("attitude", self.attitude, ATTITUDES)
        if self.reference_topic is not None and self.reference is None:
            raise ConfigError("--reference-topic is of a --reference, which is not given")

    def digest(self, content: bytes | Path, readings: bytes | None = None) -> str:
        """Return eight hex digits that distinguish this map from others.

        Args:
            content: of the log, or its file. Its path is left out, and what the map is only evaluated by.
            readings: content of the file of inertial readings, if any.

        Raises:
            OSError: the file cannot be read.
        """
        entry = asdict(self) | {"log": _sha256(content)}
        for name in ("relations", "reference", "reference_topic", "imu"):
            del entry[name]
        if readings is not None:
            entry["imu"] = hashlib.sha256(readings).hexdigest()
        entry = _without(LATER_OF_MAPS, entry)
        return hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()[:8]
