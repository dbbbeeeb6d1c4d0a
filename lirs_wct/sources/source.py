"""Sources of worlds: kinds, options, and identification by name, path and content.

Each option declares its help, command-line spelling and legal values (see `option`).
"""

from __future__ import annotations

import math
import re
import unicodedata
import warnings
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lirs_wct.errors import ConfigError, SourceError, did_you_mean
from lirs_wct.files import read_manifest
from lirs_wct.formats import BAGS, CLOUDS, LOGS, MAPS, MESHES, ZSTD, Encoding, map_server, picture
from lirs_wct.geometry import FloatArray, Pose2
from lirs_wct.geometry.geodesy import Place
from lirs_wct.ground import ExportOptions, Ground, finite
from lirs_wct.option import Options, Slider, changed, declared, documented, option, positive, within
from lirs_wct.sources.bundled import RECIPES


class SourceKind(Enum):
    """Kind of a source; it selects the reader."""

    BUNDLED = "bundled world"
    FOLDER = "built folder"
    PICTURE = "picture of a terrain"
    MAP = "laser map"
    MAP_PICTURE = "picture of a laser map"
    MESH = "mesh"
    CLOUD = "point cloud"
    LOG = "log of a laser"


DEFAULT_SIZE = 50.0
"""Longer side of a picture without a scale, meters."""
DEFAULT_HEIGHT = 6.0
"""Relief of a picture without a scale, meters."""

Unknown = Literal["floor", "wall", "hole"]
UNKNOWN: tuple[Unknown, ...] = ("floor", "wall", "hole")
CloudSurface = Literal["ground", "top"]
MAX_SIDE = 32_000
"""Pixels along a side to which a picture may be resized."""

_PICTURES = {SourceKind.BUNDLED, SourceKind.PICTURE}
_MESHES = {*_PICTURES, SourceKind.MESH}
_MAPS = {SourceKind.MAP, SourceKind.MAP_PICTURE}
_SCALE: dict[str, Any] = {"panel": "Terrain pictures", "kinds": _MESHES}
_GRAY: dict[str, Any] = {"panel": "Terrain pictures", "kinds": _PICTURES}
_FILTER: dict[str, Any] = {"panel": "Picture filters", "kinds": _PICTURES}
_CLOUD: dict[str, Any] = {"panel": "Point clouds", "kinds": {SourceKind.CLOUD}, "rare": True}
_MAP: dict[str, Any] = {"panel": "Laser maps", "kinds": _MAPS}


def read_factors(text: str, label: str) -> tuple[float, float, float]:
    """Read one factor for all axes, or one for each."""
    factors = _numbers(text, label, "S or SX,SY,SZ", 1, 3)
    return factors[0], factors[len(factors) // 2], factors[-1]


def read_pose(text: str, label: str) -> Pose2:
    """Read x, y and an optional yaw."""
    return Pose2(*_numbers(text, label, "X,Y or X,Y,YAW in meters and radians", 2, 3))


def read_point(text: str, label: str) -> tuple[float, float]:
    """Read x and y."""
    x, y = _numbers(text, label, "X,Y in meters", 2)
    return x, y


def _numbers(text: str, label: str, form: str, *counts: int) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) not in counts:
        raise ConfigError(f"{label} must be {form}, got {text!r}")
    return values


def _start(value: Pose2, _: str) -> None:
    if not all(math.isfinite(number) for number in (value.x, value.y, value.yaw)):
        raise ConfigError(f"a start must be finite, got {value.x},{value.y},{value.yaw}")


def _crop(value: tuple[int, int, int, int], _: str) -> None:
    if min(value[:2]) < 0 or min(value[2:]) < 2:
        raise ConfigError(f"crop needs a corner at 0,0 or beyond and at least 2x2 px, got {value}")


def _resize(value: tuple[int, int], _: str) -> None:
    if not all(2 <= n <= MAX_SIDE for n in value):
        raise ConfigError(f"resize needs 2 to {MAX_SIDE} px a side, got {value}")


