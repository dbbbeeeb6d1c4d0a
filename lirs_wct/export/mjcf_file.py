"""A world as MuJoCo's files: MJCF, the heights to the bit, and the texture that the ground wears."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree
from zlib import crc32

import cv2
import mujoco
import numpy as np

from lirs_wct.arrays import ByteArray
from lirs_wct.contact.contact_geometry import ContactGeometry
from lirs_wct.export.mjcf import world_spec
from lirs_wct.export.mjcf_compat import readable_by_old
from lirs_wct.files import atomic_write
from lirs_wct.formats.images.image_writer import write_image
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.world import World

GROUND_PIXELS = 2048
"""Most pixels of the longer side of a texture that is laid out for the whole ground."""
SKY = ((0.72, 0.80, 0.90), (0.93, 0.94, 0.95))
"""Colours of the sky above and at the horizon, RGB."""

START_GROUP = 4
"""Group of sites that the viewer hides until it is asked for."""
STAND_IN = "stand-in.hfield"
"""Name of a height field of 2x2 nodes, under which MuJoCo never looks for a world's own."""


def write_mjcf(
    world: World, folder: str | Path, texture: Path | None = None, texture_size: float | None = None
) -> Path:
    """Write NAME.xml and the surface's heights as float32, to the bit; return the path of NAME.xml.

    The heights' file has their checksum in its name: MuJoCo caches assets by name, and would give the old
    ground to a program that builds a world twice.

    Args:
        world: to be written.
        folder: that holds the file.
        texture: picture inside the folder that a terrain wears, row 0 = north; None = a plain colour.
        texture_size: metres that the texture spans from the south-west corner; None = the longer side.

    Raises:
        OutputError: the folder cannot be written.
    """
    path = Path(folder) / f"{world.name}.xml"
    # Seen in the viewer as it opens: it hides group 3.
    contact_geometry: ContactGeometry = "convex" if world.overhangs else "hfield"
    spec = world_spec(world, group=0, contact_geometry=contact_geometry, heights=False)
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=SKY[0],
        rgb2=SKY[1],
        width=64,
        height=64,
    )
    _mark_starts(spec, world)
    for hfield in spec.hfields:
        hfield.file = _write_heights(world, path.parent)
        if texture is not None:
            _dress(spec, world.surface, path.parent, texture, texture_size or max(world.surface.size))
    with atomic_write(path) as temporary:
        temporary.write_text(_exact_xml(spec), encoding="utf-8")
    return path


def _mark_starts(spec: mujoco.MjSpec, world: World) -> None:
    """Add a site for each start, on the ground: a robot is attached to `start`, the first of them.

    A keyframe would hold joint positions, and a world has no joint.
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
    """Write MuJoCo's height-field file: rows and columns as int32, then heights, row 0 at -y, in metres.

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


def _dress(spec: mujoco.MjSpec, surface: HeightField, folder: Path, texture: Path, span: float) -> None:
    """Lay a texture on the ground from its south-west corner, as `cube_uv` does.

    MuJoCo reads PNG alone and lays it from the middle, so that most pictures are laid out beforehand.
    """
    if texture.suffix != ".png" or surface.size != (span, span):
        picture = cv2.imread(str(folder / texture))
        assert picture is not None, "a texture is read once before it is kept"
        laid = spread(picture, surface.size, span)
        texture = texture.with_name(f"{texture.stem}-ground.png")
        write_image(folder / texture, laid)
    spec.assets = dict(spec.assets) | {texture.as_posix(): (folder / texture).read_bytes()}
    spec.add_texture(name="ground", type=mujoco.mjtTexture.mjTEXTURE_2D, file=texture.as_posix())
    material = spec.add_material(name="ground")
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "ground"
    ground = next(geom for geom in spec.worldbody.geoms if geom.name == "ground")
    ground.material, ground.rgba = "ground", (1.0, 1.0, 1.0, 1.0)


def spread(picture: ByteArray, size: tuple[float, float], span: float) -> ByteArray:
    """Return a picture that covers width x depth metres with tiles of `span` metres from its lower left."""
    width, depth = size
    tiles = max(size) / span
    pixels = min(GROUND_PIXELS, math.ceil(max(picture.shape[:2]) * tiles))
    x, y = ((np.arange(max(1, round(pixels * side / max(size)))) + 0.5) for side in size)
    u, v = x / len(x) * width / span % 1, y[::-1] / len(y) * depth / span % 1
    rows, cols = picture.shape[:2]
    laid: ByteArray = picture[np.ix_(rows - 1 - (v * rows).astype(int), (u * cols).astype(int))]
    return laid


def _exact_xml(spec: mujoco.MjSpec) -> str:
    """Return the specification's XML with sizes and positions in full; MuJoCo writes six digits.

    MuJoCo wants the heights' files for that, and keeps them: it gets a stand-in under another name.
    """
    files = [hfield.file for hfield in spec.hfields]
    for hfield in spec.hfields:
        hfield.file = STAND_IN
    spec.assets = dict(spec.assets) | {
        STAND_IN: np.array((2, 2), "<i4").tobytes() + np.eye(2, dtype="<f4").tobytes()
    }
    spec.compile()
    root = ElementTree.fromstring(spec.to_xml())
    for element, file in zip(root.iterfind("asset/hfield"), files, strict=True):
        element.set("file", file)
    for element, item in (
        *zip(root.iterfind("asset/hfield"), spec.hfields, strict=True),
        *zip(root.iterfind("worldbody/geom"), spec.worldbody.geoms, strict=True),
        *zip(root.iterfind("worldbody/site"), spec.worldbody.sites, strict=True),
    ):
        for attribute in ("pos", "size", "quat"):
            if attribute in element.attrib:
                element.set(attribute, " ".join(f"{v:.12g}" for v in getattr(item, attribute)))
    readable_by_old(root)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"
