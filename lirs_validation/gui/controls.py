"""Controls of the live page, generated from the declarations of options."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from lirs_validation.config import PRETRAINED, MapConfig, RunConfig
from lirs_wct import BuildOptions, Pose2
from lirs_wct.option import Option, Options, declared
from lirs_wct.sources.source import SourceKind

COMMAND = r"lirs-wct [a-z]+ (\S+ )?(?=--)"
"""Start of a command in a message, where the page has a control of the option that follows."""
DEFAULT = re.compile(r"default: ([^,.;]+)", re.IGNORECASE)
"""Default in the help of an option; stands for it among choices."""
Kind = Literal["switch", "choice", "slider", "text", "file"]


@dataclass(frozen=True)
class Control:
    """A control of one option; its value is a bool, a float, or text.

    Attributes:
        title: Label; the paper's name if it has one.
        hint: Help of the option, with the form of a text.
        choices: Legal values of a choice.
        initial: Value that stands for the option's default.
    """

    option: Option
    name: str
    title: str
    hint: str
    kind: Kind
    choices: tuple[str, ...]
    initial: bool | float | str

    @staticmethod
    def of(option: Option) -> Control:
        """Return the control of an option."""
        default, choices = option.default, option.choices
        initial: bool | float | str = f"{default:g}" if isinstance(default, float) else str(default)
        kind: Kind = "choice" if choices else "text"
        if default is None:
            stated = DEFAULT.search(option.help)
            initial = stated[1] if choices and stated else ""
            choices = (initial, *choices) if choices else ()
        if option.type is bool:
            kind, initial = "switch", bool(default)
        elif option.slider is not None:
            kind, initial = "slider", option.slider.neutral
        elif Path in option.types:
            kind = "file"
        form = f" Form: {option.metavar}." if kind == "text" and option.metavar else ""
        title, hint = option.title or option.label, without_flags(f"{option.help}{form}")
        return Control(option, option.name, title, hint, kind, choices, initial)

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
    yield from (Control.of(option) for option in declared(options).values() if option.on_page)


def to_goal(config: RunConfig, start: tuple[float, float], goal: tuple[float, float]) -> RunConfig:
    """Return a run that starts at a place, faces a goal and drives there.

    The policy that ships drives there where the config has it as driver.
    """
    kind = PRETRAINED if config.driver == PRETRAINED else "goal"
    driver = f"{kind}:{goal[0]},{goal[1]}"
    (x, y), (east, north) = start, goal
    yaw = round(math.atan2(north - y, east - x), 3)
    return replace(config, driver=driver, build=replace(config.build, start=Pose2(x, y, yaw)))


LABELS = {
    option.flag: option.title.partition(" [")[0] or option.label
    for options in (MapConfig, RunConfig, BuildOptions)
    for option in declared(options).values()
}
"""Label of each option's control, without its unit, by the option's flag."""


def without_flags(text: str) -> str:
    """Return a message in which options have the labels of their controls instead of flags.

    >>> without_flags("give one of --size, --option nodata=VALUE, --z-scale 2")
    'give one of size, nodata, z axis scale 2'
    """
    named = re.sub(r"--option ([a-z-]+)(=[A-Z/]+\b)?", r"--\1", re.sub(COMMAND, "", text))
    return re.sub(r"--[a-z][a-z-]*", lambda flag: LABELS.get(flag[0], flag[0][2:].replace("-", " ")), named)
