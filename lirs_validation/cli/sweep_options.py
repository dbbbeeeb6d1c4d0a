"""The options of `validate`, and the experiments that they ask for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from lirs_validation.cli.arguments import read_drivers, read_names, read_seeds
from lirs_validation.cli.typer_options import mujoco_terrain
from lirs_validation.config import ATTITUDES, THREADS, TOUR, SourceOptions
from lirs_wct.errors import ConfigError
from lirs_wct.formats.rosbag.library import STORAGES
from lirs_wct.sources.option_text import chosen

if TYPE_CHECKING:
    from lirs_validation.sweep.experiment import Experiment

DEFAULT_SECONDS = 120.0
AXES, ENGINE = "Axes of a sweep: every combination is run", "How a sweep is run"
BAGS = "ROS 2 bags (no ROS needed)"

Robots = Annotated[
    str | None,
    typer.Option("--robot", metavar="R,R,...", show_default="husky", help="Robots.", rich_help_panel=AXES),
]
Mappers = Annotated[
    str | None,
    typer.Option(
        "--mapper",
        metavar="M,M,...",
        show_default="hector",
        help="SLAM methods (lirs-wct mappers lists them); module:Class for your own.",
        rich_help_panel=AXES,
    ),
]
Lidars = Annotated[
    str | None,
    typer.Option(
        "--lidar", metavar="L,L,...", show_default="the robot's own", help="Lidars.", rich_help_panel=AXES
    ),
]
Terrains = Annotated[
    str | None,
    typer.Option(
        "--terrain",
        metavar="hfield|mesh|prisms|convex",
        show_default="hfield",
        help="Geometry used for contacts: a height field; the same, and rays meet the mesh; a prism for each "
        "triangle within --max-error; the convex parts of a closed mesh, or its faces where they are many.",
        rich_help_panel=AXES,
    ),
]
RayKinds = Annotated[
    str | None,
    typer.Option(
        "--rays",
        metavar="builtin|mujoco",
        show_default="builtin",
        help="Ray caster of the lidar (builtin = ours); MuJoCo's for comparison.",
        rich_help_panel=AXES,
    ),
]
Attitudes = Annotated[
    str | None,
    typer.Option(
        "--attitude",
        metavar="imu|none",
        show_default="imu",
        help="What mappers are told of roll and pitch: the IMU's readings, or none, as planar SLAM has them.",
        rich_help_panel=AXES,
    ),
]
Drivers = Annotated[
    str | None,
    typer.Option(
        "--driver",
        metavar="tour|frontier|waypoints:FILE|replay:RUN",
        show_default="tour",
        help="Who drives: a tour over the true ground; an explorer that sees the mapper's map and pose; "
        "waypoints (x, y[, yaw] a line) by the true pose; the commands of a finished run again.",
        rich_help_panel=AXES,
    ),
]
Actors = Annotated[
    str | None,
    typer.Option(
        "--actors",
        metavar="N,N,...",
        show_default="0",
        help="Walkers on seeded paths, whom the lidar sees and the robot touches.",
        rich_help_panel=AXES,
    ),
]
Threads = Annotated[
    str | None,
    typer.Option(
        "--threads",
        metavar="1|2|1,2",
        show_default="1",
        help="Threads of a drive. With 2 the mapper has a process of its own: the same results sooner.",
        rich_help_panel=AXES,
    ),
]
Seeds = Annotated[
    str | None,
    typer.Option(metavar="1-5|1,3,7-9", help="Several seeds of every random number.", rich_help_panel=AXES),
]
Seed = Annotated[
    int | None, typer.Option(show_default="1", help="One seed of every random number.", rich_help_panel=AXES)
]
SuiteName = Annotated[
    str | None,
    typer.Option("--suite", metavar="paper", help="A published experiment, instead of sources and axes."),
]
Seconds = Annotated[
    float | None, typer.Option(show_default="120", help="Simulated seconds to drive in each run.")
]
WallLimit = Annotated[
    float | None,
    typer.Option(
        metavar="S", help="Stop a drive after so many wall seconds; its RTF is extrapolated and marked so."
    ),
]
EngineName = Annotated[
    str | None,
    typer.Option(
        "--engine",
        metavar="serial|processes|ray",
        show_default="serial",
        help="Where runs take place. With anything beside it, a run's RTF is marked as concurrent.",
        rich_help_panel=ENGINE,
    ),
]
Jobs = Annotated[
    int | None,
    typer.Option(metavar="N", help="Runs at a time, in processes of their own.", rich_help_panel=ENGINE),
]
Address = Annotated[
    str | None,
    typer.Option(help="Address of a Ray cluster; default: start a local one.", rich_help_panel=ENGINE),
]
CellTimeout = Annotated[
    float | None,
    typer.Option(metavar="S", help="End a run after so many wall seconds in all.", rich_help_panel=ENGINE),
]
CellMemory = Annotated[
    float | None,
    typer.Option(metavar="GB", help="End a run that takes more memory.", rich_help_panel=ENGINE),
]
Bag = Annotated[
    bool,
    typer.Option(
        "--bag", help="Record each run as a ROS 2 bag, which its folder then is, too.", rich_help_panel=BAGS
    ),
]
StorageName = Annotated[
    str | None,
    typer.Option(
        "--storage",
        metavar="mcap|sqlite3",
        show_default="mcap",
        help="How bags store their messages.",
        rich_help_panel=BAGS,
    ),
]
SensorsOnly = Annotated[
    bool,
    typer.Option(
        "--sensors-only",
        help="Bags without map -> odom and /map: the SLAM that they feed gives them.",
        rich_help_panel=BAGS,
    ),
]
RetryFailed = Annotated[
    bool, typer.Option("--retry-failed", help="Run again what failed before.", rich_help_panel=ENGINE)
]


def read_experiments(
    sources: list[str] | None,
    suite: str | None,
    axes: Mapping[str, str | None],
    seeds: tuple[int, ...] | None,
    seconds: float | None,
    wall_limit: float | None,
    threads: tuple[int, ...],
    build: SourceOptions,
) -> tuple[Experiment, ...]:
    """Return the experiments of a suite, or at the crossings of axes.

    Args:
        sources: worlds; none with a suite.
        suite: its name; None = sources and axes are given.
        axes: axis -> what was said of it, for `robot`, `mapper`, `lidar`, `terrain`, `rays`, `attitude`,
            `driver` and `actors`.
        seeds: None = the suite's own, or 1.
        seconds: simulated seconds of each run; None = the suite's own, or 120.
        wall_limit: of each drive; None = the suite's own, or none.
        threads: of a drive, with a suite too.
        build: how sources become worlds.

    Raises:
        ConfigError: neither or both were asked for, or what was asked for is not legal.
    """
    if suite is not None:
        others = {f"--{axis}": said is not None for axis, said in axes.items()}
        others |= {"sources": bool(sources), "options of build": build != SourceOptions()}
        return _suite_experiments(suite, others, seeds, seconds, wall_limit, threads)
    if not sources:
        raise ConfigError("nothing to validate: name a source (simple, a picture, a map, ...) or a --suite")
    return _axes_experiments(sources, axes, seeds, seconds, wall_limit, threads, build)


def recorded(
    experiments: Sequence[Experiment], *, bag: bool, storage: str | None, sensors_only: bool
) -> tuple[Experiment, ...]:
    """Return the experiments with their runs recorded as bags, where that is asked for.

    Raises:
        ConfigError: there is no such storage, or something is said of bags, and none asked for.
    """
    from lirs_validation.sweep.slam_experiment import SlamExperiment

    if not bag:
        if storage is not None or sensors_only:
            raise ConfigError(
                f"{'--storage' if storage else '--sensors-only'} is an option of bags: give --bag"
            )
        return tuple(experiments)
    stored = chosen(storage or STORAGES[0], "--storage", STORAGES)
    return tuple(
        replace(each, config=replace(each.config, bag=stored, sensors_only=sensors_only))
        if isinstance(each, SlamExperiment)
        else each
        for each in experiments
    )


def read_threads(text: str | None) -> tuple[int, ...]:
    """Return numbers of threads of a drive, each once; 1 where nothing is said.

    Raises:
        ConfigError: one is not 1 or 2.
    """
    names = ("1",) if text is None else read_names(text, "--threads")
    legal = tuple(map(str, THREADS))
    return tuple(dict.fromkeys(int(chosen(name, "--threads", legal)) for name in names))


def read_seed_options(seed: int | None, seeds: str | None) -> tuple[int, ...] | None:
    """Return the seeds; None = not said.

    Raises:
        ConfigError: both options are given, or they are no seeds.
    """
    if seed is not None and seeds is not None:
        raise ConfigError("both name seeds: give one of --seed, --seeds")
    if seeds is not None:
        return read_seeds(seeds)
    return None if seed is None else (seed,)


def _axes_experiments(
    sources: list[str],
    given: Mapping[str, str | None],
    seeds: tuple[int, ...] | None,
    seconds: float | None,
    wall_limit: float | None,
    threads: tuple[int, ...],
    build: SourceOptions,
) -> tuple[Experiment, ...]:
    """Return the experiments at the crossings of the axes that were given (see `read_experiments`)."""
    from lirs_envs.lidar.casters import ALIASES, RAYS, resolve_rays
    from lirs_validation.sweep.axes import Axes, Representation

    terrains = [mujoco_terrain(name) for name in _names(given, "terrain", "hfield")]
    names = _names(given, "rays", "builtin")
    if not set(names) <= {*RAYS, *ALIASES}:
        raise ConfigError(f"--rays must be {' or '.join(RAYS)}, got {given['rays']!r}")
    rays = dict.fromkeys(map(resolve_rays, names))
    return Axes(
        sources=tuple(sources),
        robots=_names(given, "robot", "husky"),
        mappers=_names(given, "mapper", "hector"),
        lidars=(None,) if given["lidar"] is None else read_names(given["lidar"], "--lidar"),
        representations=tuple(
            Representation(terrain=terrain, rays=ray) for terrain in terrains for ray in rays
        ),
        attitudes=tuple(chosen(name, "--attitude", ATTITUDES) for name in _names(given, "attitude", "imu")),
        drivers=(TOUR,) if given.get("driver") is None else read_drivers(str(given["driver"])),
        actors=(0,) if given.get("actors") is None else read_seeds(str(given["actors"]), "--actors"),
        seeds=seeds or (1,),
        seconds=DEFAULT_SECONDS if seconds is None else seconds,
        wall_limit=wall_limit,
        threads=threads,
        build=build,
    ).experiments()


def _suite_experiments(
    name: str,
    others: Mapping[str, bool],
    seeds: tuple[int, ...] | None,
    seconds: float | None,
    wall_limit: float | None,
    threads: tuple[int, ...],
) -> tuple[Experiment, ...]:
    """Return the experiments of a suite; `others` are the options that it leaves no room for."""
    from lirs_validation.sweep.suites import suite_named

    suite = suite_named(name)
    clash = [option for option, given in others.items() if given]
    if clash:
        raise ConfigError(f"--suite {name} has its own worlds and axes: leave out {', '.join(clash)}")
    return suite.experiments(seconds=seconds, seeds=seeds, wall_limit=wall_limit, threads=threads)


def _names(given: Mapping[str, str | None], axis: str, default: str) -> tuple[str, ...]:
    said = given.get(axis)
    return (default,) if said is None else read_names(said, f"--{axis}")
