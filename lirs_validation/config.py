"""Options of validation runs, mapped logs and sweeps, each defined once.

Command line, sweep axes, page controls, digests, groups of runs and reference docs come from these fields.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any, Literal, get_args

from lirs_wct import BuildOptions, ConfigError, unknown_name
from lirs_wct.contact import ContactGeometry
from lirs_wct.formats import STORAGES, Clock, Storage
from lirs_wct.option import (
    Options,
    Slider,
    declared,
    digest_fields,
    documented,
    one_of,
    option,
    positive,
    within,
)
from slam_baselines.mapper import MAPPERS, file_name, parameter_text, read_parameters

Attitude = Literal["imu", "none"]
ATTITUDES: tuple[Attitude, ...] = get_args(Attitude)
ScanTime = Literal["instant", "rolling"]
DRIVABLE = within("(0, 1e6]", "simulated seconds")
"""Check of a drive's duration; 1e6 s are 12 days."""
STAND = 3.0
"""Simulated seconds for which inertial systems find gravity and biases before a drive."""
TOUR, FRONTIER, PRETRAINED = "tour", "frontier", "pretrained"
DRIVERS = {
    TOUR: "",
    FRONTIER: "",
    "waypoints": ":FILE",
    "replay": ":RUN",
    "goal": ":X,Y",
    PRETRAINED: "[:X,Y]",
}
"""Drivers, and the argument that each takes; brackets mark an optional one."""
NOISE_LEVELS, NOISE_FILES = ("none", "simulated", "datasheet"), (".yaml", ".yml")
"""Noise levels of a lidar, and suffixes of a file of sensor noise."""
MANUAL, CLIENT = "manual", "client"
"""Driver of a record that a person drove on the live page; `replay:RUN` repeats it."""

WORLD_FLAGS = ("size", "height", "resolution", "kind", "invert", "window", "wall_height", "start")
"""Options of a world that have flags of their own on commands that drive through it."""
World = Annotated[BuildOptions, WORLD_FLAGS]
"""Options of a world for commands that drive through it; `build` has a flag for each."""
AXES = "Axes of a sweep: every combination is run"
ENGINE = "Execution of a sweep"
LOG = "The log"
"""Panel of the options about the content of a log."""


def driver_parts(text: str) -> tuple[str, str]:
    """Return kind and argument of a driver, such as `frontier`, `goal:X,Y`, `replay:RUN` or `client`."""
    if text in (MANUAL, CLIENT):
        return text, ""
    kind, colon, path = text.partition(":")
    taken = DRIVERS.get(kind)
    if taken is None or (colon and not path) or (path and not taken) or (not path and taken[:1] == ":"):
        legal = ", ".join(f"{name}{argument}" for name, argument in DRIVERS.items())
        raise ConfigError(f"unknown driver {text!r}; legal: {legal}")
    return kind, path


def read_drivers(text: str, flag: str = "--driver") -> tuple[str, ...]:
    """Return the drivers of a list such as `tour,replay:out/a,b`, without repetitions.

    A path may hold commas: the list is split before each driver.
    """
    plain = "|".join(name for name, argument in DRIVERS.items() if argument[:1] != ":")
    with_path = "|".join(name for name, argument in DRIVERS.items() if argument)
    drivers = re.split(rf",\s*(?=(?:{plain})\s*(?:,|$)|(?:{with_path}):)", text.strip())
    for driver in drivers:
        try:
            driver_parts(driver.strip())
        except ConfigError as error:
            raise ConfigError(f"{flag}: {error}") from error
    return tuple(dict.fromkeys(driver.strip() for driver in drivers))


def read_parameter_sets(text: str, flag: str = "--parameters") -> tuple[str, ...]:
    """Return the sets of a list such as `none;srr=0.1,stt=0.2;FILE.yaml`, without repetitions."""
    parts = ("" if part.strip() == "none" else part.strip() for part in text.split(";"))
    return tuple(dict.fromkeys(parameter_text(part, flag) for part in parts))


