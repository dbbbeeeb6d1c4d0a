"""Options of a laser log's mapping."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lirs_validation.config import Attitude, digest_text, sha256
from lirs_wct.formats.suffixes import Clock
from lirs_wct.option import Options, digest_fields, documented, option, positive, within
from slam_baselines.mapper import MAPPERS, read_parameters

LOG = "The log"
"""Panel of the options about the content of a log."""


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
        log: path of a CARMEN log or a ROS bag.

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
        "Parameters of the mapper, fields of its configuration.",
        metavar="NAME=VALUE,...",
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
            content: of the log, or its file, in place of its path.
            readings: content of the file of inertial readings, if any.

        Raises:
            OSError: the file cannot be read.
        """
        entry = digest_fields(self) | {"log": sha256(content)}
        return digest_text(entry if readings is None else entry | {"imu": sha256(readings)})
