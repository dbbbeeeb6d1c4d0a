"""Folder of a world: Gazebo package and world, MJCF, meshes, texture, map, `world.json`."""

from __future__ import annotations

import math
import re
import shlex
import shutil
import sys
from collections.abc import Collection, Iterator
from os.path import normpath
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from PIL import Image

from lirs_wct.contact.spec import steep_nodes
from lirs_wct.errors import ConfigError, OutputError, require_known
from lirs_wct.export.appearance import ground_wear, pad_to_square, world_extent, world_parts
from lirs_wct.export.mesh_writer import require_usd, write_usd
from lirs_wct.export.mjcf import write_hfield, write_mjcf
from lirs_wct.files import atomic_folder
from lirs_wct.formats import gazebo, map_server, picture
from lirs_wct.formats.meshes.writers import (
    MeshPart,
    write_glb,
    write_obj,
    write_parts,
    write_stl,
    write_triangles,
)
from lirs_wct.geometry import BoolArray, FloatArray, HeightField, OccupancyGrid, Pose2
from lirs_wct.geometry.mesh import TriangleMesh, rasterize_heights
from lirs_wct.geometry.pose import overview
from lirs_wct.meshing.solid import solid_triangles
from lirs_wct.progress import Progress, Steps, no_progress
from lirs_wct.world import TEXTURES, World, recorded_source

FORMATS = ("dae", "stl", "sdf", "mjcf", "obj", "hfield", "glb", "usd", "map")
"""Legal formats of a package in addition to `world.json`."""
DEFAULT_FORMATS = FORMATS[:4]
GAZEBO_FOVY = 2 * math.atan(math.tan(math.radians(30)) * 3 / 4)
"""Vertical field of view of Gazebo's window, which is 60 deg wide, at 4:3, radians."""
MAX_MESH_NODES = 1_000_000
"""Nodes of a surface above which an STL of the full grid is streamed without a mesh in memory."""
ROBOT_HEIGHT = 0.3
"""Default height of the map above the ground, meters."""
RESOLUTION = 0.05
"""Cell size of the map, meters; coarser if a world has more than `CELLS` cells along a side."""
CELLS = 4000
STEEP = math.radians(45)
"""Slope of a face above which it counts as a wall, as in `map.false_occupied`, radians."""
TOUCHING = 1e-4
"""Depth by which an object on the ground may reach into it, meters."""
_REFERENCE = re.compile(rb'file="([^"]+)"|<(?:uri|albedo_map|diffuse|normal|init_from)>([^<]+)<')

GazeboTerrain = Literal["solid", "heightmap"]


def write_package(
    world: World,
    parent: str | Path,
    *,
    formats: Collection[str] = DEFAULT_FORMATS,
    terrain: GazeboTerrain = "solid",
    overwrite: bool = False,
    map_height: float = ROBOT_HEIGHT,
    progress: Progress = no_progress,
) -> Path:
    """Write `parent/NAME/` completely or not at all, and return it; the user's files stay.

    Args:
        world: world to write.
        parent: folder for the world's folder.
        formats: names from `FORMATS`.
        terrain: Gazebo's model: the solid mesh, or a heightmap (8 bit, the paper's comparison).
        map_height: height of the map above the ground, meters (see `ground_truth_map`).
        overwrite: whether the world of another source may be replaced.
        progress: called with the name of the file being written.

    Raises:
        ConfigError: a format is unknown or does not fit the world.
        OutputError: the folder cannot be written, or contains other files or the world of another source.
    """
    folder = Path(parent) / world.name
    _check(world, folder, formats, terrain, overwrite)
    steps = Steps(2 + len(set(formats)), progress)
    with atomic_folder(folder) as temporary:
        steps.begin("world.json")
        world.save(temporary)
        _write_meshes(world, temporary, formats, steps)
        if "sdf" in formats:
            steps.begin("model.sdf")
            _write_model(world, temporary, formats, terrain)
        if "mjcf" in formats:
            steps.begin(f"{world.name}.xml")
            write_mjcf(world, temporary)
        if "hfield" in formats:
            steps.begin(f"{world.name}.hfield")
            write_hfield(temporary / f"{world.name}.hfield", world.surface)
        if "map" in formats:
            steps.begin("map.yaml")
            map_server.write_map(temporary / "map", ground_truth_map(world, map_height))
    return folder


def opening_lines(folder: Path, formats: Collection[str]) -> Iterator[str]:
    """Yield the files that Gazebo and MuJoCo load with a package, and the command for each program."""
    is_own = Path(shutil.which("python") or "").parent == Path(sys.executable).parent
    viewer = f"{'python' if is_own else shlex.quote(sys.executable)} -m mujoco.viewer --mjcf="
    openers = {"sdf": ("Gazebo", ".sdf", "gz sim "), "mjcf": ("MuJoCo", ".xml", viewer)}
    for program, suffix, command in (openers[name] for name in openers if name in formats):
        model = folder / f"{folder.name}{suffix}"
        yield f"open in {program}, with {', '.join(_loaded_files(model))}:"
        yield f"    {command}{shlex.quote(str(model))}"