def _known_noise(value: str, label: str) -> None:
    """Check that a noise is a level or the name of a YAML file."""
    if value not in NOISE_LEVELS and not value.endswith(NOISE_FILES):
        raise unknown_name(label, value, [*NOISE_LEVELS, "FILE.yaml"])


def axis(default: Any, text: str, metavar: str | None = None, **options: Any) -> Any:
    """Declare an option that a sweep crosses."""
    return option(default, text, metavar=metavar, axis=True, panel=AXES, **options)


def drive_factor(default: float, text: str, legal: str, shown: str) -> Any:
    """Declare a number that changes how a driver drives; searches set it."""
    check = within(legal)
    return axis(default, text, "X,X,...", check=check, shown=shown, rare=True, on_page=False)


def names_in(path: str) -> Callable[[], Collection[str]]:
    """Return a function that loads the names of `module:CONSTANT`, whose import is slow."""
    return lambda: resolve_name(path)


@documented
@dataclass(frozen=True, kw_only=True)
class RunConfig(Options):
    """One validation run.

    Attributes:
        source: A bundled world's name, a built folder, an image, a map YAML, a mesh or a laser log.
        bag: Storage of a ROS 2 bag in the run's folder; None = no bag.
        sensors_only: Whether the bag lacks map -> odom and /map, for a SLAM system that publishes these.
        build: Options of the world's construction.

    Raises:
        ConfigError: a value is not legal, or two options contradict.
    """

    source: str
    robot: str = axis("husky", "Robots.", metavar="R,R,...", names=names_in("lirs_envs.robots.robot:ROBOTS"))
    mapper: str = axis(
        "hector",
        "SLAM methods (lirs-wct list mappers); module:Class or file.py:Class for your own.",
        metavar="M,M,...",
        names=tuple(MAPPERS),
    )
    parameters: str = axis(
        "",
        "Parameters of the mapper, or slam_toolbox's FILE.yaml; `none;a=1` compares the defaults with a=1.",
        reader=read_parameter_sets,
        metavar="NAME=VALUE,...|FILE.yaml",
        check=lambda value, label: read_parameters(value, label) and None,
        on_page=False,
    )
    mapper_python: str | None = option(
        None,
        "Python interpreter of mappers that are not ours; lirs-wct is installed there, too.",
        metavar="PATH",
        in_digest=False,
        on_page=False,
    )
    lidar: str | None = axis(
        None,
        "Lidars; default: the robot's own.",
        metavar="L,L,...",
        names=names_in("lirs_envs.lidar.presets:LIDARS"),
    )
    terrain: ContactGeometry = axis(
        "hfield",
        "Contact geometry: the height field; the same, and rays meet the mesh; a prism per triangle within "
        "--max-error; the convex parts of a closed mesh, or its faces if they are many.",
    )
    rays: str = axis(
        "builtin",
        "Ray caster of the lidar: this package's own, or MuJoCo's for comparison.",
        metavar="builtin|mujoco",
        check=one_of(names_in("lirs_envs.lidar.ray_casting:RAYS")),
        shown="rays: {}",
        on_page=False,
    )
    attitude: Attitude = axis(
        "imu",
        "Roll and pitch of the mapper: the IMU's readings, or none, as in planar SLAM.",
        shown="attitude: {}",
    )
    driver: str = axis(
        TOUR,
        "A tour over the true ground; an explorer on the mapper's map and pose; waypoints (x, y[, yaw] per "
        "line) or a goal by the true pose; the commands of a finished run; the policy that ships.",
        reader=read_drivers,
        metavar="|".join(f"{name}{argument}" for name, argument in DRIVERS.items()),
        check=lambda value, _: driver_parts(value) and None,
        names=(TOUR, FRONTIER, PRETRAINED),
        shown="driver: {}",
    )
    speed: float = drive_factor(1.0, "Factors of the driver's speed.", "[0.1, 2]", "speed x {:g}")
    turn_rate: float = drive_factor(1.0, "Factors of the driver's turn rate.", "[0.1, 2]", "turn rate x {:g}")
    reversing: float = drive_factor(
        0.0,
        "Shares of the time in which the robot drives backwards along its path.",
        "[0, 1]",
        "reversing {:g}",
    )
    actors: int = axis(
        0,
        "Walkers on seeded paths: the lidar sees them, the robot touches them.",
        metavar="N,N,...",
        check=within("[0, inf)"),
        title="walkers",
        slider=Slider(low=0, high=100, step=1, neutral=0),
        shown="{} walkers",
    )
    scan_time: ScanTime | None = axis(
        None,
        "Beams of a scan: all at its stamp, or one after the other while the robot goes on; default: rolling "
        "for lidars with rings, instant for planar ones.",
        shown="scan time: {}",
        rare=True,
        on_page=False,
    )
    odometry_noise: float = axis(
        1.0,
        "Factors of the noise of wheels and gyro.",
        metavar="X,X,...",
        check=within("[0, 10]"),
        shown="odometry noise x {:g}",
        rare=True,
        on_page=False,
    )
    noise: str = axis(
        "simulated",
        "Sensor noise: a level of the lidar's, or a YAML file such as `lirs-wct twin` writes.",
        metavar="none|simulated|datasheet|FILE.yaml",
        check=_known_noise,
        shown="noise: {}",
        names=NOISE_LEVELS,
        on_page=False,
    )
    seed: int = axis(
        1, "Seeds of every random number: 1-5 or 1,3,7-9.", metavar="N|N-M|N,N,...", check=within("[0, inf)")
    )
    seconds: float = option(
        120.0,
        "Simulated seconds to drive in each run.",
        check=DRIVABLE,
        slider=Slider(low=1, high=3600, step=1, neutral=120),
        shown="{:g} s",
    )
    stand: float | None = option(
        None,
        "Simulated seconds for which the robot stands still before it drives; default: 3 for `record` and "
        "for mappers that read the inertial unit, else 0.",
        metavar="S",
        check=within("[0, inf)"),
        shown="stands for {:g} s",
        rare=True,
        on_page=False,
    )
    wall_limit: float | None = option(
        None,
        "Stop a drive after this many wall seconds; its RTF is extrapolated and marked.",
        metavar="S",
        check=positive,
        in_digest=False,
        on_page=False,
    )
    bag: Storage | None = None
    sensors_only: bool = False
    build: BuildOptions = field(default_factory=BuildOptions)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stand is not None:
            object.__setattr__(self, "stand", float(self.stand))
        if self.bag is not None:
            one_of(STORAGES)(self.bag, "storage of a bag")

    @property
    def digest(self) -> str:
        """Eight hex digits that distinguish this experiment from others."""
        entry = digest_fields(self) | {"source": self.source, "build": digest_fields(self.build)}
        if self.noise.endswith(NOISE_FILES) and Path(self.noise).is_file():
            entry["noise"] = sha256(Path(self.noise))
        return digest_text(entry)


