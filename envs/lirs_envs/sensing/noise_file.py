"""Sensor noise in a YAML file.

Its sections are `lidar`, `odometry` and `imu`, with the fields of their classes.
"""

from __future__ import annotations

from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, get_args

import yaml

from lirs_envs.lidar.noise import LidarNoise, NoiseLevel
from lirs_envs.sensing.imu import ImuConfig
from lirs_envs.sensing.odometry import OdometryConfig
from lirs_envs.sensing.sensors import SensorNoise
from lirs_wct.errors import ConfigError, SourceError, unknown_name
from lirs_wct.files import atomic_write
from lirs_wct.formats.yaml_text import load_yaml

SECTIONS: dict[str, type[Any]] = {"lidar": LidarNoise, "odometry": OdometryConfig, "imu": ImuConfig}
"""Classes of the sections."""


def resolve_noise(noise: str) -> SensorNoise:
    """Return the noise of a level of the lidar, or of a YAML file.

    Raises:
        SourceError: it is no level, and no such file can be used.
    """
    for level in get_args(NoiseLevel):
        if noise == level:
            return SensorNoise(lidar=level)
    return read_noise(Path(noise))


def read_noise(path: Path) -> SensorNoise:
    """Read the noise of a YAML file.

    Omitted sections and fields keep their defaults.

    Raises:
        SourceError: the file cannot be read, or holds anything else; the message names it.
    """
    try:
        entries = load_yaml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise SourceError(f"{path}: {error}") from error
    if not isinstance(entries, dict) or not entries:
        raise SourceError(f"{path}: must hold sections, got none; legal: {', '.join(SECTIONS)}")
    made = SensorNoise()
    for name, given in entries.items():
        try:
            if name not in SECTIONS:
                raise unknown_name("section", str(name), SECTIONS)
            made = replace(made, **{name: _section(name, given)})
        except ConfigError as error:
            raise SourceError(f"{path}: {error}") from error
    return made


def _section(name: str, given: object) -> Any:
    """Return the object of a section.

    Raises:
        ConfigError: a field is unknown, or its value illegal.
    """
    kind = SECTIONS[name]
    legal = {field.name: field.default for field in fields(kind)}
    if not isinstance(given, dict):
        raise ConfigError(f"section {name} must hold fields, got {given!r}; legal: {', '.join(legal)}")
    for key, value in given.items():
        if key not in legal:
            raise unknown_name(f"field of {name}", str(key), legal)
        number = isinstance(legal[key], float)
        if number and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise ConfigError(f"{key} of {name} must be a number, got {value!r}")
    return kind(**given)


def write_noise(path: Path, noise: SensorNoise, comment: str) -> None:
    """Write the noise as a YAML file that begins with a comment.

    Raises:
        OutputError: the file cannot be written.
        ConfigError: the lidar's noise is a level.
    """
    if not isinstance(noise.lidar, LidarNoise):
        raise ConfigError(f"a noise file needs the lidar's own figures, got level {noise.lidar!r}")
    entries = {name: asdict(getattr(noise, name)) for name in SECTIONS}
    text = "".join(f"# {line}\n" for line in comment.splitlines())
    with atomic_write(path) as temporary:
        temporary.write_text(text + yaml.safe_dump(entries, sort_keys=False), encoding="utf-8")
