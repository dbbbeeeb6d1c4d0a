"""MJCF file of a world with exact heights and ground texture, for MuJoCo 3.0 and later."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree
from zlib import crc32

import cv2
import mujoco
import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.contact.contact_geometry import ContactGeometry
from lirs_wct.export.appearance import Wear, ground_wear, world_extent, world_parts
from lirs_wct.export.mjcf import BASE, world_spec
from lirs_wct.files import atomic_write
from lirs_wct.formats.images.picture import write_image
from lirs_wct.formats.meshes.obj import write_obj
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.geometry.viewpoint import AZIMUTH, ELEVATION, Viewpoint, overview
from lirs_wct.meshing.tiles import MUJOCO_FACES, split_tiles
from lirs_wct.world import World

SKY = ((0.72, 0.80, 0.90), (0.93, 0.94, 0.95))
"""Colors of the sky above and at the horizon, RGB."""
SUN = (0.5, -0.5, -0.7071)
"""Direction in which the light travels: from the north-west, as in the drawn textures."""
NEAR, FAR, DEPTHS = 0.02, 5.0, 4e5
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


def add_look(spec: mujoco.MjSpec, world: World, low: FloatArray, high: FloatArray) -> None:
    """Add sky, light and cameras, and set the extent and the near plane.

    Args:
        spec: specification of the world.
        world: source of the start poses.
        low: (3,) lowest corner of the visible part, meters.
        high: (3,) highest corner of the visible part, meters.
    """
    middle, extent = (low + high) / 2, 0.8 * float(np.linalg.norm(high - low))
    spec.stat.center, spec.stat.extent = middle, extent
    # A share of the extent, by default 1 %: half a meter in a world of 50 m.
    spec.visual.map.znear, spec.visual.map.zfar = max(NEAR / extent, FAR / DEPTHS), FAR
    spec.visual.global_.azimuth, spec.visual.global_.elevation = (
        math.degrees(AZIMUTH),
        math.degrees(ELEVATION),
    )
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1920, 1080
    spec.visual.headlight.ambient[:] = 0.5
    spec.visual.headlight.diffuse[:] = 0.2
    spec.visual.headlight.specular[:] = 0.0
    for light in list(spec.worldbody.lights):
        spec.delete(light)
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=middle - extent * np.array(SUN),
        dir=SUN,
        diffuse=(0.7, 0.7, 0.66),
        specular=(0.1, 0.1, 0.1),
        # Its own shadow speckles a height field, whose drawn texture is shaded already.
        castshadow=not len(spec.hfields),
    )
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=SKY[0],
        rgb2=SKY[1],
        width=64,
        height=64,
    )
    _add_camera(spec, "overview", overview(low, high, FOVY))
    if world.spawn_poses:
        pose = world.spawn_poses[0]
        eye = float(world.surface.height_at(pose.x, pose.y)) + EYE
        _add_camera(spec, "start", Viewpoint((pose.x, pose.y, eye), pose.yaw, DOWN))


def _add_camera(spec: mujoco.MjSpec, name: str, viewpoint: Viewpoint) -> None:
    forward, right, up = viewpoint.axes
    quat = np.empty(4)
    # A camera looks along its -z, with x to the right.
    mujoco.mju_mat2Quat(quat, np.stack((right, up, -forward), axis=1).ravel())
    spec.worldbody.add_camera(name=name, pos=viewpoint.position, quat=quat, fovy=math.degrees(FOVY))


def dress(spec: mujoco.MjSpec, world: World, folder: Path) -> None:
    """Add the ground's texture; add the world's own mesh if no height field is visible.

    Args:
        spec: specification whose height field, if any, is named `ground`.
        world: source of textures and mesh.
        folder: folder of the written textures and meshes.

    Raises:
        OutputError: a file cannot be written.
    """
    if len(spec.hfields):
        wear = ground_wear(world)
        material = _add_material(spec, wear.name, _picture_on_field(world, wear, folder), folder)
        # The border shows the center of the outermost pixels; otherwise it would mix in the opposite ones.
        rows, cols = wear.pixels(world).shape[:2]
        material.texrepeat = (1 - 1 / cols, 1 - 1 / rows) if wear.draped else (1.0, 1.0)
        ground = next(geom for geom in spec.worldbody.geoms if geom.name == "ground")
        ground.material, ground.rgba = wear.name, (1.0, 1.0, 1.0, 1.0)
        return
    for geom in spec.worldbody.geoms:
        geom.group = TOUCHED_GROUP
    for part in world_parts(world, world.file_mesh):
        _add_material(spec, part.wear.name, _as_png(world, part.wear, folder), folder)
        tiles = list(split_tiles(part.mesh, aim=MUJOCO_FACES // 2))
        for k, tile in enumerate(tiles):
            name = f"{part.wear.name}-seen{k}"
            mesh = spec.add_mesh(name=name, file=_write_tile(spec, tile, f"{world.name}-{name}", folder))
            if len(tiles) > 1:
                # A tile is open: it may have no volume for an inertia.
                mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            spec.worldbody.add_geom(
                name=name,
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=name,
                material=part.wear.name,
                contype=0,
                conaffinity=0,
                group=SEEN_GROUP,
            )


def _write_tile(spec: mujoco.MjSpec, tile: TriangleMesh, stem: str, folder: Path) -> str:
    """Write a mesh and return its file name, which contains its checksum."""
    content = (np.ascontiguousarray(a, np.float32) for a in (tile.vertices, tile.uv))
    checksum = 0
    for array in content:
        checksum = crc32(array.data, checksum)
    file = f"{stem}-{checksum:08x}.obj"
    write_obj(folder / file, tile)
    spec.assets = dict(spec.assets) | {file: (folder / file).read_bytes()}
    return file


def _add_material(spec: mujoco.MjSpec, name: str, texture: Path, folder: Path) -> mujoco.MjsMaterial:
    spec.assets = dict(spec.assets) | {texture.as_posix(): (folder / texture).read_bytes()}
    spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=texture.as_posix())
    material = spec.add_material(name=name, specular=0.0, shininess=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    return material


def _picture_on_field(world: World, wear: Wear, folder: Path) -> Path:
    """Return the PNG that covers the whole height field, row 0 = north.

    MuJoCo repeats a picture from the center, so that most pictures are tiled beforehand.
    """
    if wear.draped:
        return _as_png(world, wear, folder)
    size, texture = world.surface.size, wear.write(world, folder)
    span = wear.span or max(size)
    if texture.suffix == ".png" and size == (span, span):
        return texture
    laid = texture.with_name(f"{texture.stem}-ground.png")
    write_image(folder / laid, spread(wear.pixels(world), size, span))
    return laid


def _as_png(world: World, wear: Wear, folder: Path) -> Path:
    """Return the part's picture as a PNG, MuJoCo's only format, within OpenGL's size limit."""
    texture, pixels = wear.write(world, folder), wear.pixels(world)
    scale = DRAPED_PIXELS / max(pixels.shape[:2])
    if texture.suffix == ".png" and scale >= 1:
        return texture
    if scale < 1:
        pixels = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
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


