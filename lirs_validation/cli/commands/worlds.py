"""Commands about worlds: `build`, `info`, `convert`."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lirs_validation.cli.progress import err, out, progress_bar
from lirs_validation.cli.typer_options import Source, gazebo_terrain, typer_option
from lirs_validation.config import SourceOptions
from lirs_validation.map_config import LogOptions
from lirs_wct.meshing.export_options import DEFAULT_SHARE, ExportOptions
from lirs_wct.option import read_names

if TYPE_CHECKING:
    from lirs_wct.world import World

MESHES = {"dae", "stl", "obj", "glb", "usd"}
"""Mesh formats of `--to`."""


Formats = Annotated[
    str,
    typer.Option(metavar="F,F,...", help="Files to write: dae, stl, sdf, mjcf, obj, hfield, glb, usd, map."),
]
GazeboModel = Annotated[
    str,
    typer.Option(
        metavar="solid|heightmap",
        help="Gazebo's model: the solid mesh, or a heightmap (square, 2^n + 1 px, 8 bit).",
    ),
]
MapHeight = Annotated[
    float | None, typer.Option(metavar="METERS", show_default="0.3", help="Height of the lidar for --to map.")
]


def build(
    source: Source,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the world's folder.")] = Path(
        "worlds"
    ),
    to: Formats = "dae,stl,sdf,mjcf",
    terrain: GazeboModel = "solid",
    map_height: MapHeight = None,
    *,
    options: SourceOptions,
) -> None:
    """Build a world: Gazebo model and world, MuJoCo MJCF, meshes, texture, world.json."""
    from lirs_wct.export.ground_truth_map import ROBOT_HEIGHT
    from lirs_wct.export.package import write_package
    from lirs_wct.sources.build import build_world

    if map_height is not None and "map" not in read_names(to, "--to"):
        warnings.warn("--map-height has no effect without --to map", stacklevel=1)

    with progress_bar(source, err) as progress:
        progress("build", 0.0)
        world = build_world(source, options)
        folder = write_package(
            world,
            output,
            formats=read_names(to, "--to"),
            terrain=gazebo_terrain(terrain),
            overwrite=options.name is not None,
            map_height=ROBOT_HEIGHT if map_height is None else map_height,
            progress=progress,
        )
    _say_what_was_built(world, folder, to)


def info(
    source: Source,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="PNG to draw; default: no picture.")
    ] = None,
    robot: Annotated[str, typer.Option(metavar="R", help="Robot whose lidar the forecast uses.")] = "husky",
    *,
    given: Annotated[dict[str, Any], LogOptions],
    world_options: SourceOptions,
) -> None:
    """Print facts of a world (size, slopes, walls) or of a log (rates, frames, faults)."""
    from lirs_envs.robots.robot import make_robot
    from lirs_validation.cli.commands.info import facts_table, preflight_table, world_facts
    from lirs_wct.drawing.world_view import view_figure
    from lirs_wct.files import atomic_write
    from lirs_wct.sources.build import build_world
    from lirs_wct.sources.source import is_log

    if is_log(Path(source)):
        from lirs_validation.logs.map_log import check_log_file

        with err.status(f"reading {source}"):
            found = check_log_file(source, **given)
        out.print(preflight_table(source, found))
        out.print(f"{source}: {found.sentence}", soft_wrap=True, highlight=False, markup=False)
        return
    make_robot(robot)
    with err.status(f"measuring {source}"):
        world = build_world(source, world_options)
        facts = world_facts(world, robot)
    out.print(facts_table(world, facts))
    if output is not None:
        with atomic_write(output) as path:
            view_figure(world).savefig(path, format="png")
        out.print(f"{output}", soft_wrap=True, highlight=False)


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="Mesh: stl, dae, obj, ply, glb.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="Mesh in another of these formats.")],
    rotate_x: Annotated[float, typer_option(ExportOptions, "rotate_x")] = 0.0,
) -> None:
    """Convert a mesh between stl, dae, obj, ply and glb.

    The up direction stays; dae, obj and glb keep the texture.
    """
    from lirs_wct.export.mesh_writer import convert_mesh

    with err.status(f"converting {source}"):
        mesh = convert_mesh(source, target, rotate_x)
    closed = "watertight" if mesh.is_watertight else "not watertight"
    out.print(f"{target}: {len(mesh.faces)} triangles, {closed}", soft_wrap=True, highlight=False)


def _say_what_was_built(world: World, folder: Path, to: str) -> None:
    width, depth = world.surface.size
    out.print(f"{folder}: {world.kind}, {width:g} x {depth:g} m, relief {world.surface.relief:.2f} m")
    budget = world.file_options.max_error
    if (
        budget is not None
        and world.file_options != world.export_options
        and MESHES & {*read_names(to, "--to")}
    ):
        relief = world.surface.relief
        share = (
            f"{DEFAULT_SHARE:.1%} of the relief" if budget <= DEFAULT_SHARE * relief else "1e-6 of the side"
        )
        out.print(
            f"mesh files: {len(world.file_mesh.faces)} triangles within {1000 * budget:.3g} mm of the "
            f"height field everywhere, {share}; --max-error 0 keeps all",
            soft_wrap=True,
            highlight=False,
        )
    if not world.spawn_poses:
        out.print("start poses: none, no robot on wheels fits", highlight=False)
