"""Controls of the live page, generated from the declarations of options."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from lirs_validation.config import PRETRAINED, RunConfig
from lirs_wct import Pose2
from lirs_wct.option import Option, Options, declared
from lirs_wct.sources.source import SourceKind

DEFAULT = "not given"
"""Stands for "not given" among choices."""
Kind = Literal["switch", "choice", "slider", "text", "file"]


@dataclass(frozen=True)
class Control:
    """A control of one option; its value is a bool, a float, or text."""

    option: Option

    @property
    def name(self) -> str:
        """Name of the option's field."""
        return self.option.name

    @property
    def title(self) -> str:
        """Label; the paper's name if it has one."""
        return self.option.title or self.option.label

    @property
    def hint(self) -> str:
        """Help of the option, with the form of a text."""
        form = f" Form: {self.option.metavar}." if self.kind == "text" and self.option.metavar else ""
        return without_flags(f"{self.option.help}{form}")

    @property
    def kind(self) -> Kind:
        """Kind of control."""
        if self.option.type is bool:
            return "switch"
        if self.option.slider is not None:
            return "slider"
        if Path in self.option.types:
            return "file"
        return "choice" if self.choices else "text"

    @property
    def choices(self) -> tuple[str, ...]:
        """Legal values of a choice."""
        names = self.option.choices
        return (DEFAULT, *names) if names and self.option.default is None else names

    @property
    def initial(self) -> bool | float | str:
        """Value of the control that stands for the default."""
        default = self.option.default
        if self.option.slider is not None:
            return self.option.slider.neutral
        if default is None:
            return DEFAULT if self.kind == "choice" else ""
        if self.option.type is bool:
            return bool(default)
        return f"{default:g}" if isinstance(default, float) else str(default)

    def shown_for(self, source: SourceKind) -> bool:
        """Whether the option has an effect on a source."""
        kinds = self.option.kinds
        mapped = source is SourceKind.LOG and kinds is not None and SourceKind.MAP in kinds
        return kinds is None or source in kinds or mapped

    def read(self, value: bool | float | str) -> Any:
        """Return the option's value."""
        if value == self.initial and not isinstance(value, bool):
            return self.option.default
        if not isinstance(value, str) or self.kind == "choice":
            return int(value) if self.option.types[0] is int else value
        title_without_unit = self.title.partition(" [")[0]
        return self.option.read_one(value, title_without_unit)


def controls(options: type[Options]) -> Iterator[Control]:
    """Yield a control for every option of a class that the page offers."""
    yield from (Control(option) for option in declared(options).values() if option.on_page)


def to_goal(config: RunConfig, start: tuple[float, float], goal: tuple[float, float]) -> RunConfig:
    """Return a run that starts at a place, faces a goal and drives there.

    The policy that ships drives there where the config has it as driver.
    """
    kind = PRETRAINED if config.driver == PRETRAINED else "goal"
    driver = f"{kind}:{goal[0]},{goal[1]}"
    (x, y), (east, north) = start, goal
    yaw = round(math.atan2(north - y, east - x), 3)
    return replace(config, driver=driver, build=replace(config.build, start=Pose2(x, y, yaw)))


def without_flags(text: str) -> str:
    """Return a message in which options have names instead of command-line flags.

    >>> without_flags("give one of --size, --resolution")
    'give one of size, pixel size'
    """
    named = re.sub(r"--option ([a-z-]+)(=[A-Z/]+\b)?", r"--\1", text)
    return re.sub(r"--([a-z][a-z-]*)", lambda flag: flag[1].replace("-", " "), named)