START_GROUP = 4
"""Group of sites that the viewer hides by default."""
STAND_INS = {
    "stand-in.hfield": np.array((2, 2), "<i4").tobytes() + np.eye(2, dtype="<f4").tobytes(),
    "stand-in.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n",
}
"""Substitutes for a world's files of heights and meshes, under names that no real file has."""
OLDEST_MUJOCO = "3.0.0"
"""The oldest version that reads the written files; `.ci/run` loads worlds with it."""


def write_mjcf(world: World, folder: str | Path) -> Path:
    """Write NAME.xml, the surface's exact float32 heights, and the ground's texture.

    The name of the heights' file contains their checksum. MuJoCo caches assets by name and would otherwise
    return the old ground to a program that builds a world twice. If no height field is visible (a laser map,
    a mesh with overhangs), the world's own mesh is visible, and the contact geoms are in group 3.

    Returns:
        The path of NAME.xml.

    Raises:
        OutputError: the folder cannot be written.
    """
    path = Path(folder) / f"{world.name}.xml"
    # Group 0 is visible when the viewer opens; it hides group 3.
    contact_geometry: ContactGeometry = "convex" if world.overhangs else "hfield"
    spec = world_spec(world, group=0, contact_geometry=contact_geometry, heights=False, seen=False)
    low, high = world_extent(world)
    if len(spec.hfields):
        low[2] -= BASE
    add_look(spec, world, low, high)
    _mark_starts(spec, world)
    for hfield in spec.hfields:
        hfield.file = _write_heights(world, path.parent)
    dress(spec, world, path.parent)
    with atomic_write(path) as temporary:
        temporary.write_text(_exact_xml(spec), encoding="utf-8")
    return path


