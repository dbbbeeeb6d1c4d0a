"""Controls of the live page, generated from the declarations of options."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from lirs_validation.config import PRETRAINED, RunConfig
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.option import Option, Options, Slider, declared
from lirs_wct.sources.options import BuildOptions, SourceKind

FIRST_PANEL = "Source"
"""Heading of the options that the command line has without one."""
DEFAULT = "not given"
"""Stands for "not given" among choices."""
Kind = Literal["switch", "choice", "slider", "text", "file"]


@dataclass(frozen=True, kw_only=True)
class Control:
    """A control of one option; its value is a bool, a float, or text.

    Attributes:
        name: of the option's field.
        kind: of control.
        title: its label; the paper's name if it has one.
        panel: its heading.
        hint: help.
        initial: value of the control that stands for the default.
        default: of the option.
        choices: legal values of a choice.
        slider: of a number.
    """

    name: str
    kind: Kind
    title: str
    panel: str
    hint: str
    initial: bool | float | str
    default: Any
    choices: tuple[str, ...] = ()
    slider: Slider | None = None
    option: Option

    @property
    def name_in_errors(self) -> str:
        """The title without its unit."""
        return self.title.partition(" [")[0]

    def shown_for(self, source: SourceKind) -> bool:
        """Whether the option has an effect on a source."""
        kinds = self.option.kinds
        mapped = source is SourceKind.LOG and kinds is not None and SourceKind.MAP in kinds
        return kinds is None or source in kinds or mapped

    def read(self, value: bool | float | str) -> Any:
        """Return the option's value.

        Raises:
            ConfigError: the text is no such value.
        """
        if value == self.initial and not isinstance(value, bool):
            return self.default
        if not isinstance(value, str) or self.kind == "choice":
            return int(value) if self.option.types[0] is int else value
        return self.option.read(value, self.name_in_errors)


def controls(options: type[Options]) -> Iterator[Control]:
    """Yield a control for every option of a class that the page offers."""
    for name, option in declared(options).items():
        if not option.on_page:
            continue
        kind, choices, initial = _kind(option)
        form = f" Form: {option.metavar}." if kind == "text" and option.metavar else ""
        yield Control(
            name=name,
            kind=kind,
            title=option.title or option.label,
            panel=option.panel or FIRST_PANEL,
            hint=without_flags(f"{option.help}{form}"),
            initial=initial,
            default=option.default,
            choices=choices,
            slider=option.slider,
            option=option,
        )


def _kind(option: Option) -> tuple[Kind, tuple[str, ...], Any]:
    """Return kind of control, its choices and its first value."""
    default = option.default
    if option.type is bool:
        return "switch", (), default
    if option.slider is not None:
        return "slider", (), option.slider.neutral
    if Path in option.types:
        return "file", (), ""
    if option.choices:
        return "choice", (DEFAULT, *option.choices) if default is None else option.choices, default or DEFAULT
    return (
        "text",
        (),
        "" if default is None else f"{default:g}" if isinstance(default, float) else str(default),
    )


def read_controls(values: Mapping[str, bool | float | str]) -> BuildOptions:
    """Return the options of a page's controls.

    Raises:
        ConfigError: a value is not legal, or two options contradict.
    """
    return BuildOptions(
        **{c.name: c.read(values[c.name]) for c in controls(BuildOptions) if c.name in values}
    )


def read_run_controls(
    values: Mapping[str, bool | float | str], source: str, build: BuildOptions
) -> RunConfig:
    """Return the run of a page's controls.

    Raises:
        ConfigError: a value is not legal, or beyond the page's slider.
    """
    given = {}
    for control in controls(RunConfig):
        value, slider = values[control.name], control.slider
        if slider is not None and not slider.low <= float(value) <= slider.high:
            raise ConfigError(
                f"{control.name_in_errors} must be {slider.low:g} to {slider.high:g} here, got {value}"
            )
        given[control.name] = control.read(value)
    return RunConfig(source=source, build=build, **given)


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