def _loaded_files(model: Path) -> tuple[str, ...]:
    """Return the files that Gazebo or MuJoCo loads with a model of a package, relative to its folder."""
    folder, names = model.parent, [model.name]
    for name in names:  # grows: a COLLADA mesh names its textures
        if not name.endswith((".sdf", ".xml", ".dae")):
            continue
        with (folder / name).open("rb") as file:  # a COLLADA file begins with its textures
            text = file.read(65_536 if name.endswith(".dae") else -1)
        named = (normpath(Path(name).parent / (a or b).decode()) for a, b in _REFERENCE.findall(text))
        names += [
            found for found in dict.fromkeys(named) if (folder / found).is_file() and found not in names
        ]
    return tuple(names[1:])


def _check(world: World, folder: Path, formats: Collection[str], terrain: str, overwrite: bool) -> None:
    """Refuse formats that do not fit, and a folder of other files or of another source."""
    for name in formats:
        require_known("format", name, FORMATS)
    if not formats:
        raise ConfigError(f"nothing to write; legal: {', '.join(FORMATS)}")
    if "usd" in formats:
        require_usd()
    require_known("terrain for Gazebo", terrain, ("solid", "heightmap"))
    if terrain == "heightmap" and (world.walls is not None or world.overhangs):
        raise ConfigError(f"{world.name}: a heightmap cannot hold upright walls or overhangs; take solid")
    if "sdf" in formats and terrain == "solid" and not {"dae", "stl"} & set(formats):
        raise ConfigError("sdf shows a mesh: ask for dae or stl as well, or for --terrain heightmap")
    if not folder.is_dir() or not any(folder.iterdir()):
        return
    if not (folder / "world.json").is_file():
        raise OutputError(
            f"{folder}: holds files that are not a built world; choose another folder or --name"
        )
    former = recorded_source(folder)
    if former not in (None, world.source) and not overwrite:
        raise OutputError(
            f"{folder}: holds the world of another source, {former}; give this one another --name, or "
            f"--name {world.name} to replace it"
        )


def _write_meshes(world: World, folder: Path, formats: Collection[str], steps: Steps) -> None:
    kinds = [kind for kind in ("stl", "dae", "obj", "glb", "usd") if kind in formats]
    options = world.file_options
    is_full_grid = world.kind == "terrain" and not options.limited and options.rotate_x == 0
    if kinds == ["stl"] and is_full_grid and world.surface.z.size > MAX_MESH_NODES:
        path = folder / "meshes" / f"{world.name}.stl"
        write_triangles(path, *solid_triangles(world.surface), steps.begin("meshes"))
        return
    if kinds:
        steps.begin("triangles")
    parts: list[MeshPart] = []
    for wear, mesh in world_parts(world, world.file_mesh) if set(kinds) - {"stl"} else ():
        texture = f"../{wear.write(world, folder).as_posix()}"
        parts.append(MeshPart(wear.name, mesh.rotated_x(options.rotate_x), texture))
    for kind in kinds:
        path = folder / "meshes" / f"{world.name}.{kind}"
        progress = steps.begin(path.name)
        if kind == "stl":
            write_stl(path, world.file_mesh.rotated_x(options.rotate_x), progress)
        elif kind == "dae":
            write_parts(path, parts, progress)
        elif kind == "obj":
            write_obj(path, [(p.name, p.mesh, p.texture) for p in parts])
        elif kind == "glb":
            pictures = [Image.open(folder / str(part.texture).removeprefix("../")) for part in parts]
            write_glb(path, [(p.name, p.mesh, i) for p, i in zip(parts, pictures, strict=True)])
        else:
            write_usd(path, world, parts)


def _write_model(world: World, folder: Path, formats: Collection[str], terrain: GazeboTerrain) -> None:
    name = world.name
    if terrain == "heightmap":
        heights = TEXTURES / f"{name}-heights.png"
        gazebo.write_heightmap(folder / heights, world.surface)
        model = gazebo.heightmap_sdf(name, world.surface, heights.as_posix(), _heightmap_layer(world, folder))
    else:
        model = gazebo.model_sdf(name, f"meshes/{name}.{'dae' if 'dae' in formats else 'stl'}")
    view, starts = overview(*world_extent(world), GAZEBO_FOVY), world.starts_on_ground
    classic = gazebo.world_sdf(name, view=view, place=world.place, starts=starts)
    albedo = None
    if terrain == "solid" and "dae" in formats and world.walls is None:  # a laser map has two textures
        albedo = ground_wear(world).write(world, folder).as_posix()
    for file, text in (
        ("model.config", gazebo.model_config(name)),
        ("model.sdf", model),
        (f"{name}.world", classic),
        (f"{name}.sdf", gazebo.gz_world_sdf(classic, model, starts=starts, albedo=albedo)),
    ):
        (folder / file).write_text(text, encoding="utf-8")


