"""Commands about sources: `build`, `info`, `map`, `convert`, `gui`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from click.exceptions import Exit

import lirs_wct
from lirs_validation.cli.command import SOURCE_HELP, OneSource, common, complete_source, map_logs
from lirs_validation.cli.exit_codes import ExitCode
from lirs_validation.cli.progress import err, out, progress_bar, say
from lirs_validation.config import LogOptions, MapConfig
from lirs_wct.ground import RotationOptions
from lirs_wct.option import Options, argument, option, within
from lirs_wct.sources.source import BuildOptions, find_source, is_log

if TYPE_CHECKING:
    from rich.table import Table

    from lirs_validation.record.map_record import MapRecord

MESHES = {"dae", "stl", "obj", "glb", "usd"}
"""Mesh formats of `--to`."""
_SCALE = ("size", "height", "resolution", "window", "invert", "wall_height", "kind")


@dataclass(frozen=True, kw_only=True)
class BuildCommand(OneSource):
    """Source and files of `build`."""

    output: Path = option(Path("worlds"), "Folder for the world's folder.")
    to: tuple[str, ...] = option(
        ("dae", "stl", "sdf", "mjcf"),
        "Files to write: dae, stl, sdf, mjcf, obj, hfield, glb, usd, map.",
        metavar="F,F,...",
    )
    terrain: Literal["solid", "heightmap"] = option(
        "solid", "Gazebo's model: the solid mesh, or a heightmap (square, 2^n + 1 px, 8 bit)."
    )


@dataclass(frozen=True, kw_only=True)
class InfoCommand(OneSource):
    """Source and picture of `info`."""

    output: Path | None = option(None, "PNG to draw; default: no picture.", metavar="PICTURE.png")
    robot: str = option("husky", "Robot whose lidar the forecast uses.", metavar="R")


@dataclass(frozen=True, kw_only=True)
class LogInOut(Options):
    """Log and results of a command."""

    log: str = argument("CARMEN log (.clf, .log, gzipped or not) or ROS bag.", "LOG")
    output: Path = option(Path("out"), "Folder for the result's folder.")


@dataclass(frozen=True, kw_only=True)
class ConvertCommand(Options):
    """Meshes of `convert`."""

    source: Path = argument("Mesh: stl, dae, obj, ply, glb.", "IN")
    target: Path = argument("Mesh in another of these formats.", "OUT")


@dataclass(frozen=True, kw_only=True)
class GuiOptions(Options):
    """Source, runs and address of `gui`."""

    source: str | None = argument(f"Shown first: {SOURCE_HELP}", "[SOURCE]", None, complete=complete_source)
    runs: Path = option(Path("out"), "Folder of finished runs, or one run's, that pages may replay.")
    port: int = option(8080, "Port to listen at; 0 = any free one.", check=within("[0, 65535]"))
    host: str = option(
        "127.0.0.1",
        "Address to listen at; 0.0.0.0 = every network that this machine is in.",
        metavar="ADDRESS",
    )


@common(*_SCALE, "output", "to", "name", "max_error", "texture")
def build(options: BuildCommand, world_options: BuildOptions) -> None:
    """Build a world: Gazebo model and world, MuJoCo MJCF, meshes, texture, world.json.

    Examples:
    lirs-wct build examples/data/dunes.png --size 30 --height 2.5 -o worlds/
    lirs-wct build examples/data/office.yaml --wall-height 2 --to mjcf -o worlds/
    """
    from lirs_wct.export.package import opening_lines, write_package

    (source,), world_options = map_logs([options.source], world_options, options.output)
    with progress_bar(source) as progress:
        progress("build", 0.0)
        world = lirs_wct.build_world(source, world_options)
        folder = write_package(
            world,
            options.output,
            formats=options.to,
            terrain=options.terrain,
            overwrite=world_options.name is not None,
            progress=progress,
        )
    width, depth = world.surface.size
    say(f"{folder}: {world.kind}, {width:g} x {depth:g} m, relief {world.surface.relief:.2f} m")
    budget = world.file_options.max_error
    if budget is not None and world.file_options != world.export_options and MESHES & {*options.to}:
        say(
            f"mesh files: {len(world.file_mesh.faces)} triangles within {1000 * budget:.3g} mm of the "
            "height field everywhere; --max-error 0 keeps all"
        )
    if not world.spawn_poses:
        say("start poses: none, no robot on wheels fits")
    for line in opening_lines(folder, options.to):
        say(line)


@common("robot", *_SCALE, "output", "scan_topic", "odom_topic", "range_max", "time")
def info(
    options: InfoCommand,
    given: Annotated[dict[str, Any], LogOptions],
    build: Annotated[BuildOptions, (*_SCALE, "start", "scale", "z_scale", "up")],
) -> None:
    """Print facts of a world (size, slopes, walls) or of a log (rates, frames, faults).

    Examples:
    lirs-wct info examples/data/office.yaml --robot turtlebot2 -o office.png
    lirs-wct info examples/data/office.clf.gz
    """
    from lirs_envs.robots.robot import make_robot
    from lirs_validation.metrics.world_geometry import ground_facts, measured_facts
    from lirs_wct.drawing.pictures import view_figure
    from lirs_wct.files import atomic_write

    source, robot, output = options.source, options.robot, options.output
    if is_log(Path(source)):
        from lirs_validation.logs.map_log import check_log_file

        with err.status(f"reading {source}"):
            found = check_log_file(source, **given)
        table = _facts_table(source, found.facts)
        for row in found.notes:
            table.add_row(*row, style="yellow")
        out.print(table)
        say(f"{source}: {found.sentence}")
        return
    make_robot(robot)
    with err.status(f"measuring {source}"):
        world = lirs_wct.build_world(source, build)
        facts = *ground_facts(world), *measured_facts(world, robot)
    out.print(_facts_table(f"{world.name}: {world.kind}, {world.scale}", facts))
    if output is not None:
        with atomic_write(output) as path:
            view_figure(world).savefig(path, format="png")
        say(output)


@common(
    *("mapper", "output", "relations", "reference", "second", "resolution", "range_max", "fov"),
    *("seed", "imu", "scan_topic", "odom_topic", "time"),
)
def map_log(options: LogInOut, given: Annotated[dict[str, Any], MapConfig]) -> None:
    """Map a laser log: map.pgm and map.yaml for ROS, path, picture and accuracy.

    Examples:
    lirs-wct map examples/data/office.clf.gz --mapper gmapping -o out/
    """
    from lirs_validation.logs.map_log import run_mapping

    config = MapConfig(log=options.log, **given)
    with progress_bar(options.log) as progress:
        mapped = run_mapping(config, out=options.output, progress=progress)
    out.print(_figures_table(mapped.record))
    say(mapped.folder)
    if mapped.record.wheels:
        say(mapped.record.wheels)
    say(f"verdict: {mapped.record.verdict}")
    if mapped.record.status != "ok":
        raise Exit(ExitCode.RUN_FAILED)


def convert(options: ConvertCommand, rotation: RotationOptions) -> None:
    """Convert a mesh between stl, dae, obj, ply and glb.

    The up direction stays; dae, obj and glb keep the texture.

    Examples:
    lirs-wct convert terrain.stl terrain.dae
    """
    from lirs_wct.export.mesh_writer import convert_mesh

    source, target = options.source, options.target
    with err.status(f"converting {source}"):
        mesh = convert_mesh(source, target, rotation.rotate_x)
    closed = "watertight" if mesh.is_watertight else "not watertight"
    say(f"{target}: {len(mesh.faces)} triangles, {closed}")


def gui(options: GuiOptions) -> None:
    """Build worlds, drive robots and replay runs in a browser; ends with Ctrl-C.

    Examples:
    lirs-wct gui medium --port 8080
    """
    if find_spec("viser") is None:
        raise lirs_wct.ConfigError("the live page needs viser: pip install 'lirs-wct[gui]'")
    from lirs_validation.gui.server import Server

    if options.source is not None:
        find_source(options.source, BuildOptions())
    runs = options.runs if options.runs.is_dir() else None
    server = Server(options.source, runs=runs, host=options.host, port=options.port)
    say(f"{server.address}: open it in a browser, Ctrl-C ends it")
    server.serve()


def _facts_table(title: str, facts: Iterable[tuple[str, str]]) -> Table:
    from rich.table import Table

    table = Table(title=title, show_header=False, title_justify="left")
    for row in facts:
        table.add_row(*row)
    return table


def _figures_table(record: MapRecord) -> Table:
    """Return the metrics and repairs of a mapped log as a table to print."""
    from rich.table import Table

    from lirs_validation.record.map_record import map_lines, repair_lines
    from lirs_validation.record.metric_catalog import WORSE

    table = Table(title=record.config.log, show_header=False, title_justify="left")
    for name, value in map_lines(record):
        table.add_row(name, value, style="yellow" if value == WORSE else "")
        if name == "status" and record.reason:
            table.add_row("", record.reason, style="yellow")
    for name, value in repair_lines(record):
        table.add_row(name, value, style="yellow")
    return table
