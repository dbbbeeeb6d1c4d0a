"""Appearance of a world: parts of one texture each, texture coordinates, drawn textures.

The paper's tool maps one texture onto each face of a cube around the model (section III-B). Here the
faces of the cube are unfolded around the upper one, so that the texture continues without a seam from
the terrain over its border down the skirt. A top-view picture is draped instead: projected once from above.
Walls have an upright texture on each side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import scipy  # its modules load on first use
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError
from lirs_wct.formats.picture import read_picture, write_image
from lirs_wct.geometry import (
    BoolArray,
    ByteArray,
    FloatArray,
    HeightField,
    Int32Array,
    IntArray,
    Pose2,
    WallGrid,
    mask_at,
    njit,
)
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.world import World, texture_path

GROUND, WALLS = "ground", "walls"
HALF_PIXEL = 0.5 / 1024
"""Share of a draped picture omitted along its border: at least half a pixel of a drawn texture."""


@dataclass(frozen=True)
class Wear:
    """The texture of a part of a world.

    Attributes:
        name: name of the part, `ground` or `walls`.
        file: the user's file; None = drawn.
        draped: whether the picture covers the world once from above; else it is repeated.
        span: side of a repeated picture, meters; None = the longest side of the part.
    """

    name: str
    file: Path | None
    draped: bool
    span: float | None

    def pixels(self, world: World) -> ByteArray:
        """Return (rows, cols, 3) BGR; row 0 = upper edge, north in a draped picture."""
        if self.file is not None:
            pixels = read_picture(self.file).pixels
            if pixels.dtype != np.uint8:
                pixels = (pixels >> 8).astype(np.uint8)
            bgr = pixels[..., :3] if pixels.ndim == 3 else cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)
            return np.ascontiguousarray(bgr, np.uint8)
        if self.name == WALLS:
            return wall_texture()
        return ground_texture(world.surface) if world.walls is None else floor_texture()

    def write(self, world: World, folder: Path) -> Path:
        """Write the picture into a world's folder unless it exists; return its path inside."""
        path = texture_path(world.name, "texture" if self.name == GROUND else "wall_texture", self.file)
        if not (folder / path).is_file():
            write_image(folder / path, self.pixels(world))
        return path


class Part(NamedTuple):
    """Triangles of one texture, with texture coordinates and normals."""

    wear: Wear
    mesh: TriangleMesh


def ground_wear(world: World) -> Wear:
    """Return the ground's texture; a drawn one is draped, unless it is a floor."""
    options = world.export_options
    if options.texture is not None:
        return Wear(GROUND, options.texture, options.drape, options.texture_size)
    drawn_once = world.walls is None
    return Wear(GROUND, None, drawn_once, None if drawn_once else FLOOR_SPAN)


def world_parts(world: World, mesh: TriangleMesh | None = None) -> tuple[Part, ...]:
    """Return the mesh, by default the world's own, in parts of one texture each."""
    mesh, wear = world.mesh if mesh is None else mesh, ground_wear(world)
    if world.walls is None:
        laid = draped_uv(mesh, world.surface.bounds, HALF_PIXEL) if wear.draped else cube_uv(mesh, wear.span)
        return (Part(wear, laid),)
    return _map_parts(world, world.walls, mesh, wear)


def world_extent(world: World) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest corner of a world's visible part, meters."""
    if world.solid is not None:
        low, high = world.solid.bounds
        return low.copy(), high.copy()
    west, south, east, north = world.surface.bounds
    top = max(float(world.surface.z.max()), 0.0 if world.walls is None else world.walls.height)
    return np.array((west, south, float(world.surface.z.min()))), np.array((east, north, top))


def pad_to_square(picture: ByteArray, size: tuple[float, float]) -> ByteArray:
    """Extend a picture of width x depth meters to a square of the longer side.

    The given picture fills the lower-left corner; the rest repeats its border.
    """
    pixels = max(picture.shape[:2])
    cols, rows = (max(1, round(pixels * side / max(size))) for side in size)
    fitting = cv2.resize(picture, (cols, rows), interpolation=cv2.INTER_AREA)
    wide: ByteArray = np.pad(fitting, ((pixels - rows, 0), (0, pixels - cols), (0, 0)), mode="edge")
    return wide


