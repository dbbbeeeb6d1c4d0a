"""The commands `list`, `examples` and `doctor`: names for options, sample inputs, the installation."""

from __future__ import annotations

import importlib.metadata
import math
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from click.exceptions import Exit
from rich.markup import escape
from rich.table import Table

from lirs_validation.cli.exit_codes import ExitCode
from lirs_validation.cli.progress import out, say
from lirs_wct.errors import OutputError, unknown_name
from lirs_wct.files import atomic_write
from lirs_wct.option import Options, argument

if TYPE_CHECKING:
    from lirs_envs.robots.robot import Robot

Data = Mapping[str, str]
"""Values by heading."""
FOR_DEVELOPERS = ("dev", "docs")
"""Extras that no command needs."""
BACKENDS = {
    "egl": "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0",
    "osmesa": "apt-get install libosmesa6",
    "glfw": "needs a screen (DISPLAY)",
}
"""OpenGL backends of MuJoCo, and the packages that install them."""
_RENDER = (
    'import mujoco as m; model = m.MjModel.from_xml_string(\'<mujoco><worldbody><geom size=".1"/>'
    "</worldbody></mujoco>'); r = m.Renderer(model, 16, 16); d = m.MjData(model); m.mj_forward(model, d); "
    "r.update_scene(d); assert r.render().any(); r.close()"
)
PICTURE_SECONDS = 60
"""Seconds that a backend may take for a picture."""
EXAMPLES = ("lirs_wct_examples", "examples")
"""Folders of the examples beside the packages: of a wheel, and of a checkout."""


@dataclass(frozen=True, kw_only=True)
class ListOptions(Options):
    """Names that `list` shows."""

    kind: Literal["mappers", "robots", "lidars", "worlds"] = argument(
        "Kind of names.", "mappers|robots|lidars|worlds"
    )
    name: str | None = argument("One of them: all of its data.", "[NAME]", None)


def list_names(options: ListOptions) -> None:
    """List mappers, robots, lidars or bundled worlds: what each needs and is.

    Examples:
    lirs-wct list mappers
    lirs-wct list robots husky
    """
    rows = CATALOGS[options.kind]()
    if options.name is not None and options.name not in rows:
        raise unknown_name(options.kind.removesuffix("s"), options.name, rows)
    if options.name is not None:
        table = Table(title=options.name, show_header=False, title_justify="left")
        data = robot_data(options.name) if options.kind == "robots" else rows[options.name]
        for heading, value in data.items():
            table.add_row(heading, escape(value))
    else:
        table = Table(box=None, pad_edge=False)
        table.add_column(options.kind.removesuffix("s"), no_wrap=True)
        for heading in next(iter(rows.values())):
            table.add_column(heading)
        for name, data in rows.items():
            table.add_row(name, *(escape(value) for value in data.values()))
    out.print(table)
    if options.kind == "mappers":
        say("Your own: --mapper MODULE:CLASS or FILE.py:CLASS; examples/your_own_mapper.py is one.")


def _mappers() -> dict[str, Data]:
    from lirs_envs.lidar.presets import RING_LIDARS
    from slam_baselines.mapper import ALL_CLOUD_MAPPERS, MAPPERS, OWN_CLOUD_MAPPERS, asks_for, make_mapper

    headings = ("estimates", "reads", "needs", "license", "installed")
    rows: dict[str, tuple[str, ...]] = {}
    for name in MAPPERS:
        needs = "any lidar, odometry" if asks_for(make_mapper(name), "requires_odometry") else "any lidar"
        rows[name] = ("planar", "scans, odometry, IMU", needs, "ours", "yes")
    clouds = f"clouds of {' or '.join(RING_LIDARS)}"
    for name, method in ALL_CLOUD_MAPPERS.items():
        installed = "yes" if name in OWN_CLOUD_MAPPERS or method.installed else f"no: {method.install}"
        rows[name] = ("3D", clouds, method.needs or "-", method.license, installed)
    return {name: dict(zip(headings, row, strict=True)) for name, row in rows.items()}


def _robots() -> dict[str, Data]:
    from lirs_envs.robots.robot import ROBOTS

    return {name: _common_data(robot) for name, robot in ROBOTS.items()}


def _common_data(robot: Robot) -> dict[str, str]:
    return {
        "speed": f"{robot.max_speed:g} m/s, {robot.max_turn_rate:g} rad/s",
        "radius": f"{robot.radius:g} m",
        "drives on": f"slopes up to {math.degrees(robot.max_slope):.0f} deg",
        "laser": robot.lidar,
    }


