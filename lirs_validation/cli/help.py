"""Help of commands: the common options at first, all of them with `--help-all`."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import Any

import typer
from typer.core import TyperCommand

MOST = 15
"""Options that a help shows, at most."""
_SOURCE = ("--size", "--height", "--pixel-size", "--window", "--invert", "--wall-height", "--as")
_DRIVE = ("--robot", "--mapper", "--lidar", "--seconds", "--seeds", "-o", "--driver", "--attitude")
COMMON: Mapping[str, tuple[str, ...]] = {
    "validate": (*_DRIVE, "--size", "--height", "--jobs", "--gate", "--suite"),
    "verdict": ("--robot", "--mapper", "--lidar", "--budget", "--seconds", "-o", "--jobs", "--gate",
                "--attitude", "--driver", "--actors", "--size", "--height"),
    "map": ("--mapper", "-o", "--relations", "--reference", "--second", "--resolution", "--particles",
            "--range-max", "--fov", "--seed", "--imu", "--scan-topic", "--odom-topic"),
    "build": (*_SOURCE, "-o", "--to", "--name", "--max-error", "--texture"),
    "info": ("--robot", *_SOURCE, "-o"),
    "view": ("-o", "--oblique", *_SOURCE),
    "collide": ("--robot", "--seconds", "--seeds", "-o", "--terrain", *_SOURCE),
    "tune": ("--robot", "--mapper", "--lidar", "--seconds", "--drives", "-o", "--repeats", "--unseen",
             "--seed", "--within", "--parameters", "--reference", "--relations"),
    "twin": ("-o", "--lidar", "--mapper", "--replay", "--draws", "--reference", "--relations", "--fov",
             "--range-max", "--scan-topic", "--odom-topic", "--seed"),
    "live": ("--robot", "--lidar", "--seconds", "-o", "--middleware", "--domain", "--ros", "--lockstep",
             "--every", "--rate", "--client", "--mapper", "--driver"),
    "record": (*_DRIVE, "--actors", "--size", "--height"),
}  # fmt: skip
"""Options in the help of commands that have more than `MOST`, in order of use."""


class Command(TyperCommand):
    """Command whose help shows its common options; `--help-all` shows all."""

    def __init__(self, name: str | None, **given: Any) -> None:
        super().__init__(name, **given)
        self._common = COMMON.get(name or "", ())
        if self._common:
            self.params.append(_help_all(sum(_is_listed(param) for param in self.params)))

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters: in a short help, arguments and common options."""
        params = super().get_params(ctx)
        if not self._common or not ctx.meta.get(__name__):
            return params
        options = {flag: param for param in params if _is_listed(param) for flag in param.opts}
        shown: list[Any] = [copy(options[flag]) for flag in (*self._common, "--help-all", "--help")]
        for param in shown:
            param.rich_help_panel = None
        return [param for param in params if param.param_type_name == "argument"] + shown

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help, the short one unless all options are requested."""
        ctx.meta[__name__] = not ctx.meta.get("all options")
        super().format_help(ctx, formatter)
        ctx.meta[__name__] = False


def _is_listed(param: Any) -> bool:
    return param.param_type_name == "option" and not param.hidden


def _help_all(count: int) -> Any:
    """Return the option that shows the help of all options."""

    def show(ctx: typer.Context, asked: bool) -> None:
        if asked and not ctx.resilient_parsing:
            ctx.meta["all options"] = True
            typer.echo(ctx.get_help(), color=ctx.color)
            raise typer.Exit

    app = typer.Typer(add_completion=False)
    text = f"Show all {count} options and exit."
    given: Any = typer.Option(False, "--help-all", is_eager=True, callback=show, help=text)

    @app.command()
    def declare(asked: bool = given) -> None:
        """Take the option."""

    option = typer.main.get_command(app).params[0]
    option.expose_value = False
    return option
