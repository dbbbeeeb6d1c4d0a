"""MuJoCo model of a world as specification and as MJCF file: ground, walls, contact geometry.

The file has exact heights and the ground's texture, for MuJoCo 3.0 and later. Row 0 of MuJoCo's height field
is at -y, row 0 of ours is in the north; `HeightField.south_up` flips it. MuJoCo scales heights to [0, 1] by
their minimum and maximum. The geom stores both: the minimum as its z, the relief as its elevation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from zlib import crc32

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from lirs_wct.contact import ContactGeometry, check_contact_geometry
from lirs_wct.contact.grid import ContactGrid
from lirs_wct.contact.parts import contact_parts
from lirs_wct.errors import ConfigError
from lirs_wct.export.appearance import Wear, ground_wear, world_extent, world_parts
from lirs_wct.files import atomic_write
from lirs_wct.formats.meshes.writers import write_obj
from lirs_wct.formats.picture import write_image
from lirs_wct.geometry import BoolArray, ByteArray, FloatArray, HeightField, Viewpoint, WallGrid
from lirs_wct.geometry.mesh import MUJOCO_FACES, TriangleMesh, split_tiles
from lirs_wct.geometry.pose import AZIMUTH, ELEVATION, overview
from lirs_wct.meshing.solid import merged_rectangles
from lirs_wct.world import World

TERRAIN_GROUP = 3
"""Geom group of ground and walls in a simulation; rays for robots and props exclude it."""
BASE = 1.0
"""Meters that the ground reaches below its lowest point; contacts push along the shorter direction, up."""
RAY_GROUP = 5
"""Geom group of a mesh with overhangs for MuJoCo's rays; no robot uses it."""
GROUND_COLOR = (0.62, 0.57, 0.48, 1.0)
WALL_COLOR = (0.45, 0.5, 0.55, 1.0)


def world_spec(
    world: World,
    *,
    contact: ContactGrid | None = None,
    robot: mujoco.MjSpec | None = None,
    contact_geometry: ContactGeometry = "hfield",
    ray_surface: bool = False,
    height_range: tuple[float, float] | None = None,
) -> mujoco.MjSpec:
    """Return the world as an MjSpec to compile.

    Args:
        world: ground and walls.
        contact: contact grid; default: the surface itself.
        robot: specification to which the world is added; its options and defaults stay unchanged.
        contact_geometry: geometry of contacts (see `CONTACT_GEOMETRIES`).
        ray_surface: whether to add the surface itself for MuJoCo's own rays if contacts use another geometry.
        height_range: lowest and highest height of the height field, meters; `write_heights` fills it in the
            compiled model. Default: the range of the ground.

    Raises:
        ConfigError: the terrain does not fit the world.
    """
    check_contact_geometry(contact_geometry, world)
    spec = robot if robot is not None else mujoco.MjSpec()
    spec.modelname = world.name
    surface = world.surface if contact is None else contact.heights(world.surface)
    _add_contact_geoms(spec, world, surface, contact_geometry, height_range)
    if contact_geometry == "mesh" or world.overhangs:
        _add_tiles(spec, world, RAY_GROUP if world.overhangs else TERRAIN_GROUP)
    elif ray_surface and (contact_geometry != "hfield" or surface.shape != world.surface.shape):
        _hide(spec)
        _add_ground(spec, world.surface, name="seen", contype=0, conaffinity=0)
    for geom in spec.worldbody.geoms:
        # The robot's defaults also apply here: equal priorities would mix the contact parameters of both.
        geom.priority = 0
    spec.worldbody.add_light(pos=(0, 0, 50), dir=(0.3, 0.2, -1), type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    return spec


def contact_spec(world: World, contact_geometry: ContactGeometry) -> mujoco.MjSpec:
    """Return only the geoms that are touched; the height field has no heights."""
    spec = mujoco.MjSpec()
    _add_contact_geoms(spec, world, world.surface, contact_geometry, heights=False)
    return spec


def _add_contact_geoms(
    spec: mujoco.MjSpec,
    world: World,
    surface: HeightField,
    contact_geometry: ContactGeometry,
    height_range: tuple[float, float] | None = None,
    heights: bool = True,
) -> None:
    walls = world.walls
    if contact_geometry in ("prisms", "convex"):
        _add_parts(spec, world, contact_geometry)
    elif walls is None or walls.hole is None:
        _add_ground(spec, surface, height_range=height_range, heights=heights)
    else:
        _add_boxes(spec, walls, walls.floor, (-BASE, 0.0), GROUND_COLOR)
    if walls is not None:
        _add_boxes(spec, walls, walls.solid, (0.0, walls.height), WALL_COLOR)


def _add_ground(
    spec: mujoco.MjSpec,
    surface: HeightField,
    name: str = "ground",
    height_range: tuple[float, float] | None = None,
    heights: bool = True,
    **options: int,
) -> None:
    west, south, east, north = surface.bounds
    low, relief = float(surface.z.min()), surface.relief
    if height_range is not None:
        low, relief = height_range[0], height_range[1] - height_range[0]
    half = ((east - west) / 2, (north - south) / 2)
    common = {
        "name": name,
        "pos": ((west + east) / 2, (south + north) / 2, low),
        "group": TERRAIN_GROUP,
        "rgba": GROUND_COLOR,
        **options,
    }
    if relief == 0.0:
        # A plane costs a contact test, a flat height field all the prisms under a wheel.
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(*half, 1.0), **common)
        return
    data = {}
    if heights:  # slow with millions of them
        data = dict(zip(("nrow", "ncol"), surface.shape, strict=True), userdata=surface.south_up.ravel())
    spec.add_hfield(name=name, size=(*half, relief, BASE), **data)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname=name, **common)