def _map_parts(world: World, walls: WallGrid, mesh: TriangleMesh, wear: Wear) -> tuple[Part, ...]:
    """Return floor and walls; pictures are parallel to the map's own axes."""
    rows, cols = walls.shape
    bounds = (0.0, 0.0, cols * walls.resolution, rows * walls.resolution)
    upright = mesh.vertices[mesh.faces][..., 2].max(axis=1) > 0
    in_map = _move(mesh, walls.origin.inverse())
    span = wear.span or max(bounds)
    floor = in_map.part(~upright)
    laid = draped_uv(floor, bounds, HALF_PIXEL) if wear.draped else cube_uv(floor, span)
    parts = [Part(wear, laid)]
    if upright.any():
        # The picture has the height of the walls.
        paint = Wear(WALLS, world.export_options.wall_texture, False, walls.height)
        parts.append(Part(paint, wall_uv(in_map.part(upright), walls.height)))
    return tuple(Part(wear, _move(mesh, walls.origin)) for wear, mesh in parts if len(mesh.faces))


def _move(mesh: TriangleMesh, T: Pose2) -> TriangleMesh:
    vertices = np.column_stack((T.apply(mesh.vertices[:, :2]), mesh.vertices[:, 2]))
    normals = mesh.normals
    if normals is not None:
        normals = np.column_stack((replace(T, x=0.0, y=0.0).apply(normals[:, :2]), normals[:, 2]))
    return replace(mesh, vertices=vertices, normals=normals)


EAST, WEST, NORTH, SOUTH, UP, DOWN = range(6)
FLAT = 6
"""Offset of the label for faces that are vertical or face downward; they have separate normals."""
LABELS = 12
VERTICAL = 1e-9
"""Largest upward share of a vertical face's normal."""
WALL_VERTICAL = 0.1
"""The same on a wall, whose corners may be a millimeter apart."""


def cube_uv(mesh: TriangleMesh, size: float | None = None) -> TriangleMesh:
    """Return the mesh with texture coordinates from the sides of a cube, and vertex normals.

    A vertex is split if its triangles are projected on different sides, or if it lies on the sharp border
    between ground and skirt. The result is closed in space, not in its indices. The size is the side of one
    texture, meters; by default the longest edge of the bounding box, so that it spans each side of the cube.
    """
    bounds = mesh.bounds
    span = float(np.ptp(bounds, axis=0).max()) if size is None else size
    if not 0 < span < float("inf"):
        raise ConfigError(f"texture size must be a finite number above 0 m, got {span}")
    split = _split(mesh)
    # A skirt hangs from its rim; a vertical face of another outline has none.
    on_side = (split.side >= FLAT) & (split.side < FLAT + UP)
    top = split.top if split.hangs[on_side].all() else np.full_like(split.top, bounds[1, 2])
    return split.with_uv(_unfold(split.points, top, split.side, bounds, span))


def draped_uv(
    mesh: TriangleMesh, bounds: tuple[float, float, float, float], margin: float = 0.0
) -> TriangleMesh:
    """Project a picture from above, once; a skirt shows the picture's border.

    The bounds are the picture's west, south, east, north. The margin is the share of the picture omitted
    along its border: half a pixel for renderers that would mix in the opposite border.
    """
    split = _split(mesh, draped=True)
    west, south, east, north = bounds
    uv = (split.points[:, :2] - (west, south)) / (east - west, north - south)
    return split.with_uv(np.clip(uv, margin, 1 - margin))


def wall_uv(mesh: TriangleMesh, size: float) -> TriangleMesh:
    """Project a texture upright on the sides of axis-parallel walls, and flat on their tops.

    The texture starts at z = 0; its side is `size` meters.
    """
    split = _split(mesh, vertical=WALL_VERTICAL)
    x, y, z = split.points.T
    # As seen from outside, to the right.
    right = np.select([split.side == FLAT + k for k in (EAST, WEST, NORTH)], [y, -y, -x], x)
    return split.with_uv(np.stack((right, np.where(split.side == UP, y, z)), axis=1) / size)


@dataclass(frozen=True, slots=True)
class _Split:
    """A mesh whose vertices are split by the cube side of their triangles.

    Attributes:
        points: (n, 3) meters.
        faces: (m, 3).
        normals: (n, 3).
        side: (n,) labels of the vertices.
        top: (n,) z of the rim above a vertex of a skirt.
        hangs: (n,) whether a vertical edge of a vertical face ends at the vertex.
    """

    points: FloatArray
    faces: Int32Array
    normals: FloatArray
    side: NDArray[np.int8]
    top: FloatArray
    hangs: BoolArray

    def with_uv(self, uv: FloatArray) -> TriangleMesh:
        """Return the mesh with texture coordinates (n, 2)."""
        return TriangleMesh(self.points, self.faces, uv, self.normals)


