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
    "map": ("--mapper", "-o", "--relations", "--reference", "--second", "--resolution",
            "--range-max", "--fov", "--seed", "--imu", "--scan-topic", "--odom-topic", "--time"),
    "build": (*_SOURCE, "-o", "--to", "--name", "--max-error", "--texture"),
    "info": ("--robot", *_SOURCE, "-o", "--scan-topic", "--odom-topic", "--range-max", "--time"),
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
EXAMPLES: Mapping[str, tuple[str, ...]] = {
    "build": (
        "lirs-wct build examples/data/dunes.png --size 30 --height 2.5 -o worlds/",
        "lirs-wct build examples/data/office.yaml --wall-height 2 --to mjcf -o worlds/",
    ),
    "report": ("lirs-wct report out/ -o report.html --markdown report.md",),
    "compare": (
        "lirs-wct compare out/a out/b",
        "lirs-wct compare out/ out/ --across mapper --only-a mapper=hector --only-b mapper=gmapping",
    ),
    "score": ("lirs-wct score out/RUN --trajectory est.tum --map map.yaml -o score.json",),
    "export": ("lirs-wct export out/RUN --to bag,csv -o exported/",),
    "bench": (
        "lirs-wct bench straight go_to_goal astar --set lirs --task navigation -o out/",
        "lirs-wct bench my_policy:MyPolicy --set hills -o out/",
    ),
    "collide": ("lirs-wct collide simple advanced --robot husky,turtlebot2 --seconds 60 -o out/",),
    "info": (
        "lirs-wct info examples/data/office.yaml --robot turtlebot2 -o office.png",
        "lirs-wct info examples/data/office.clf.gz",
    ),
    "convert": ("lirs-wct convert terrain.stl terrain.dae",),
    "robot": ("lirs-wct robot husky",),
    "mappers": ("lirs-wct mappers",),
    "doctor": ("lirs-wct doctor",),
    "gui": ("lirs-wct gui medium --port 8080",),
    "validate": (
        "lirs-wct validate examples/data/dunes.png --mapper hector --seconds 60 --seed 1 -o out/",
        "lirs-wct validate simple medium --robot husky,jackal --mapper hector,gmapping --seeds 1-5 -o out/",
        "lirs-wct validate medium --lidar vlp16 --mapper kiss-icp,genz-icp,hector --seeds 1-3 -o out/",
    ),
    "verdict": (
        "lirs-wct verdict medium --robot jackal --mapper hector,gmapping --budget 10min -o verdict/",
    ),
    "falsify": (
        "lirs-wct falsify --mapper hector --drives 150 --jobs 2 -o failures/",
        "lirs-wct falsify --policy go_to_goal --drives 60 -o failures/",
        "lirs-wct validate --suite failures/cases.yaml -o out/",
    ),
    "tune": (
        "lirs-wct tune medium --robot husky --mapper gmapping_original --seconds 40 -o tune/",
        "lirs-wct tune examples/data/office.clf.gz --mapper hector_original --unseen 4 -o tune/",
    ),
    "record": ("lirs-wct record simple --seconds 60 -o run",),
    "live": (
        "lirs-wct live simple --robot husky --lockstep --seconds 60 -o out/",
        "lirs-wct live medium --driver tour --client slam_toolbox --rate 1 -o out/",
    ),
    "map": ("lirs-wct map examples/data/office.clf.gz --mapper gmapping -o out/",),
    "twin": (
        "lirs-wct twin examples/data/office.clf.gz -o out/",
        "lirs-wct validate examples/data/office.yaml --noise out/office-TWIN/noise.yaml -o out/",
    ),
}
"""Command lines by command."""


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


def epilog(command: str) -> str:
    """Return the examples of a command as its help shows them: one a line."""
    return "\n\n".join(("Examples:", *EXAMPLES[command]))