@dataclass(frozen=True, kw_only=True)
class SourceOptions(Options):
    """Options of any source, of pictures, laser maps, point clouds and meshes."""

    name: str | None = option(None, "Name of the world; default: the file's, of `map.yaml` the folder's.")
    kind: Literal["picture", "map"] | None = option(
        None, "Read a picture as terrain or as laser map; default: the file's."
    )
    window: tuple[float, float, float] | None = option(
        None,
        "Keep only this square of the world, meters.",
        metavar="X,Y,SIDE",
        check=lambda window, _: positive(window[2], "window side"),
        kinds={*_MESHES, *_MAPS, SourceKind.CLOUD, SourceKind.FOLDER},
    )
    start: Pose2 | None = option(
        None,
        "Where the robot starts, meters and radians; default: where the largest robot that fits can drive.",
        metavar="X,Y[,YAW]",
        reader=read_pose,
        check=_start,
    )
    max_pixels: int = option(
        picture.MAX_PIXELS, "Refuse larger pictures before decoding them.", check=positive, rare=True
    )
    size: float | tuple[float, float] | None = option(
        None,
        "Extent in meters: longer side, or width and height. Default 50, or the file's own.",
        title="size [m]",
        metavar="W[,H]",
        check=positive,
        **_SCALE,
    )
    height: float | None = option(
        None,
        "Meters from the darkest to the brightest pixel. Default 6, or the file's own.",
        title="height [m]",
        check=positive,
        **_SCALE,
    )
    z_scale: float | None = option(
        None,
        "Multiply the resulting heights.",
        title="z axis scale",
        slider=Slider(low=0.1, high=10.0, step=0.1, neutral=1.0),
        check=positive,
        **_SCALE | {"kinds": {*_MESHES, SourceKind.CLOUD}},
    )
    scale: tuple[float, float, float] | None = option(
        None,
        "Multiply the resulting width, depth and height.",
        metavar="S or SX,SY,SZ",
        reader=read_factors,
        check=positive,
        **_SCALE,
    )
    zero: float | None = option(
        None,
        "Height of the file's own that becomes z = 0, so that neighboring tiles fit; default: the lowest.",
        metavar="HEIGHT",
        check=finite,
        rare=True,
        **_SCALE | {"kinds": {SourceKind.PICTURE, SourceKind.CLOUD}},
    )
    nodata: float | None = option(
        None,
        "Value of pixels without a height, where the file does not say it.",
        metavar="VALUE",
        rare=True,
        **_SCALE | {"kinds": {SourceKind.PICTURE}},
    )
    encoding: Encoding = option(
        "gray",
        "How the pixels are heights: by their gray, or by their color as tiles of Mapbox or Terrarium.",
        rare=True,
        **_SCALE | {"kinds": {SourceKind.PICTURE}},
    )
    grayscale: bool = option(False, "Turn a color picture into gray.", **_GRAY)
    invert: bool = option(False, "Black is high, white is low.", title="color inverse", **_GRAY)
    crop: tuple[int, int, int, int] | None = option(
        None,
        "Keep only this rectangle of the picture, pixels.",
        metavar="X,Y,W,H",
        check=_crop,
        rare=True,
        **_FILTER,
    )
    resize: tuple[int, int] | None = option(
        None,
        "Resample to so many pixels; the meters stay.",
        metavar="W,H",
        check=_resize,
        rare=True,
        **_FILTER,
    )
    deterrace: bool = option(
        False,
        "Remove the stairs of 8 bits: the smoothest surface within half a gray level of every pixel.",
        rare=True,
        **_FILTER,
    )
    denoise: Literal["median", "bilateral"] | None = option(
        None,
        "Filter noise out of the picture: single wrong pixels, or noise beside edges; default: none.",
        rare=True,
        **_FILTER,
    )
    smoothing: float | None = option(
        None,
        "Gaussian blur of this standard deviation.",
        slider=Slider(low=0.0, high=20.0, step=0.1, neutral=0.0),
        metavar="SIGMA_PX",
        check=positive,
        **_FILTER,
    )
    sharpness: float | None = option(
        None,
        "Unsharp mask of this amount, after smoothing.",
        slider=Slider(low=0.0, high=5.0, step=0.1, neutral=0.0),
        metavar="AMOUNT",
        check=positive,
        **_FILTER,
    )
    resolution: float | None = option(
        None,
        "Meters a pixel of a picture, a cell of a map picture without YAML or of a log's map, or a cell of "
        "the heights of a mesh or cloud.",
        check=positive,
        **_MAP | {"kinds": {*_MESHES, SourceKind.MAP_PICTURE, SourceKind.CLOUD}},
    )
    wall_height: float = option(
        2.5, "Height of walls, meters.", title="wall height [m]", check=positive, **_MAP
    )
    unknown: Unknown = option(
        "floor", "Kind of unknown cells; a hole goes through the floor.", rare=True, **_MAP
    )
    speckle: int = option(
        0, "Drop walls of fewer connected cells.", check=within("[0, inf)", "cells"), rare=True, **_MAP
    )
    cloud_surface: CloudSurface = option(
        "ground",
        "Which surface of a point cloud is the terrain: the bare ground, or the top of all that is on it.",
        **_CLOUD,
    )
    ground_slope: float | None = option(
        None,
        "Steepest ground of a point cloud, rise over run; steeper points are objects on it. "
        "Default: 0.15, and in mountains their own slope.",
        metavar="RISE/RUN",
        check=positive,
        **_CLOUD,
    )
    up: Literal["y", "z"] | None = option(
        None,
        "Axis of a mesh file that points up; default: the file's, else z.",
        panel="Meshes",
        kinds={SourceKind.MESH},
    )


