"""The options of `validate` in words."""

from __future__ import annotations

from typing import Annotated

import typer

AXES, ENGINE = "Axes of a sweep: every combination is run", "How a sweep is run"

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
        help="SLAM methods; module:Class for your own.",
        rich_help_panel=AXES,
    ),
]
Lidars = Annotated[
    str | None,
    typer.Option(
        "--lidar", metavar="L,L,...", show_default="the robot's own", help="LRFs.", rich_help_panel=AXES
    ),
]
Terrains = Annotated[
    str | None,
    typer.Option(
        "--terrain",
        metavar="hfield|mesh|prisms|convex",
        show_default="hfield",
        help="What MuJoCo touches: a height field; the same, and the mesh is seen; a prism for each "
        "triangle within --max-error; the convex parts of a closed mesh.",
        rich_help_panel=AXES,
    ),
]
RayKinds = Annotated[
    str | None,
    typer.Option(
        "--rays",
        metavar="builtin|mujoco",
        show_default="builtin",
        help="Whose rays the lidar takes (builtin = ours); MuJoCo's for comparison.",
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
    str | None, typer.Option(help="Of a Ray cluster; default: one of its own.", rich_help_panel=ENGINE)
]
CellTimeout = Annotated[
    float | None,
    typer.Option(metavar="S", help="End a run after so many wall seconds in all.", rich_help_panel=ENGINE),
]
CellMemory = Annotated[
    float | None,
    typer.Option(metavar="GB", help="End a run that takes more memory.", rich_help_panel=ENGINE),
]
RetryFailed = Annotated[
    bool, typer.Option("--retry-failed", help="Run again what failed before.", rich_help_panel=ENGINE)
]
