"""The command that repeats a run, in words."""

from __future__ import annotations

import shlex
from dataclasses import fields
from pathlib import Path
from typing import Any

from lirs_validation.config import RunConfig
from lirs_wct.geometry.pose import Pose2
from lirs_wct.sources.options import BuildOptions

OWN_WORDS = {"kind": "--as", "denoise": "--denoise-method"}
"""Options of `build` whose word is not their name."""


def command_of(config: RunConfig) -> str:
    """Return the command line that does this run again; what is as by default is left out."""
    words = ["lirs-wct", "validate", config.source, "--robot", config.robot, "--mapper", config.mapper]
    default = RunConfig(source=config.source)
    for name in ("lidar", "terrain", "rays", "seconds", "seed", "wall_limit"):
        value = getattr(config, name)
        if value != getattr(default, name) or name == "seed":
            words += [f"--{name.replace('_', '-')}", _told(value)]
    return shlex.join([*words, *_build_words(config.build)])


def _build_words(build: BuildOptions) -> list[str]:
    words = []
    default = BuildOptions()
    for name in (field.name for field in fields(BuildOptions)):
        value = getattr(build, name)
        if value == getattr(default, name):
            continue
        words.append(OWN_WORDS.get(name, f"--{name.replace('_', '-')}"))
        if value is not True:
            words.append(_told(value))
    return words


def _told(value: Any) -> str:
    if isinstance(value, Pose2):
        value = tuple(value.as_array().tolist())
    if isinstance(value, tuple):
        return ",".join(map(_told, value))
    if isinstance(value, (str, Path)):
        return str(value)
    return f"{value:.12g}"