@documented
@dataclass(frozen=True, kw_only=True)
class BuildOptions(ExportOptions, SourceOptions):
    """Options of building a world; None means the source's own value, else the default.

    Lengths are meters in the world's frame, angles of poses radians, a crop is column, row, width and height.

    Raises:
        ConfigError: a value is not legal, or two options contradict.
    """


MAX_NAME = 200
"""Limit of a name, characters: file systems allow 255, and a world's files have endings of up to 40."""


@dataclass(frozen=True, slots=True)
class Source:
    """An existing source: kind, path (or bundled name), and name of the world."""

    kind: SourceKind
    path: Path
    name: str

    @property
    def identity(self) -> str:
        """Identity of the source: its absolute path, or its bundled name."""
        return self.path.name if self.kind is SourceKind.BUNDLED else str(self.path.resolve())


def find_source(given: str | Path, options: BuildOptions) -> Source:
    """Return kind, path and name of a source."""
    path = Path(given)
    if str(given) in RECIPES:
        return Source(SourceKind.BUNDLED, path, _name(str(given), options))
    if not path.exists():
        raise SourceError(
            f"{given}: no such file or folder, nor a bundled world (bundled: {', '.join(RECIPES)})"
            f"{did_you_mean(str(given), RECIPES)}"
        )
    kind = _kind(path, options)
    beside = _yaml_beside(path) if kind in (SourceKind.PICTURE, SourceKind.MAP_PICTURE) else None
    if beside is not None and options.kind != "picture" and options.resolution is None:
        warnings.warn(
            f"{path}: read as the laser map that {beside.name} beside it says it is; "
            "--kind picture reads it as a terrain",
            stacklevel=2,
        )
        kind, path = SourceKind.MAP, beside
    stem = _strip_compression(path).stem if path.is_file() else path.name
    if stem.lower() == "map" and path.is_file():  # map savers name all maps so
        stem = path.parent.resolve().name or stem
    return Source(kind, path, _name(stem, options))


def _yaml_beside(path: Path) -> Path | None:
    """Return the ROS map's YAML beside a picture, if it names the picture."""
    for beside in filter(Path.is_file, map(path.with_suffix, MAPS)):
        with suppress(SourceError):  # a YAML other than of a map
            if map_server.read_metadata(beside).image.resolve() == path.resolve():
                return beside
    return None


def is_log(path: Path) -> bool:
    """Return whether a path is a CARMEN log or a ROS bag."""
    return _strip_compression(path).suffix.lower() in LOGS or is_bag(path)


def is_bag(path: Path) -> bool:
    """Return whether a path is a ROS bag: a file, or a folder of them."""
    if path.is_dir():
        return not (path / "world.json").exists() and any(map(is_bag, filter(Path.is_file, path.iterdir())))
    return path.name.lower().removesuffix(ZSTD).endswith(BAGS)


def warn_without_effect(source: Source, options: BuildOptions) -> None:
    """Warn of given options that have no effect on a source of this kind."""
    declarations = declared(type(options))
    useless = [
        f"--option {entry.flag[2:]}" if entry.rare else entry.flag
        for name, entry in declarations.items()
        if name in changed(options) and source.kind not in (entry.kinds or SourceKind)
    ]
    if useless:
        verb = "has" if len(useless) == 1 else "have"
        warnings.warn(
            f"{source.path}: {', '.join(useless)} {verb} no effect on a {source.kind.value}", stacklevel=3
        )