def _split(mesh: TriangleMesh, *, vertical: float = VERTICAL, draped: bool = False) -> _Split:
    vertices, faces = np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces)
    label, mask, top, hangs = _label_faces(vertices, faces, vertical, draped)
    first = np.concatenate(([0], np.cumsum(_COUNT[mask])))
    split = np.repeat(np.arange(len(vertices)), _COUNT[mask])
    new_faces, normals = _split_faces(vertices, faces, label, mask, first[:-1], len(split))
    bits = np.unpackbits(mask.astype("<u2").view(np.uint8).reshape(-1, 2), axis=1, bitorder="little")
    side = np.nonzero(bits[:, :LABELS])[1].astype(np.int8)  # of each split vertex, vertex by vertex
    return _Split(vertices[split], new_faces, normals, side, top[split], hangs[split])


_COUNT = np.array([int(m).bit_count() for m in range(1 << LABELS)], dtype=np.int64)


def _unfold(
    points: FloatArray, top: FloatArray, side: NDArray[np.int8], bounds: FloatArray, span: float
) -> FloatArray:
    """Return (n, 2) coordinates on the unfolded cube, in units of the texture.

    Down a side the coordinate grows with the depth: below the upper rim for a skirt, below the highest point
    for a steep slope.
    """
    (west, south, _), (east, north, highest) = bounds
    uv: FloatArray = (points[:, :2] - (west, south)) / span
    depth = np.where(side >= FLAT, top, highest)
    depth -= points[:, 2]
    depth /= span
    direction = side % FLAT
    for where, axis, edge, sign in (
        (EAST, 0, (east - west) / span, 1),
        (WEST, 0, 0.0, -1),
        (NORTH, 1, (north - south) / span, 1),
        (SOUTH, 1, 0.0, -1),
    ):
        chosen = direction == where
        uv[chosen, axis] = edge + sign * depth[chosen]
    below = direction == DOWN
    uv[below, 0] = (east - west) / span - uv[below, 0]
    return uv


@njit
def _normal(vertices: FloatArray, a: int, b: int, c: int) -> tuple[float, float, float]:
    """Return the normal of a triangle, with twice its area as length."""
    x, y, z = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    ux, uy, uz = vertices[b, 0] - x, vertices[b, 1] - y, vertices[b, 2] - z
    vx, vy, vz = vertices[c, 0] - x, vertices[c, 1] - y, vertices[c, 2] - z
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@njit
def _label_faces(
    vertices: FloatArray, faces: Int32Array, vertical: float, draped: bool
) -> tuple[NDArray[np.int8], NDArray[np.uint16], FloatArray, BoolArray]:
    """Return face labels, and each vertex's label bits, rim height and hanging edges."""
    label = np.empty(len(faces), np.int8)
    mask = np.zeros(len(vertices), np.uint16)
    top = vertices[:, 2].copy()
    hangs = np.zeros(len(vertices), np.bool_)
    for i in range(len(faces)):
        a, b, c = faces[i]
        nx, ny, nz = _normal(vertices, a, b, c)
        ax, ay, az = abs(nx), abs(ny), abs(nz)
        if az >= ax and az >= ay:
            side = UP if nz >= 0 else DOWN
        elif ax >= ay:
            side = EAST if nx > 0 else WEST
        else:
            side = NORTH if ny > 0 else SOUTH
        if draped and nz > vertical * (ax + ay + az):
            side = UP
        if nz <= vertical * (ax + ay + az):
            side += FLAT
            for k in range(3):
                p, q = faces[i, k], faces[i, (k + 1) % 3]
                if vertices[p, 0] == vertices[q, 0] and vertices[p, 1] == vertices[q, 1]:
                    rim = max(top[p], top[q])
                    top[p] = rim
                    top[q] = rim
                    hangs[p] = hangs[q] = True
        label[i] = side
        for k in range(3):
            mask[faces[i, k]] |= np.uint16(1 << side)
    return label, mask, top, hangs


@njit
def _split_faces(
    vertices: FloatArray,
    faces: Int32Array,
    label: NDArray[np.int8],
    mask: NDArray[np.uint16],
    first: IntArray,
    n: int,
) -> tuple[Int32Array, FloatArray]:
    """Return the faces on split vertices, and unit normals weighted by area.

    The ground shares normals across sides of the cube; each flat side has its own.
    """
    out = np.empty_like(faces)
    normals = np.zeros((n, 3))
    for i in range(len(faces)):
        nx, ny, nz = _normal(vertices, faces[i, 0], faces[i, 1], faces[i, 2])
        for k in range(3):
            v = faces[i, k]
            j = first[v]
            for other in range(LABELS):
                if not mask[v] >> other & 1:
                    continue
                if other == label[i]:
                    out[i, k] = j
                if other == label[i] or (other < FLAT and label[i] < FLAT):
                    normals[j, 0] += nx
                    normals[j, 1] += ny
                    normals[j, 2] += nz
                j += 1
    for j in range(n):
        length = np.sqrt(normals[j, 0] ** 2 + normals[j, 1] ** 2 + normals[j, 2] ** 2)
        if length > 0:
            normals[j] /= length
        else:
            normals[j, 2] = 1.0
    return out, normals


