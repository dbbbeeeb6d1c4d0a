"""MJCF as the MuJoCo versions that users have read it: what a newer one writes by default is left out."""

from __future__ import annotations

from xml.etree import ElementTree

OLDEST_MUJOCO = "3.0.0"
"""The oldest version that reads what is written; `.ci/run` loads worlds with it."""


def readable_by_old(root: ElementTree.Element) -> None:
    """Rewrite a model in place so that every MuJoCo from `OLDEST_MUJOCO` on reads it, to the same ground.

    - `sleep` makes static geoms cheaper and changes no motion; 3.3 refuses it.
    - `colorspace` is that of the texture's file without it; 3.2 refuses it.
    - `type` of a light was `directional`, which all versions read.
    - `inertia` of a mesh says how that of an open one is computed, and static geoms have no use for it. Only
      a mesh in several tiles keeps it, since a flat tile has no volume: 3.2 refuses those worlds.
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