def robot_data(name: str) -> Data:
    """Return all data of a robot."""
    import mujoco

    from lirs_envs.robots.robot import make_robot

    robot = make_robot(name)
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf))
    body, T = model.body("base_link"), robot.T_base_laser
    wheels = len(robot.left_wheels) + len(robot.right_wheels)
    size = f"radius {robot.wheel_radius:g} m, track {robot.track:g} m, wheelbase {robot.wheelbase:g} m"
    return {
        "mass": f"{model.body_mass.sum():.4g} kg, body {float(body.mass[0]):.4g} kg",
        "inertia of the body": " ".join(f"{v:.4g}" for v in body.inertia) + " kg m2",
        "drive": f"{len(robot.rotors)} rotors" if robot.flies else f"{wheels} driven wheels",
        **({} if robot.flies else {"wheels": size}),
        "acceleration": f"{robot.max_acceleration:g} m/s2, {robot.max_turn_acceleration:.3g} rad/s2",
        "base_link": f"{robot.base_height:g} m above ground",
        "friction": f"{robot.friction:g} (slides at {math.degrees(math.atan(robot.friction)):.0f} deg)",
        **_common_data(robot),
        "laser's mount": f"{T.x:g} {T.y:g} {T.z:g} m from base_link",
        "timestep": f"{1e3 * model.opt.timestep:g} ms",
        "model": str(robot.mjcf),
    }


def _lidars() -> dict[str, Data]:
    from lirs_envs.lidar.presets import LIDARS, make_lidar_preset

    lidars = {name: make_lidar_preset(name) for name in LIDARS}
    return {
        name: {
            "beams": f"{lidar.beams}",
            "field of view": f"{math.degrees(lidar.fov):g} deg",
            "rate": f"{lidar.rate:g} Hz",
            "range": f"{lidar.range_min:g} to {lidar.range_max:g} m",
            "noise": f"{1e3 * lidar.sigma:g} mm + {1e3 * lidar.sigma_relative:g} mm/m",
            "rings": f"{lidar.rings}" if lidar.rings > 1 else "-",
        }
        for name, lidar in lidars.items()
    }


def _worlds() -> dict[str, Data]:
    from lirs_wct.sources.bundled import RECIPES, SIZE

    return {
        name: {
            "size": f"{SIZE:g} x {SIZE:g} m",
            "relief of the hills": f"{recipe.relief:g} m",
            "obstacles": f"{recipe.obstacles}",
        }
        for name, recipe in RECIPES.items()
    }


CATALOGS: dict[str, Callable[[], dict[str, Any]]] = {
    "mappers": _mappers,
    "robots": _robots,
    "lidars": _lidars,
    "worlds": _worlds,
}


@dataclass(frozen=True, kw_only=True)
class ExamplesOptions(Options):
    """Folder of `examples`."""

    folder: Path = argument("Folder to copy to.", "[FOLDER]", Path("examples"))


def examples(options: ExamplesOptions) -> None:
    """Copy example inputs (picture, laser map, log) and programs into a folder.

    Examples:
    lirs-wct examples
    """
    beside = Path(__file__).parents[3]
    source = next(beside / name for name in EXAMPLES if (beside / name).is_dir())
    folder = options.folder
    files = {
        folder / path.relative_to(source): path
        for path in sorted(source.rglob("*"))
        if path.is_file() and "__pycache__" not in path.parts
    }
    for copy, path in files.items():
        if copy.exists() and not (copy.is_file() and copy.read_bytes() == path.read_bytes()):
            raise OutputError(f"{copy}: differs from the example; lirs-wct examples FOLDER copies elsewhere")
    for copy, path in files.items():
        with atomic_write(copy) as temporary:
            shutil.copyfile(path, temporary)
    say(f"{folder}: {len(files)} files")
    say(f"next: lirs-wct validate {shlex.quote(str(folder / 'data/office.yaml'))} --robot turtlebot2")


@dataclass(frozen=True)
class InstallationCheck:
    """Finding about one part of the installation, and the command that repairs it.

    The command is empty if nothing needs repair; nothing works without a `needed` part.
    """

    name: str
    found: str
    mend: str = ""
    needed: bool = False