def write_heights(model: mujoco.MjModel, surface: HeightField, height_range: tuple[float, float]) -> None:
    """Write heights into a compiled model's ground; its height range and nodes stay.

    The ground's bounding box, used in the first phase of collision detection, is compiled from the range.

    Raises:
        ConfigError: the surface has other nodes than the ground, or exceeds the range.
    """
    field, (low, high) = model.hfield("ground"), height_range
    shape = int(field.nrow[0]), int(field.ncol[0])
    if surface.shape != shape:
        raise ConfigError(f"heights must be {shape} nodes, those of the ground, got {surface.shape}")
    lowest, highest = float(surface.z.min()), float(surface.z.max())
    if not low <= lowest <= highest <= high:
        raise ConfigError(
            f"heights must be within {low:g} to {high:g} m, the height range, "
            f"got {lowest:.3f} to {highest:.3f}"
        )
    begin = int(model.hfield_adr[field.id])
    heights = model.hfield_data[begin : begin + surface.z.size].reshape(shape)
    np.subtract(surface.z[::-1], np.float32(low), out=heights)
    heights /= np.float32(high - low)


def _add_boxes(
    spec: mujoco.MjSpec,
    walls: WallGrid,
    cells: BoolArray,
    span: tuple[float, float],
    color: tuple[float, ...],
) -> None:
    """Add boxes to the world body; MuJoCo would update a separate body at every step."""
    half_yaw = walls.origin.yaw / 2
    quat = (math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw))
    low, high = span
    boxes = merged_rectangles(cells).reshape(-1, 4) * walls.resolution
    centers = walls.origin.apply((boxes[:, [1, 0]] + boxes[:, [3, 2]]) / 2)
    halves = (boxes[:, [3, 2]] - boxes[:, [1, 0]]) / 2
    for (x, y), (hx, hy) in zip(centers.tolist(), halves.tolist(), strict=True):
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(x, y, (low + high) / 2),
            size=(hx, hy, (high - low) / 2),
            quat=quat,
            group=TERRAIN_GROUP,
            rgba=color,
        )
    # With sleeping enabled MuJoCo skips static geoms: 2,372 boxes cost 5 us a step instead of 19.
    spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)


def _add_parts(spec: mujoco.MjSpec, world: World, contact_geometry: ContactGeometry) -> None:
    """Add each convex part as a mesh, which equals its hull."""
    for k, corners in enumerate(contact_parts(world, contact_geometry)):
        name = f"ground{k}"
        spec.add_mesh(name=name, uservert=corners.ravel())
        spec.worldbody.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, group=TERRAIN_GROUP, rgba=GROUND_COLOR
        )
    spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)


