"""MJCF file of a world with exact heights and ground texture, for MuJoCo 3.0 and later."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree
from zlib import crc32

import mujoco
import numpy as np

from lirs_wct.contact.contact_geometry import ContactGeometry
from lirs_wct.export.appearance import world_extent
from lirs_wct.export.mjcf import BASE, world_spec
from lirs_wct.export.mjcf_look import add_look, dress
from lirs_wct.files import atomic_write
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.world import World

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

    Args:
        world: world to write.
        folder: folder of the file.

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