RUN_AXES = tuple(name for name, found in declared(RunConfig).items() if found.axis)
"""Options that a sweep crosses, in the order of its runs."""


def run_name(config: RunConfig, world: str) -> str:
    """Return the name of the run's folder, with the mapper's class and the driver's kind."""
    driver = "" if config.driver == TOUR else f"-{driver_parts(config.driver)[0]}"
    return f"{world}-{config.robot}-{file_name(config.mapper)}{driver}-s{config.seed}-{config.digest}"


@documented
@dataclass(frozen=True, kw_only=True)
class EngineOptions(Options):
    """Execution of a sweep's experiments.

    Raises:
        ConfigError: a value is not legal, or two options contradict.
    """

    jobs: int | None = option(
        None,
        "Concurrent runs, each in its own process; their RTFs are marked.",
        metavar="N",
        panel=ENGINE,
        check=within("[1, inf)"),
    )
    address: str | None = option(
        None, "Address of a Ray cluster; `local` starts one on this machine.", panel=ENGINE
    )
    cell_timeout: float | None = option(
        None,
        "End a run after this many wall seconds in all.",
        metavar="S",
        panel=ENGINE,
        check=positive,
        rare=True,
    )
    retry_failed: bool = option(False, "Repeat failed runs of an earlier sweep.", panel=ENGINE)


