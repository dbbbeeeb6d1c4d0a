"""The options of `build` in words: names, help texts and panels, by theme."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

TERRAIN, FILTERS, MAP, MESH = "Terrain pictures", "Picture filters", "Laser maps", "Mesh files"

Name = Annotated[str | None, typer.Option(help="Name of the world; default: the file's.")]
Kind = Annotated[
    str | None,
    typer.Option("--as", metavar="picture|map", help="Read a picture as terrain or as laser map."),
]
Window = Annotated[
    str | None, typer.Option(metavar="X,Y,SIDE", help="Keep only this square of the world, metres.")
]
MaxPixels = Annotated[int, typer.Option(help="Refuse larger pictures before decoding them.")]

Size = Annotated[
    str | None,
    typer.Option(
        metavar="W[,H]",
        help="Extent in metres: longer side, or width and height. Default 50, or the file's own.",
        rich_help_panel=TERRAIN,
    ),
]
PixelSize = Annotated[
    float | None, typer.Option(help="Metres a pixel, instead of --size.", rich_help_panel=TERRAIN)
]
Height = Annotated[
    float | None,
    typer.Option(
        help="Metres from the darkest to the brightest pixel. Default 6, or the file's own.",
        rich_help_panel=TERRAIN,
    ),
]
ZScale = Annotated[
    float | None,
    typer.Option(help="Multiply the heights that the rest gives.", rich_help_panel=TERRAIN),
]
Scale = Annotated[
    str | None,
    typer.Option(
        metavar="S or SX,SY,SZ",
        help="Multiply width, depth and height that the rest gives.",
        rich_help_panel=TERRAIN,
    ),
]
Grayscale = Annotated[
    bool, typer.Option("--grayscale", help="Turn a colour picture into gray.", rich_help_panel=TERRAIN)
]
Invert = Annotated[
    bool, typer.Option("--invert", help="Black is high, white is low.", rich_help_panel=TERRAIN)
]

Crop = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,W,H", help="Keep only this rectangle of the picture, pixels.", rich_help_panel=FILTERS
    ),
]
Resize = Annotated[
    str | None,
    typer.Option(metavar="W,H", help="Resample to so many pixels; the metres stay.", rich_help_panel=FILTERS),
]
Deterrace = Annotated[
    bool,
    typer.Option(
        "--deterrace",
        help="Remove the stairs of 8 bits: the smoothest surface within half a gray level of every pixel.",
        rich_help_panel=FILTERS,
    ),
]
Denoise = Annotated[
    bool, typer.Option("--denoise", help="Filter noise out of the picture.", rich_help_panel=FILTERS)
]
DenoiseMethod = Annotated[
    str | None,
    typer.Option(
        metavar="median|bilateral",
        help="Against single wrong pixels (the default), or against noise beside edges.",
        rich_help_panel=FILTERS,
    ),
]
Smoothing = Annotated[
    float | None,
    typer.Option(
        metavar="SIGMA_PX", help="Gaussian blur of this standard deviation.", rich_help_panel=FILTERS
    ),
]
Sharpness = Annotated[
    float | None,
    typer.Option(
        metavar="AMOUNT", help="Unsharp mask of this amount, after smoothing.", rich_help_panel=FILTERS
    ),
]

Resolution = Annotated[
    float | None,
    typer.Option(
        help="Metres a cell: of a map picture without YAML, of a log's map, or of the heights read off a "
        "mesh.",
        rich_help_panel=MAP,
    ),
]
Origin = Annotated[
    str | None,
    typer.Option(metavar="X,Y,YAW", help="Pose of such a map's lower-left corner.", rich_help_panel=MAP),
]
WallHeight = Annotated[float, typer.Option(help="Metres that walls stand high.", rich_help_panel=MAP)]
Unknown = Annotated[
    str,
    typer.Option(
        metavar="floor|wall|hole",
        help="What unknown cells are; a hole goes through the floor.",
        rich_help_panel=MAP,
    ),
]
Speckle = Annotated[
    int, typer.Option(metavar="N", help="Drop walls of fewer connected cells.", rich_help_panel=MAP)
]

_METHODS = "hector|gmapping|cartographer"
_LOG_HELP = "SLAM method that makes the map of a laser log."
LogMapper = Annotated[str, typer.Option(metavar=_METHODS, help=_LOG_HELP, rich_help_panel=MAP)]
LogMapperAlone = Annotated[
    str,
    typer.Option("--log-mapper", "--mapper", metavar=_METHODS, help=_LOG_HELP, rich_help_panel=MAP),
]

MaxError = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="Fewest triangles that stay this near the ground, vertically, at every pixel.",
        rich_help_panel=MESH,
    ),
]
MaxTriangles = Annotated[
    int | None,
    typer.Option(
        metavar="N", help="The best mesh of so many triangles, instead of --max-error.", rich_help_panel=MESH
    ),
]
RotateX = Annotated[
    float,
    typer.Option(
        metavar="DEG",
        help="Turn the mesh files about the x axis. 0 is upright in every consumer. The paper's tool writes "
        "its Z-up STL into a Y-up Collada, which stands on its edge until it is turned by its default of "
        "-90; what it shows then is what 0 shows here.",
        rich_help_panel=MESH,
    ),
]
Texture = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="PNG or JPEG that the mesh wears, projected from the sides of a cube; default: drawn.",
        rich_help_panel=MESH,
    ),
]
TextureSize = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="What the texture spans before it repeats; default: the longest side, once.",
        rich_help_panel=MESH,
    ),
]
