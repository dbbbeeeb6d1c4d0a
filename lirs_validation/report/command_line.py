"""The command that repeats a run."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from lirs_validation.config import LATER, RunConfig
from lirs_wct.geometry.pose import Pose2
from lirs_wct.option import declared
from lirs_wct.sources.options import BuildOptions


def command_of(config: RunConfig) -> str:
    """Return the command line that does this run again; what is as by default is left out."""
    arguments = ["lirs-wct", "validate", config.source, "--robot", config.robot, "--mapper", config.mapper]
    default = RunConfig(source=config.source)
    for name in ("lidar", "terrain", "rays", "seconds", "seed", "wall_limit", *LATER):
        value = getattr(config, name)
        if value != getattr(default, name) or name == "seed":
            arguments += [f"--{name.replace('_', '-')}", _formatted(value)]
    return shlex.join([*arguments, *_build_arguments(config.build)])


def _build_arguments(build: BuildOptions) -> list[str]:
    arguments = []
    default = type(build)()
    for name, option in declared(type(build)):
        value = getattr(build, name)
        if value == getattr(default, name):
            continue
        arguments.append(option.flags[0])
        if value is not True:
            arguments.append(_formatted(value))
    return arguments


def _formatted(value: Any) -> str:
    if isinstance(value, Pose2):
        value = tuple(value.as_array().tolist())
    if isinstance(value, tuple):
        return ",".join(map(_formatted, value))
    if isinstance(value, (str, Path)):
        return str(value)
    return f"{value:.12g}"