def _hide(spec: mujoco.MjSpec) -> None:
    """Make the contact geoms invisible to cameras and to MuJoCo's rays."""
    for geom in spec.worldbody.geoms:
        if geom.group == TERRAIN_GROUP:
            geom.rgba = (*geom.rgba[:3], 0.0)


def _add_tiles(spec: mujoco.MjSpec, world: World, group: int) -> None:
    """Add the world's mesh as visible geoms without contact; contact geoms become invisible."""
    _hide(spec)
    for k, tile in enumerate(split_tiles(world.mesh, aim=MUJOCO_FACES // 2)):
        name = f"seen{k}"
        spec.add_mesh(
            name=name,
            uservert=tile.vertices.ravel(),
            userface=tile.faces.ravel(),
            # A tile is open: it has no volume to take an inertia from.
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            contype=0,
            conaffinity=0,
            group=group,
            rgba=GROUND_COLOR,
        )


SKY = {"rgb1": (0.72, 0.80, 0.90), "rgb2": (0.93, 0.94, 0.95)}
"""Colors of the sky above and at the horizon, RGB."""
SUN = (0.5, -0.5, -0.7071)
"""Direction in which the light travels: from the north-west, as in the drawn textures."""
NEAR_PLANE, FAR_PLANE, DEPTHS = 0.02, 5.0, 4e5
"""Near plane of a camera (meters), far plane (extents of the world), and largest ratio of far to near plane.
A sky at 4e6 times the near plane is clipped."""
FOVY = math.radians(45)
EYE, DOWN = 1.0, math.radians(10)
"""Height above the ground (meters) and downward angle (radians) of the camera at the first start pose."""
GROUND_PIXELS, DRAPED_PIXELS = 2048, 8192
"""Limit of pixels along the longer side of a repeated texture, and of a draped one."""
TOUCHED_GROUP = 3
"""Geom group of invisible contact geoms below a finer visible mesh; MuJoCo's viewer hides it."""
SEEN_GROUP = 0
START_GROUP = 4
"""Group of sites that the viewer hides by default."""
OLDEST_MUJOCO = "3.0.0"
"""The oldest version that reads the written files; `.ci/run` loads worlds with it."""
Numbers = float | Sequence[float] | FloatArray


def write_mjcf(world: World, folder: str | Path) -> Path:
    """Write NAME.xml, the surface's exact float32 heights, and the ground's texture.

    If no height field is visible (a laser map, a mesh with overhangs), the world's own mesh is visible, and
    the contact geoms are in group 3.

    Returns:
        The path of NAME.xml.

    Raises:
        OutputError: the folder cannot be written.
    """
    path = Path(folder) / f"{world.name}.xml"
    contact = contact_spec(world, "convex" if world.overhangs else "hfield")
    low, high = world_extent(world)
    if contact.hfields:
        low[2] -= BASE
    center, extent = (low + high) / 2, 0.8 * float(np.linalg.norm(high - low))
    root = ElementTree.Element("mujoco", model=world.name)
    _add(root, "compiler", angle="radian")
    _add_settings(root, center, extent)
    assets, body = _add(root, "asset"), _add(root, "worldbody")
    _add(assets, "texture", name="sky", type="skybox", builtin="gradient", width=64, height=64, **SKY)
    _copy_contact_geoms(assets, body, contact)
    if contact.hfields:
        _dress_field(assets, body, world, path.parent)
    else:
        _add_meshes(assets, body, world, path.parent)
    _add_starts(body, world)
    _add_cameras(body, world, low, high)
    _add_sun(body, center - extent * np.array(SUN), shadow=not contact.hfields)
    ElementTree.indent(root)
    with atomic_write(path) as temporary:
        temporary.write_text(ElementTree.tostring(root, encoding="unicode") + "\n", encoding="utf-8")
    return path


def _add(parent: Element, tag: str, **attributes: str | Numbers) -> Element:
    """Add an element; numbers are written with full precision."""
    return ElementTree.SubElement(
        parent,
        tag,
        {name: value if isinstance(value, str) else _text(value) for name, value in attributes.items()},
    )


def _text(numbers: Numbers) -> str:
    return " ".join([repr(number) for number in np.ravel(numbers).tolist()])


def _add_settings(root: Element, center: FloatArray, extent: float) -> None:
    """Add extent, near plane, and the viewer's direction and light."""
    _add(root, "statistic", center=center, extent=extent)
    visual = _add(root, "visual")
    azimuth, elevation = math.degrees(AZIMUTH), math.degrees(ELEVATION)
    _add(visual, "global", azimuth=azimuth, elevation=elevation, offwidth=1920, offheight=1080)
    _add(visual, "headlight", ambient=(0.5, 0.5, 0.5), diffuse=(0.2, 0.2, 0.2), specular=(0, 0, 0))
    # A share of the extent, by default 1 %: half a meter in a world of 50 m.
    _add(visual, "map", znear=max(NEAR_PLANE / extent, FAR_PLANE / DEPTHS), zfar=FAR_PLANE)


def _copy_contact_geoms(assets: Element, body: Element, contact: mujoco.MjSpec) -> None:
    """Add the geoms of a specification, and the assets that they use."""
    group = SEEN_GROUP if contact.hfields else TOUCHED_GROUP
    for hfield in contact.hfields:
        _add(assets, "hfield", name=hfield.name, size=hfield.size)
    for mesh in contact.meshes:
        _add(assets, "mesh", name=mesh.name, vertex=mesh.uservert)
    for geom in contact.worldbody.geoms:
        kind = geom.type.name.removeprefix("mjGEOM_").lower()
        attributes = {"name": geom.name, "hfield": geom.hfieldname, "mesh": geom.meshname}
        used = {name: value for name, value in attributes.items() if value}
        if not geom.meshname and not geom.hfieldname:
            used["size"] = _text(geom.size)
        _add(body, "geom", type=kind, group=group, rgba=geom.rgba, pos=geom.pos, quat=geom.quat, **used)


def _dress_field(assets: Element, body: Element, world: World, folder: Path) -> None:
    """Write the heights and their texture, and cover the height field with it."""
    wear = ground_wear(world)
    # The border shows the center of the outermost pixels; otherwise it would mix in the opposite ones.
    rows, cols = wear.pixels(world).shape[:2]
    repeat = (1 - 1 / cols, 1 - 1 / rows) if wear.draped else (1.0, 1.0)
    _add_material(assets, wear.name, _picture(world, wear, folder, laid=True), texrepeat=repeat)
    heights = f"{world.name}-{_checksum(*_hfield(world.surface))}.hfield"
    write_hfield(folder / heights, world.surface)
    for hfield in assets.iter("hfield"):
        hfield.set("file", heights)
    for geom in body.iter("geom"):
        geom.set("material", wear.name)
        geom.set("rgba", "1 1 1 1")


def _add_meshes(assets: Element, body: Element, world: World, folder: Path) -> None:
    """Write the world's own textured mesh; add it as visible geoms without contact."""
    for part in world_parts(world, world.file_mesh):
        wear = part.wear.name
        _add_material(assets, wear, _picture(world, part.wear, folder))
        tiles = list(split_tiles(part.mesh, aim=MUJOCO_FACES // 2))
        # A tile is open: it may have no volume for an inertia. MuJoCo before 3.3 rejects these worlds.
        inertia = {"inertia": "shell"} if len(tiles) > 1 else {}
        for k, tile in enumerate(tiles):
            name = f"{wear}-seen{k}"
            _add(assets, "mesh", name=name, file=_write_tile(tile, f"{world.name}-{name}", folder), **inertia)
            _add(
                body,
                "geom",
                name=name,
                type="mesh",
                mesh=name,
                material=wear,
                contype=0,
                conaffinity=0,
                group=SEEN_GROUP,
            )


def _write_tile(tile: TriangleMesh, stem: str, folder: Path) -> str:
    """Write a mesh and return its file name, which contains its checksum."""
    arrays = (np.ascontiguousarray(a, np.float32) for a in (tile.vertices, tile.uv))
    file = f"{stem}-{_checksum(*arrays)}.obj"
    write_obj(folder / file, [("ground", tile, None)])
    return file


def _add_material(assets: Element, name: str, texture: Path, **attributes: Numbers) -> None:
    _add(assets, "texture", name=name, type="2d", file=texture.as_posix())
    _add(assets, "material", name=name, texture=name, specular=0, shininess=0, **attributes)


def _add_starts(body: Element, world: World) -> None:
    """Add a site on the ground for each start; robots attach to the first, `start`.

    A keyframe would not work: it stores joint positions, and a world has no joint.
    """
    for k, start in enumerate(world.starts_on_ground):
        name = f"start{k or ''}"
        _add(body, "site", name=name, pos=start.position, quat=start.quaternion, group=START_GROUP)


def _add_cameras(body: Element, world: World, low: FloatArray, high: FloatArray) -> None:
    """Add a camera that sees the whole world, and one above the first start pose."""
    viewpoints = {"overview": overview(low, high, FOVY)}
    if world.spawn_poses:
        start = world.starts_on_ground[0]
        viewpoints["start"] = Viewpoint((start.x, start.y, start.z + EYE), world.spawn_poses[0].yaw, DOWN)
    for name, viewpoint in viewpoints.items():
        _, right, up = viewpoint.axes
        _add(body, "camera", name=name, pos=viewpoint.position, xyaxes=(*right, *up), fovy=math.degrees(FOVY))


def _add_sun(body: Element, position: FloatArray, *, shadow: bool) -> None:
    """Add the light; its shadow speckles a height field, whose drawn texture is shaded already."""
    _add(
        body,
        "light",
        name="sun",
        directional="true",
        pos=position,
        dir=SUN,
        diffuse=(0.7, 0.7, 0.66),
        specular=(0.1, 0.1, 0.1),
        castshadow="true" if shadow else "false",
    )


def _picture(world: World, wear: Wear, folder: Path, *, laid: bool = False) -> Path:
    """Return the picture of a part as a PNG, MuJoCo's only format, within OpenGL's size limit.

    MuJoCo repeats a picture from the center of a height field; such a picture is laid out beforehand: it
    covers the whole field, row 0 = north.
    """
    texture, pixels = wear.write(world, folder), wear.pixels(world)
    size, scale = world.surface.size, DRAPED_PIXELS / max(pixels.shape[:2])
    span = wear.span or max(size)
    if laid and not wear.draped:
        fits, pixels = size == (span, span), spread(pixels, size, span)
    elif not (fits := scale >= 1):
        pixels = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    if fits and texture.suffix == ".png":
        return texture
    png = texture.with_name(f"{texture.stem}-ground.png")
    write_image(folder / png, pixels)
    return png


def spread(picture: ByteArray, size: tuple[float, float], span: float) -> ByteArray:
    """Cover width x depth meters with tiles of `span` meters, from the lower left corner."""
    width, depth = size
    tiles = max(size) / span
    pixels = min(GROUND_PIXELS, math.ceil(max(picture.shape[:2]) * tiles))
    x, y = ((np.arange(max(1, round(pixels * side / max(size)))) + 0.5) for side in size)
    u, v = x / len(x) * width / span % 1, y[::-1] / len(y) * depth / span % 1
    rows, cols = picture.shape[:2]
    laid: ByteArray = picture[np.ix_(rows - 1 - (v * rows).astype(int), (u * cols).astype(int))]
    return laid


def write_hfield(path: Path, surface: HeightField) -> None:
    """Write MuJoCo's height-field file.

    The file has rows and columns as int32, then heights in meters, row 0 at -y.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        file.writelines(part.data for part in _hfield(surface))


def _checksum(*arrays: NDArray[Any]) -> str:
    """Return a checksum for a file's name.

    MuJoCo caches assets by name: a program that builds a world twice would otherwise get the old ones.
    """
    checksum = 0
    for array in arrays:
        checksum = crc32(array.data, checksum)
    return f"{checksum:08x}"


def _hfield(surface: HeightField) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the header and the heights of the file."""
    return np.array(surface.shape, "<i4"), surface.south_up.astype("<f4", copy=False)
