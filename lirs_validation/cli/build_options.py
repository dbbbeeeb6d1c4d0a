"""The options of `build`, which every command that takes a source takes too."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Any, Literal

from lirs_validation.cli import option_help as word
from lirs_validation.cli.log_sources import with_logs_mapped
from lirs_wct.contact.contact_geometry import CONTACT_GEOMETRIES, ContactGeometry
from lirs_wct.errors import ConfigError, unknown_name
from lirs_wct.geometry.pose import Pose2
from lirs_wct.sources.options import DENOISE_METHODS, UNKNOWN, BuildOptions

_DEFAULT = BuildOptions()


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


def pixels(text: str, option: str, form: str, count: int) -> tuple[int, ...]:
    """Return the comma-separated whole numbers of an option (see `numbers`)."""
    values = numbers(text, option, form, (count,))
    if any(not value.is_integer() for value in values):
        raise ConfigError(f"{option} must be {form}, got {text!r}")
    return tuple(int(value) for value in values)


def build_options(
    name: word.Name = None,
    kind: word.Kind = None,
    window: word.Window = None,
    max_pixels: word.MaxPixels = _DEFAULT.max_pixels,
    size: word.Size = None,
    pixel_size: word.PixelSize = None,
    height: word.Height = None,
    z_scale: word.ZScale = None,
    scale: word.Scale = None,
    grayscale: word.Grayscale = False,
    invert: word.Invert = False,
    crop: word.Crop = None,
    resize: word.Resize = None,
    deterrace: word.Deterrace = False,
    denoise: word.Denoise = False,
    denoise_method: word.DenoiseMethod = None,
    smoothing: word.Smoothing = None,
    sharpness: word.Sharpness = None,
    resolution: word.Resolution = None,
    origin: word.Origin = None,
    wall_height: word.WallHeight = _DEFAULT.wall_height,
    unknown: word.Unknown = _DEFAULT.unknown,
    speckle: word.Speckle = _DEFAULT.speckle,
    max_error: word.MaxError = None,
    max_triangles: word.MaxTriangles = None,
    rotate_x: word.RotateX = _DEFAULT.rotate_x,
    texture: word.Texture = None,
    texture_size: word.TextureSize = None,
    log_mapper: word.LogMapper = _DEFAULT.log_mapper,
) -> BuildOptions:
    """Read the options of the command line.

    Raises:
        ConfigError: a value is not legal, or two options contradict.
    """
    wide = size and numbers(size, "--size", "W or W,H in metres", (1, 2))
    square = window and numbers(window, "--window", "X,Y,SIDE in metres", (3,))
    pose = origin and numbers(origin, "--origin", "X,Y or X,Y,YAW in metres and radians", (2, 3))
    factors = scale and numbers(scale, "--scale", "S or SX,SY,SZ", (1, 3))
    frame = crop and pixels(crop, "--crop", "X,Y,W,H in whole pixels", 4)
    sides = resize and pixels(resize, "--resize", "W,H in whole pixels", 2)
    return BuildOptions(
        name=name,
        kind=_choice(kind, "--as", ("picture", "map")) if kind else None,
        size=(wide[0] if len(wide) == 1 else (wide[0], wide[1])) if wide else None,
        pixel_size=pixel_size,
        height=height,
        grayscale=grayscale,
        invert=invert,
        window=(square[0], square[1], square[2]) if square else None,
        max_pixels=max_pixels,
        crop=(frame[0], frame[1], frame[2], frame[3]) if frame else None,
        resize=(sides[0], sides[1]) if sides else None,
        deterrace=deterrace,
        denoise=_denoise(denoise, denoise_method),
        smoothing=smoothing,
        sharpness=sharpness,
        z_scale=z_scale,
        scale=(factors[0], factors[len(factors) // 2], factors[-1]) if factors else None,
        resolution=resolution,
        origin=Pose2(*pose) if pose else None,
        wall_height=wall_height,
        unknown=_choice(unknown, "--unknown", UNKNOWN),
        speckle=speckle,
        rotate_x=rotate_x,
        max_error=max_error,
        max_triangles=max_triangles,
        texture=texture,
        texture_size=texture_size,
        log_mapper=log_mapper,
    )


def gazebo_terrain(given: str) -> Literal["solid", "heightmap"]:
    """Return what Gazebo's model is to be.

    Raises:
        ConfigError: it is neither.
    """
    terrain: Literal["solid", "heightmap"] = _choice(given, "--terrain", ("solid", "heightmap"))
    return terrain


def mujoco_terrain(given: str) -> ContactGeometry:
    """Return what MuJoCo is to touch.

    Raises:
        ConfigError: it is none of these.
    """
    terrain: ContactGeometry = _choice(given, "--terrain", CONTACT_GEOMETRIES)
    return terrain


def with_build_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options of `build`; its last parameter `options` receives them.

    Logs among its sources are mapped before it sees them.
    """
    own = inspect.signature(command, eval_str=True)
    shared = inspect.signature(build_options, eval_str=True)

    @wraps(command)
    def wrapped(**given: Any) -> Any:
        chosen = {key: given.pop(key) for key in shared.parameters}
        given, options = with_logs_mapped(given, build_options(**chosen))
        return command(**given, options=options)

    parameters = [p for p in own.parameters.values() if p.name != "options"]
    parameters += [_named(p, "mapper" in own.parameters) for p in shared.parameters.values()]
    keywords = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters]
    wrapped.__signature__ = inspect.Signature(keywords)  # type: ignore[attr-defined]
    wrapped.__annotations__ = {p.name: p.annotation for p in keywords}
    del wrapped.__wrapped__
    return wrapped


def _named(option: inspect.Parameter, has_mapper: bool) -> inspect.Parameter:
    """Let a command without a mapper of its own take `--mapper` for the one that maps logs."""
    if option.name != "log_mapper" or has_mapper:
        return option
    return option.replace(annotation=word.LogMapperAlone)


def _choice(given: str, option: str, legal: tuple[Any, ...]) -> Any:
    if given not in legal:
        words = " or ".join((", ".join(legal[:-1]), legal[-1]))
        raise ConfigError(f"{option} must be {words}, got {given!r}")
    return given


def _denoise(wanted: bool, method: str | None) -> Literal["median", "bilateral"] | None:
    """Return the method; naming one asks for it."""
    if method is not None and method not in DENOISE_METHODS:
        raise unknown_name("--denoise-method", method, DENOISE_METHODS)
    if method == "bilateral":
        return "bilateral"
    return "median" if wanted or method else None
