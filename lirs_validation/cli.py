"""The command line: `lirs-wct build | validate | view | info | convert | robot`."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from typer.exceptions import TyperException

from lirs_validation.build_options import gazebo_terrain, mujoco_terrain, with_build_options
from lirs_validation.option_words import RotateX
from lirs_validation.robot_card import robot
from lirs_wct.errors import WctError
from lirs_wct.options import BuildOptions

RUN_FAILED, BAD_INPUT, INTERRUPTED = 3, 2, 130

if TYPE_CHECKING:
    from lirs_validation.run import Run
    from lirs_wct.world import World

app = typer.Typer(
    name="lirs-wct",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Turn a picture, a laser map or a mesh into a world, drive it with SLAM running, judge the result.",
)
app.command()(robot)
out, err = Console(), Console(stderr=True)

Sources = Annotated[
    list[str],
    typer.Argument(help="simple, medium, advanced, a picture, a map YAML, a mesh or a built folder."),
]
Source = Annotated[str, typer.Argument(help=Sources.__metadata__[0].help)]


@app.command()
@with_build_options
def build(
    source: Source,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the world's folder.")] = Path(
        "worlds"
    ),
    to: Annotated[
        str, typer.Option(metavar="F,F,...", help="What to write: dae, stl, sdf, mjcf, obj, hfield.")
    ] = "dae,stl,sdf,mjcf",
    terrain: Annotated[
        str,
        typer.Option(
            metavar="solid|heightmap",
            help="Gazebo's model: the solid mesh, or a heightmap (square, 2^n + 1 px, 8 bit).",
        ),
    ] = "solid",
    *,
    options: BuildOptions,
) -> None:
    """Build a world: Gazebo model and world, MuJoCo MJCF, meshes, texture, world.json."""
    from lirs_wct.package import write_package
    from lirs_wct.world import build_world

    formats = [word.strip() for word in to.split(",") if word.strip()]
    with err.status(f"building {source}") as status:
        world = build_world(source, options)
        folder = write_package(
            world,
            output,
            formats=formats,
            terrain=gazebo_terrain(terrain),
            report=lambda name: status.update(f"{source}: writing {name}"),
        )
    width, depth = world.surface.size
    out.print(f"{folder}: {world.kind}, {width:g} x {depth:g} m, relief {world.surface.relief:.2f} m")


@app.command()
@with_build_options
def validate(
    sources: Sources,
    robot: Annotated[str, typer.Option(help="Robot that drives.")] = "husky",
    mapper: Annotated[str, typer.Option(help="SLAM method that maps.")] = "hector",
    lidar: Annotated[str | None, typer.Option(help="LRF preset; default: the robot's own.")] = None,
    terrain: Annotated[
        str,
        typer.Option(
            metavar="hfield|mesh|prisms|convex",
            help="What MuJoCo touches: a height field; the same, and the mesh is seen; a prism for each "
            "triangle within --max-error; the convex parts of a closed mesh.",
        ),
    ] = "hfield",
    seconds: Annotated[float, typer.Option(help="Simulated seconds to drive.")] = 120.0,
    seed: Annotated[int, typer.Option(help="Seed of every random number.")] = 1,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the runs' folders.")] = Path(
        "out"
    ),
    *,
    options: BuildOptions,
) -> None:
    """Drive a robot through worlds with SLAM running, and judge map, path and speed."""
    from lirs_validation.progress import run_with_progress
    from lirs_validation.record import RunConfig
    from lirs_validation.report.table import results_table

    configs = [
        RunConfig(
            source=source,
            robot=robot,
            mapper=mapper,
            lidar=lidar,
            terrain=mujoco_terrain(terrain),
            seconds=seconds,
            seed=seed,
            build=options,
        )
        for source in sources
    ]
    runs: list[Run] = []
    try:
        runs.extend(run_with_progress(configs, output, err))
    finally:
        if runs:
            out.print(results_table([run.record for run in runs]))
        for run in runs:
            out.print(f"{run.folder}", soft_wrap=True, highlight=False)
    if any(run.record.status != "ok" for run in runs):
        raise typer.Exit(RUN_FAILED)


@app.command()
@with_build_options
def view(
    source: Source,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="PNG to write; default: NAME-view.png here.")
    ] = None,
    *,
    options: BuildOptions,
) -> None:
    """Draw a picture of any source: hillshade, walls, start poses. No OpenGL needed."""
    from lirs_wct.world import build_world

    with err.status(f"drawing {source}"):
        world = build_world(source, options)
    _draw(world, output or Path(f"{world.name}-view.png"))


@app.command()
@with_build_options
def info(
    source: Source,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="PNG to draw; default: no picture.")
    ] = None,
    *,
    options: BuildOptions,
) -> None:
    """Say what a source is: size, heights, slopes, where robots can drive, triangles, error."""
    from lirs_validation.info import facts_table, world_facts
    from lirs_wct.world import build_world

    with err.status(f"measuring {source}"):
        world = build_world(source, options)
        facts = world_facts(world)
    out.print(facts_table(world, facts))
    if output is not None:
        _draw(world, output)


@app.command()
def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="Mesh: stl, dae, obj, ply, glb.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="Mesh in another of these formats.")],
    rotate_x: RotateX = 0.0,
) -> None:
    """Convert a mesh between stl, dae, obj, ply and glb; up stays up."""
    from lirs_wct.formats.mesh_file import read_upright, write_mesh

    with err.status(f"converting {source}"):
        mesh = read_upright(source)
        write_mesh(target, mesh.rotated_x(rotate_x) if rotate_x else mesh)
    closed = "watertight" if mesh.is_watertight else "not watertight"
    out.print(f"{target}: {len(mesh.faces)} triangles, {closed}", soft_wrap=True, highlight=False)


def _draw(world: World, target: Path) -> None:
    from lirs_validation.report.view import view_figure
    from lirs_wct.files import atomic_write

    with atomic_write(target) as path:
        view_figure(world).savefig(path, format="png")
    out.print(f"{target}", soft_wrap=True, highlight=False)


def main() -> None:
    """Run the command line; bad input is one line on stderr and exit code 2."""
    warnings.showwarning = _one_line
    try:
        code = app(standalone_mode=False)
        if code == INTERRUPTED:
            # Typer turns Ctrl-C into its exit code, and says nothing.
            raise KeyboardInterrupt
    except WctError as error:
        _fail(str(error))
    except TyperException as error:
        _fail(error.format_message())
    except (typer.Abort, KeyboardInterrupt):
        _fail("interrupted; nothing half-written was left", INTERRUPTED)
    except SystemError as error:
        # Ctrl-C inside a compiled kernel comes out wrapped.
        if not any(isinstance(cause, KeyboardInterrupt) for cause in _causes(error)):
            raise
        _fail("interrupted; nothing half-written was left", INTERRUPTED)
    sys.exit(code if isinstance(code, int) else 0)


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _fail(message: str, code: int = BAD_INPUT) -> None:
    err.print(f"lirs-wct: {message}", markup=False, highlight=False, soft_wrap=True, style="red")
    sys.exit(code)


def _one_line(message: Warning | str, *_: Any, **__: Any) -> None:
    err.print(f"lirs-wct: {message}", markup=False, highlight=False, soft_wrap=True, style="yellow")