def doctor() -> None:
    """Check the installation (versions, OpenGL, caches, extras) and print repair commands.

    Examples:
    lirs-wct doctor
    """
    checks = list(_checks())
    table = Table(show_header=True, title="lirs-wct doctor", title_justify="left")
    for heading in ("", "what", "found", "how to mend it"):
        table.add_column(heading)
    for check in checks:
        mark = "[green]ok" if not check.mend else "[red]missing" if check.needed else "[yellow]optional"
        table.add_row(mark, escape(check.name), escape(check.found), escape(check.mend))
    out.print(table)
    if any(check.mend and check.needed for check in checks):
        raise Exit(ExitCode.RUN_FAILED)


def _checks() -> Iterator[InstallationCheck]:
    yield InstallationCheck("python", f"{platform.python_version()}, {sys.executable}")
    extras: dict[str, list[str]] = {"": ["lirs-wct"]}  # the empty name: always required
    for requirement in importlib.metadata.requires("lirs-wct") or ():
        package, _, condition = requirement.partition(";")
        extra = condition.replace("'", '"').partition('extra == "')[2].partition('"')[0]
        extras.setdefault(extra, []).append(re.split(r"[^\w.-]", package, maxsplit=1)[0])
    for name in extras.pop(""):
        version = _version(name)
        yield InstallationCheck(name, version or "-", "" if version else "pip install lirs-wct", needed=True)
    yield from _opengl()
    yield from _caches()
    yield from _ray_token()
    for extra in sorted(extras.keys() - FOR_DEVELOPERS):
        found = {name: _version(name) for name in extras[extra]}
        text = ", ".join(f"{name} {version or '-'}" for name, version in found.items())
        mend = "" if all(found.values()) else f"pip install 'lirs-wct[{extra}]'"
        yield InstallationCheck(f"[{extra}]", text, mend)


def _ray_token() -> Iterator[InstallationCheck]:
    """Check the token by which machines of a Ray cluster know each other."""
    if _version("ray") is None:
        return
    mode = os.environ.get("RAY_AUTH_MODE", "")
    path = Path(os.environ.get("RAY_AUTH_TOKEN_PATH") or Path.home() / ".ray" / "auth_token")
    given = bool(os.environ.get("RAY_AUTH_TOKEN")) or path.is_file()
    found = f"RAY_AUTH_MODE={mode or '(not set)'}, {'a token' if given else 'no token'}"
    missing = [] if mode == "token" else ["export RAY_AUTH_MODE=token"]
    missing += [] if given else ["ray get-auth-token --generate, the same file on each machine"]
    yield InstallationCheck("Ray cluster", found, "; ".join(missing))


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _opengl() -> Iterator[InstallationCheck]:
    """Draw a picture with each backend; only pictures of the simulation need one."""
    for backend, mend in BACKENDS.items():
        works = _draws(backend)
        found = "draws" if works else "no picture"
        yield InstallationCheck(f"OpenGL by {backend}", found, "" if works else mend)


def _draws(backend: str) -> bool:
    command, environment = [sys.executable, "-c", _RENDER], os.environ | {"MUJOCO_GL": backend}
    with suppress(OSError, subprocess.TimeoutExpired):
        run = subprocess.run(command, env=environment, capture_output=True, timeout=PICTURE_SECONDS)
        return run.returncode == 0
    return False


def _caches() -> Iterator[InstallationCheck]:
    """Check the caches of compiled kernels, without which each start compiles, and of worlds."""
    from lirs_envs.episodes.world_cache import cache_folder

    set_by_user = os.environ.get("NUMBA_CACHE_DIR")
    package = Path(__file__).parents[3] / "lirs_wct" / "__pycache__"
    kernels = [Path(set_by_user)] if set_by_user else [package, Path.home() / ".cache" / "numba"]
    worlds = cache_folder()
    if worlds is None:
        yield InstallationCheck("world cache", "switched off (LIRS_WCT_CACHE is empty)")
    for name, variable, folders in (
        ("numba cache", "NUMBA_CACHE_DIR", kernels),
        ("world cache", "LIRS_WCT_CACHE", [] if worlds is None else [worlds]),
    ):
        usable = next((str(folder) for folder in folders if _writable(folder)), "")
        if usable:
            yield InstallationCheck(name, usable)
        elif folders:
            mend = f"set {variable} to a folder that can be written"
            yield InstallationCheck(name, f"{folders[0]}: cannot be written", mend)


def _writable(folder: Path) -> bool:
    """Whether a folder, or its nearest existing parent, is writable."""
    there = next((place for place in (folder, *folder.parents) if place.exists()), folder)
    try:
        with tempfile.TemporaryFile(dir=there):
            return True
    except OSError:
        return False
