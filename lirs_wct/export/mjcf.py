"""MJCF file of a world for MuJoCo 3.0 and later: exact heights, textures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from zlib import crc32

import cv2
import numpy as np
from numpy.typing import NDArray

from lirs_wct.contact.spec import BASE, contact_spec
from lirs_wct.export.appearance import Wear, ground_wear, world_extent, world_parts
from lirs_wct.files import atomic_write
from lirs_wct.formats.meshes.writers import write_obj
from lirs_wct.formats.picture import write_image
from lirs_wct.geometry import ByteArray, FloatArray, HeightField, Viewpoint
from lirs_wct.geometry.mesh import MUJOCO_FACES, split_tiles
from lirs_wct.geometry.pose import AZIMUTH, ELEVATION, overview
from lirs_wct.world import World

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
Numbers = float | Sequence[float] | FloatArray


def write_mjcf(world: World, folder: str | Path) -> Path:
    """Write NAME.xml, the surface's exact float32 heights, and the ground's texture.

    If no height field is visible (a laser map, a mesh with overhangs), the world's own mesh is visible, and
    the contact geoms are in group 3. Returns the path of NAME.xml.
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
    # Robots attach to the first site, `start`. A keyframe stores joint positions; a world has no joint.
    for k, start in enumerate(world.starts_on_ground):
        name = f"start{k or ''}"
        _add(body, "site", name=name, pos=start.position, quat=start.quaternion, group=START_GROUP)
    _add_cameras(body, world, low, high)
    # A shadow speckles a height field, whose drawn texture is shaded already.
    shadow = "false" if contact.hfields else "true"
    light: dict[str, Any] = {"directional": "true", "pos": center - extent * np.array(SUN), "dir": SUN}
    colors = {"diffuse": (0.7, 0.7, 0.66), "specular": (0.1, 0.1, 0.1)}
    _add(body, "light", name="sun", **light, **colors, castshadow=shadow)
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


def _copy_contact_geoms(assets: Element, body: Element, contact: Any) -> None:
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
            checksum = _checksum(*(np.ascontiguousarray(a, np.float32) for a in (tile.vertices, tile.uv)))
            file = f"{world.name}-{name}-{checksum}.obj"
            write_obj(folder / file, [("ground", tile, None)])
            _add(assets, "mesh", name=name, file=file, **inertia)
            seen: dict[str, Any] = {
                "mesh": name,
                "material": wear,
                "contype": 0,
                "conaffinity": 0,
                "group": SEEN_GROUP,
            }
            _add(body, "geom", name=name, type="mesh", **seen)


def _add_material(assets: Element, name: str, texture: Path, **attributes: Numbers) -> None:
    _add(assets, "texture", name=name, type="2d", file=texture.as_posix())
    _add(assets, "material", name=name, texture=name, specular=0, shininess=0, **attributes)


def _add_cameras(body: Element, world: World, low: FloatArray, high: FloatArray) -> None:
    """Add a camera that sees the whole world, and one above the first start pose."""
    viewpoints = {"overview": overview(low, high, FOVY)}
    if world.spawn_poses:
        start = world.starts_on_ground[0]
        viewpoints["start"] = Viewpoint((start.x, start.y, start.z + EYE), world.spawn_poses[0].yaw, DOWN)
    for name, viewpoint in viewpoints.items():
        _, right, up = viewpoint.axes
        _add(body, "camera", name=name, pos=viewpoint.position, xyaxes=(*right, *up), fovy=math.degrees(FOVY))


def _picture(world: World, wear: Wear, folder: Path, *, laid: bool = False) -> Path:
    """Return a part's picture as a PNG, MuJoCo's only format, within OpenGL's limit.

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