UNREAD = {
    ".gltf": ("a glTF scene in several files", "save it as .glb"),
    ".fbx .blend .3ds .skp .x3d .wrl .off .3mf .usd .usda .usdc .usdz": (
        "a scene of another 3D program",
        "export it as .glb, .dae, .obj, .ply or .stl, by Blender for example",
    ),
    ".step .stp .iges .igs .ifc .dxf .dwg": ("a CAD model", "export it as .stl, by FreeCAD for example"),
    ".e57 .pts .ptx": ("a point cloud", "convert it to .las, .ply or .pcd, by CloudCompare for example"),
    ".bt .ot": ("an OctoMap", "octree2pointcloud IN OUT.pcd makes a point cloud of it"),
    ".world .sdf .urdf .xacro": ("a description in XML", "give the mesh or the heightmap that it names"),
    ".svg .pdf .heic": ("a drawing", "export it as .png"),
    ".npy .npz .mat": ("an array", "save it as .tif or .png"),
    ".zip .7z .rar .tar .tgz": ("an archive", "unpack it"),
}
"""Kinds of files that are not read, by suffixes, and the way to one that is."""


def _kind(path: Path, options: BuildOptions) -> SourceKind:
    suffix = path.suffix.lower()
    if is_bag(path):
        return SourceKind.LOG
    if path.is_dir():
        if (path / "world.json").is_file():
            return SourceKind.FOLDER
        if "world.json" in read_manifest(path):
            raise SourceError(f"{path}: is incomplete, its build was broken off: build it again")
        raise SourceError(f"{path}: a folder that was built holds world.json, this one does not")
    if suffix in MAPS:
        return SourceKind.MAP
    if suffix == ".ply":
        from lirs_wct.formats.point_clouds import is_cloud_ply  # loads the kernels of meshes

        return SourceKind.CLOUD if is_cloud_ply(path) else SourceKind.MESH
    if suffix in CLOUDS:
        return SourceKind.CLOUD
    if suffix in MESHES:
        return SourceKind.MESH
    if is_log(path):
        return SourceKind.LOG
    for suffixes, (content, way) in UNREAD.items():
        if suffix in suffixes.split():
            raise SourceError(f"{path}: is {content}, which is not read: {way}")
    return SourceKind.MAP_PICTURE if options.kind == "map" else SourceKind.PICTURE


def _strip_compression(path: Path) -> Path:
    return path.with_suffix("") if path.suffix.lower() in (".gz", ZSTD) else path


def _name(stem: str, options: BuildOptions) -> str:
    """Return a name that every consumer accepts; Gazebo's URIs allow no spaces.

    Accents are removed from letters; letters of other scripts are removed.
    """
    given = options.name or stem
    plain = "".join(c for c in unicodedata.normalize("NFKD", given) if not unicodedata.combining(c))
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", plain).strip("_.-") or "world"
    if not given.isascii():
        warnings.warn(
            f"{given}: the world is named {name}; names hold letters a to z, digits and _.- alone",
            stacklevel=4,
        )
    if len(name) > MAX_NAME:
        raise ConfigError(f"--name: a world's name has at most {MAX_NAME} characters, got {len(name)}")
    return name


Reading = tuple[Ground, str, Place | None]
"""Result of a reader: ground in the world's frame, origin of the meters as text, georeference if known."""
MAX_OFFSET = 10_000.0
"""Distance from the origin, meters, beyond which the center of a source becomes the world's origin."""


def local_origin(path: Path, low: FloatArray, high: FloatArray, unit: float = 1.0) -> tuple[float, float]:
    """Return the coordinates of the world's origin; warn unless they are 0, 0.

    The digits of float32 would not suffice for coordinates of a country. Low and high are the smallest and
    largest x and y, the unit is meters per unit of theirs.
    """
    if np.abs((low, high)).max() * unit <= MAX_OFFSET:
        return 0.0, 0.0
    x, y = ((low + high) / 2).round().tolist()
    if (x, y) != (0.0, 0.0):
        warnings.warn(
            f"{path}: lies far from its origin: its point {x:.0f}, {y:.0f} becomes 0, 0 of the world",
            stacklevel=3,
        )
    return x, y