@documented
@dataclass(frozen=True, kw_only=True)
class LogOptions(Options):
    """Reading of a laser log."""

    fov: float | None = option(
        None,
        "Field of view of the laser, if the log does not state it.",
        metavar="DEG",
        check=within("(0, 360]", "deg"),
        panel=LOG,
    )
    range_max: float | None = option(
        None, "Ranges from this value on are no return.", metavar="METERS", check=positive, panel=LOG
    )
    scan_topic: str | None = option(
        None, "Laser scans of a bag; default: the only such topic.", metavar="TOPIC", panel=LOG
    )
    odom_topic: str | None = option(
        None, "Odometry of a bag; default: the only one, else /tf.", metavar="TOPIC", panel=LOG
    )
    imu_topic: str | None = option(
        None,
        "Inertial readings of a bag, with attitude for planar mappers; default: none.",
        metavar="TOPIC",
        panel=LOG,
    )
    time: Clock = option(
        "header", "Stamps of a bag: those of the headers, or the times of reception.", panel=LOG
    )


@documented
@dataclass(frozen=True, kw_only=True)
class MapConfig(LogOptions):
    """Mapping of a laser log.

    Attributes:
        log: Path of a CARMEN log or a ROS bag.

    Raises:
        ConfigError: a value is not legal.
    """

    log: str
    mapper: str = option(
        "cartographer",
        "SLAM method: hector, gmapping, cartographer, ...",
        metavar="NAME|module:Class",
        names=tuple(MAPPERS),
    )
    parameters: str = option(
        "",
        "Parameters of the mapper, fields of its configuration, or slam_toolbox's FILE.yaml.",
        reader=parameter_text,
        metavar="NAME=VALUE,...|FILE.yaml",
        check=lambda value, label: read_parameters(value, label) and None,
    )
    mapper_python: str | None = option(
        None, "Python interpreter of a mapper that is not ours.", metavar="PATH", in_digest=False
    )
    seed: int = option(1, "Seed of the mapper's random numbers.", check=within("[0, inf)"))
    resolution: float | None = option(
        None,
        "Cell size of the map, 0.01 to 1 m; default: the mapper's own.",
        metavar="METERS",
        check=within("[0.01, 1]", "m"),
    )
    relations: str | None = option(
        None,
        "True relations between poses: the record then holds the accuracy.",
        metavar="FILE",
        in_digest=False,
    )
    reference: str | None = option(
        None,
        "Reference trajectory (TUM, BAG or BAG:/TOPIC, or CARMEN of corrected poses): the record then holds "
        "the ATE.",
        metavar="FILE",
        in_digest=False,
    )
    imu: str | None = option(
        None, "Inertial readings at the scans: imu.csv.gz of a run.", metavar="FILE", in_digest=False
    )
    attitude: Attitude = option("imu", "Roll and pitch of the mapper: --imu, or none.", rare=True)
    second: str | None = option(
        None,
        "Mapper to compare with where no truth is given; default: hector (of hector: cartographer); or none.",
        metavar="NAME|none",
        names=(*MAPPERS, "none"),
        in_digest=False,
    )

    def digest(self, content: bytes | Path, readings: bytes | None = None) -> str:
        """Return eight hex digits that distinguish this map from others.

        Args:
            content: Content of the log, or its file, in place of its path.
            readings: Content of the file of inertial readings, if any.
        """
        entry = digest_fields(self) | {"log": sha256(content)}
        return digest_text(entry if readings is None else entry | {"imu": sha256(readings)})


def digest_text(entry: dict[str, Any]) -> str:
    """Return the digest of an options' folder name."""
    return sha256(json.dumps(entry, sort_keys=True, default=str).encode())[:8]


def sha256(content: bytes | Path) -> str:
    """Return the digest of bytes or of a file, which is read in parts."""
    if isinstance(content, bytes):
        return hashlib.sha256(content).hexdigest()
    with content.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