def _heightmap_layer(world: World, folder: Path) -> gazebo.Layer:
    """Write the square textures of Gazebo's heightmap, aligned with its south-west corner."""
    wear, longest = ground_wear(world), max(world.surface.size)
    texture, span = wear.write(world, folder), wear.span or longest
    if wear.draped:
        texture, span = texture.with_name(f"{texture.stem}-square.png"), longest
        picture.write_image(folder / texture, pad_to_square(wear.pixels(world), world.surface.size))
    normal = TEXTURES / f"{world.name}-normal.png"
    picture.write_image(folder / normal, gazebo.flat_normals())
    return gazebo.Layer(texture.as_posix(), normal.as_posix(), span)


def ground_truth_map(world: World, height: float = ROBOT_HEIGHT) -> OccupancyGrid:
    """Return the obstacles of a robot whose lidar has a height: occupied, free, unknown (NaN).

    In a laser map, wall cells at least as high as the lidar and holes are occupied. In other worlds, faces
    steeper than 45 deg that rise by at least the height, ceilings lower than the height, and nodes without
    ground are occupied.
    """
    if not 0 < height < math.inf:
        raise ConfigError(f"height of a map must be a finite number above 0 m, got {height}")
    if world.walls is not None:
        walls, truth = world.walls, world.truth
        p = np.where(walls.solid & (walls.height >= height), 1.0, 0.0)
        if truth is not None:
            p[~truth.known & ~walls.solid] = np.nan
        if walls.hole is not None:
            p[walls.hole] = 1.0
        return OccupancyGrid.from_probability(p, walls.resolution, walls.origin)
    ground, blocked = world.surface, np.zeros(world.surface.shape, np.bool_)
    if world.overhangs:
        assert world.solid is not None
        ground, low = _under_roofs(world.solid, world.surface, height)
        blocked |= low
    if world.no_ground is not None:
        blocked |= world.no_ground
    blocked |= tall_faces(ground, height)[::-1]
    return _to_grid(ground, blocked)


def tall_faces(surface: HeightField, height: float) -> BoolArray:
    """Return (rows, cols) whether nodes are on tall steep faces; row 0 = south.

    Connected faces of over 45 deg are tall if together they rise by at least `height` meters.
    """
    z = surface.south_up
    steep = steep_nodes(z, surface.cell, STEEP)
    count, labels = cv2.connectedComponents(steep.astype(np.uint8), connectivity=8)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, labels.ravel(), z.ravel())
    np.maximum.at(high, labels.ravel(), z.ravel())
    tall = high - low >= height
    tall[0] = False
    return np.asarray(tall[labels])


def _under_roofs(solid: TriangleMesh, surface: HeightField, height: float) -> tuple[HeightField, BoolArray]:
    """Return the lowest ground below overhangs, and the nodes below a low ceiling."""
    up = solid.face_normals[:, 2]
    ground = _lowest(solid, up > 1e-9, surface)
    lost = np.isnan(ground)
    ground[lost] = surface.south_up[lost]
    field = HeightField(np.ascontiguousarray(ground[::-1].astype(np.float32)), surface.cell, surface.origin)
    middle = solid.vertices[solid.faces].mean(axis=1)
    under = field.height_at(middle[:, 0], middle[:, 1])
    roof = _lowest(solid, (up < -1e-9) & (middle[:, 2] >= under - TOUCHING), surface)
    return field, (np.nan_to_num(roof - ground, nan=np.inf) < height)[::-1]


def _lowest(solid: TriangleMesh, chosen: BoolArray, surface: HeightField) -> FloatArray:
    """Return (rows, cols) heights of the lowest chosen faces; row 0 = south.

    NaN where no chosen face is.
    """
    if not chosen.any():
        return np.full(surface.shape, np.nan)
    upside_down = TriangleMesh(solid.vertices * np.array((1.0, 1.0, -1.0)), solid.faces[chosen])
    return -rasterize_heights(upside_down, (*surface.origin, *surface.cell), surface.shape)


def _to_grid(surface: HeightField, blocked: BoolArray) -> OccupancyGrid:
    """Return a grid over the surface whose cells with a blocked node are occupied."""
    (width, depth), (west, south) = surface.size, surface.origin
    resolution = max(RESOLUTION, max(width, depth) / CELLS)
    shape = (max(1, round(depth / resolution)), max(1, round(width / resolution)))
    rows, cols = (
        np.clip(((np.arange(n) + 0.5) * resolution / step).round().astype(int), 0, count - 1)
        for n, step, count in zip(shape, surface.cell[::-1], surface.shape, strict=True)
    )
    south_up = blocked[::-1]
    p = south_up[np.ix_(rows, cols)].astype(np.float64)
    at = np.argwhere(south_up) * np.array(surface.cell[::-1]) / resolution
    cells = np.minimum(at.astype(int), np.array(shape) - 1)
    p[cells[:, 0], cells[:, 1]] = 1.0
    return OccupancyGrid.from_probability(p, resolution, Pose2(west, south))