PIXELS = 1024
EARTH = np.array(((92, 110, 70), (146, 138, 96), (178, 158, 122), (222, 214, 200)), np.float64)
"""Meadow, dry grass, rock, scree: red, green, blue from the lowest to the highest ground."""
FLOOR, WALL = np.array((205, 203, 196), np.float64), np.array((120, 116, 112), np.float64)
FLOOR_SPAN, SLABS, TILE_PIXELS = 2.0, 4, 512
"""Side of the floor's texture (meters), slabs along it, and pixels along a repeated texture."""
SUN = np.array((-0.5, 0.5, 0.7071))
"""Unit vector towards the light: north-west, as on printed maps since the Swiss Dufour map, 45 deg up."""


def ground_texture(surface: HeightField, walls: WallGrid | None = None) -> ByteArray:
    """Return a (rows, cols, 3) BGR top view of the surface, row 0 = north.

    The longer side has 1024 px.
    """
    west, south, _, _ = surface.bounds
    span = max(surface.size)
    cols, rows = (max(2, round(PIXELS * side / span)) for side in surface.size)
    x = west + (np.arange(cols) + 0.5) * surface.size[0] / cols
    y = (south + (np.arange(rows)[::-1] + 0.5) * surface.size[1] / rows)[:, None]
    if walls is not None:
        points = np.stack(np.broadcast_arrays(x, y), axis=-1)
        on_wall = mask_at(walls.solid, walls.resolution, walls.origin, points)
        return np.where(on_wall[..., None], WALL.astype(np.uint8), FLOOR.astype(np.uint8))[..., ::-1]
    # Strip by strip and color by color: all at once would take a hundred megabytes.
    z = np.concatenate([surface.height_at(x, strip) for strip in np.array_split(y, 16)])
    dz_dy, dz_dx = np.gradient(z, surface.size[1] / rows, surface.size[0] / cols)
    cosine = (-dz_dx * SUN[0] + dz_dy * SUN[1] + SUN[2]) / np.sqrt(dz_dx**2 + dz_dy**2 + 1)
    light = 0.55 + 0.6 * np.clip(cosine, 0, 1)
    z -= z.min()
    z /= max(float(z.max()), 1e-9)
    bgr = np.empty((*z.shape, 3), np.uint8)
    for k in range(3):
        color = np.interp(z, np.linspace(0, 1, len(EARTH)), EARTH[:, 2 - k])
        bgr[..., k] = np.clip(color * light, 0, 255)
    return bgr


@cache
def floor_texture() -> ByteArray:
    """Return (512, 512, 3) BGR, read-only: seamless slabs over `FLOOR_SPAN` meters."""
    side = TILE_PIXELS // SLABS
    shade = np.random.default_rng(1).normal(0.0, 3.0, (SLABS, SLABS)).repeat(side, 0).repeat(side, 1)
    joint = np.minimum(np.arange(TILE_PIXELS) % side, side - 1 - np.arange(TILE_PIXELS) % side) < 1
    shade[joint] = shade[:, joint] = -28.0
    return _apply_shade(FLOOR, shade + _grain(2, 2.5))


@cache
def wall_texture() -> ByteArray:
    """Return (512, 512, 3) BGR, read-only: seamless rough plaster of any size."""
    return _apply_shade(WALL, _grain(3, 6.0))


def _grain(seed: int, strength: float) -> FloatArray:
    """Return (512, 512) periodic noise with blotches of a tenth of its size."""
    noise = np.random.default_rng(seed).normal(size=(TILE_PIXELS, TILE_PIXELS))
    blotches = scipy.ndimage.gaussian_filter(noise, TILE_PIXELS / 40, mode="wrap")
    fine = scipy.ndimage.gaussian_filter(noise, 1.0, mode="wrap")
    grain: FloatArray = strength * (blotches / blotches.std() + 0.6 * fine / fine.std())
    return grain


def _apply_shade(color: FloatArray, shade: FloatArray) -> ByteArray:
    pixels = np.clip(color[::-1] + shade[..., None], 0, 255).astype(np.uint8)
    pixels.setflags(write=False)
    return pixels