def _mark_starts(spec: mujoco.MjSpec, world: World) -> None:
    """Add a site on the ground for each start; robots attach to the first, `start`.

    A keyframe would not work: it stores joint positions, and a world has no joint.
    """
    for k, pose in enumerate(world.spawn_poses):
        spec.worldbody.add_site(
            name=f"start{k or ''}",
            pos=(pose.x, pose.y, float(world.surface.height_at(pose.x, pose.y))),
            quat=(math.cos(pose.yaw / 2), 0.0, 0.0, math.sin(pose.yaw / 2)),
            group=START_GROUP,
        )


def _write_heights(world: World, folder: Path) -> str:
    """Write the height field's file and return its name."""
    name = f"{world.name}-{_checksum(world.surface):08x}.hfield"
    write_hfield(folder / name, world.surface)
    return name


def write_hfield(path: Path, surface: HeightField) -> None:
    """Write MuJoCo's height-field file.

    The file has rows and columns as int32, then heights in meters, row 0 at -y.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        file.writelines(_hfield(surface))


def _checksum(surface: HeightField) -> int:
    header, heights = _hfield(surface)
    return crc32(heights, crc32(header))


def _hfield(surface: HeightField) -> tuple[memoryview, memoryview]:
    return np.array(surface.shape, "<i4").data, surface.south_up.astype("<f4", copy=False).data


def _exact_xml(spec: mujoco.MjSpec) -> str:
    """Return the specification's XML with full precision; MuJoCo writes six digits.

    MuJoCo requires the files of heights and meshes for that and keeps them: it gets small substitutes.
    """
    own = [item for item in (*spec.hfields, *spec.meshes) if item.file]
    files = [item.file for item in own]
    for item, stand_in in ((item, f"stand-in{Path(item.file).suffix}") for item in own):
        item.file = stand_in
    spec.assets = dict(spec.assets) | STAND_INS
    spec.compile()
    root = ElementTree.fromstring(spec.to_xml())
    elements = [
        e for kind in ("hfield", "mesh") for e in root.iterfind(f"asset/{kind}") if "file" in e.attrib
    ]
    for element, file in zip(elements, files, strict=True):
        element.set("file", file)
    for element, item in (
        *zip(root.iterfind("asset/hfield"), spec.hfields, strict=True),
        *zip(root.iterfind("worldbody/geom"), spec.worldbody.geoms, strict=True),
        *zip(root.iterfind("worldbody/site"), spec.worldbody.sites, strict=True),
    ):
        for attribute in ("pos", "size", "quat"):
            if attribute in element.attrib:
                element.set(attribute, " ".join([f"{v:.12g}" for v in getattr(item, attribute).tolist()]))
    readable_by_old(root)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def readable_by_old(root: ElementTree.Element) -> None:
    """Rewrite a model in place so that every MuJoCo from `OLDEST_MUJOCO` on reads it.

    The ground stays the same.

    - `sleep` makes static geoms cheaper and changes no motion; 3.3 rejects it.
    - `colorspace` defaults to that of the texture's file; 3.2 rejects it.
    - `type` of a light was `directional`, which all versions read.
    - `inertia` of a mesh selects the inertia of an open mesh; static geoms do not need it. Only a mesh in
      several tiles keeps it, because a flat tile has no volume: 3.2 rejects those worlds.
    """
    for option in root.findall("option"):
        for flag in option.findall("flag"):
            flag.attrib.pop("sleep", None)
            if not flag.attrib:
                option.remove(flag)
        if not option.attrib and not len(option):
            root.remove(option)
    for texture in root.iter("texture"):
        texture.attrib.pop("colorspace", None)
    for light in root.iter("light"):
        if light.attrib.get("type") == "directional":
            del light.attrib["type"]
            light.set("directional", "true")
    shells = [mesh for mesh in root.iter("mesh") if mesh.attrib.get("inertia") == "shell"]
    for mesh in shells if len(shells) == 1 else ():
        del mesh.attrib["inertia"]
