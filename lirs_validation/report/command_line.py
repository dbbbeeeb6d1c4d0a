"""The command that repeats a run."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lirs_validation.config import RunConfig
from lirs_wct.geometry.pose import Pose2
from lirs_wct.option import Options, changed, declared


def command_of(config: RunConfig) -> str:
    """Return the command line that repeats a run; defaults are left out."""
    always = ["--robot", config.robot, "--mapper", config.mapper, "--seed", str(config.seed)]
    stated = ("robot", "mapper", "seed")
    given = [*always, *_arguments(config, stated), *_arguments(config.build)]
    return shlex.join(["lirs-wct", "validate", config.source, *given])


def _arguments(options: Options, stated: tuple[str, ...] = ()) -> Iterator[str]:
    flags = {name: option.flags[0] for name, option in declared(type(options))}
    for name, value in changed(options).items():
        if name not in stated:
            yield flags[name]
            if value is not True:
                yield _formatted(value)


def _formatted(value: Any) -> str:
    if isinstance(value, Pose2):
        value = tuple(value.as_array().tolist())
    if isinstance(value, tuple):
        return ",".join(map(_formatted, value))
    if isinstance(value, (str, Path)):
        return str(value)
    return f"{value:.12g}"
