"""The options of `build`, which every command that takes a source takes too."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any, Literal

import typer

from lirs_wct.errors import ConfigError
from lirs_wct.options import BuildOptions
from lirs_wct.pose import Pose2

TERRAIN, MAP = "Terrain pictures", "Laser maps"


def numbers(text: str, option: str, form: str, counts: tuple[int, ...]) -> tuple[float, ...]:
    """Return the comma-separated numbers of an option.

    Raises:
        ConfigError: not numbers, or not as many as are legal.
    """
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) not in counts:
        raise ConfigError(f"{option} must be {form}, got {text!r}")
    return values


def build_options(
    name: Annotated[str | None, typer.Option(help="Name of the world; default: the file's.")] = None,
    kind: Annotated[
        str | None,
        typer.Option("--as", metavar="picture|map", help="Read a picture as terrain or as laser map."),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            metavar="W[,H]",
            help="Extent in metres: longer side, or width and height. Default 50, or the GeoTIFF's own.",
            rich_help_panel=TERRAIN,
        ),
    ] = None,
    pixel_size: Annotated[
        float | None, typer.Option(help="Metres a pixel, instead of --size.", rich_help_panel=TERRAIN)
    ] = None,
    height: Annotated[
        float | None,
        typer.Option(
            help="Metres from the darkest to the brightest pixel. Default 6, or the GeoTIFF's own.",
            rich_help_panel=TERRAIN,
        ),
    ] = None,
    grayscale: Annotated[
        bool, typer.Option("--grayscale", help="Turn a colour picture into gray.", rich_help_panel=TERRAIN)
    ] = False,
    invert: Annotated[
        bool, typer.Option("--invert", help="Black is high, white is low.", rich_help_panel=TERRAIN)
    ] = False,
    window: Annotated[
        str | None,
        typer.Option(metavar="X,Y,SIDE", help="Keep only this square of the world, metres."),
    ] = None,
    max_pixels: Annotated[
        int, typer.Option(help="Refuse larger pictures before decoding them.")
    ] = BuildOptions().max_pixels,
    resolution: Annotated[
        float | None,
        typer.Option(help="Metres a cell, for a map picture without YAML.", rich_help_panel=MAP),
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option(metavar="X,Y,YAW", help="Pose of such a map's lower-left corner.", rich_help_panel=MAP),
    ] = None,
    wall_height: Annotated[
        float, typer.Option(help="Metres that walls stand high.", rich_help_panel=MAP)
    ] = BuildOptions().wall_height,
) -> BuildOptions:
    """Read the options of the command line.

    Raises:
        ConfigError: a value is not legal.
    """
    wide = size and numbers(size, "--size", "W or W,H in metres", (1, 2))
    square = window and numbers(window, "--window", "X,Y,SIDE in metres", (3,))
    pose = origin and numbers(origin, "--origin", "X,Y or X,Y,YAW in metres and radians", (2, 3))
    return BuildOptions(
        name=name,
        kind=_kind(kind),
        size=(wide[0] if len(wide) == 1 else (wide[0], wide[1])) if wide else None,
        pixel_size=pixel_size,
        height=height,
        grayscale=grayscale,
        invert=invert,
        window=(square[0], square[1], square[2]) if square else None,
        max_pixels=max_pixels,
        resolution=resolution,
        origin=Pose2(*pose) if pose else None,
        wall_height=wall_height,
    )


def with_build_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options of `build`; its last parameter `options` receives them."""
    own = inspect.signature(command, eval_str=True)
    shared = inspect.signature(build_options, eval_str=True)

    @wraps(command)
    def wrapped(**given: Any) -> Any:
        chosen = {key: given.pop(key) for key in shared.parameters}
        return command(**given, options=build_options(**chosen))

    parameters = [p for p in own.parameters.values() if p.name != "options"] + list(
        shared.parameters.values()
    )
    keywords = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters]
    wrapped.__signature__ = inspect.Signature(keywords)  # type: ignore[attr-defined]
    wrapped.__annotations__ = {p.name: p.annotation for p in keywords}
    del wrapped.__wrapped__  # type: ignore[attr-defined]
    return wrapped


def _kind(given: str | None) -> Literal["picture", "map"] | None:
    match given:
        case None | "picture" | "map":
            return given
        case _:
            raise ConfigError(f"--as must be picture or map, got {given!r}")
