"""A world file of gz-sim, made of one of Gazebo classic: systems, frames of starts, PBR material."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from lirs_wct.geometry.pose import Pose3

VERSION = "1.9"
SYSTEMS = (
    ("gz-sim-physics-system", "gz::sim::systems::Physics"),
    ("gz-sim-user-commands-system", "gz::sim::systems::UserCommands"),
    ("gz-sim-scene-broadcaster-system", "gz::sim::systems::SceneBroadcaster"),
    ("gz-sim-contact-system", "gz::sim::systems::Contact"),
    ("gz-sim-imu-system", "gz::sim::systems::Imu"),
    ("gz-sim-sensors-system", "gz::sim::systems::Sensors"),
)
"""What gz-sim does with a world only if the file says so: step it, show it, run lidars, cameras and IMUs."""


def gz_world_sdf(classic: str, model: str, *, starts: Sequence[Pose3] = (), albedo: str | None = None) -> str:
    """Return a world file for gz-sim without search path: the model stands in it, its files are relative.

    Args:
        classic: world file of Gazebo classic, whose physics, light, scene and place on earth are kept.
        model: file of the included model.
        starts: frames `start`, `start1`, ... that robots are set down in.
        albedo: path of the texture that the model's one visual wears; None = what its mesh file says.
    """
    root = ElementTree.fromstring(classic)
    root.set("version", VERSION)
    world = root.find("world")
    assert world is not None
    for element in (*world.findall("gui"), *world.findall("include")):
        world.remove(element)
    for k, (file, name) in enumerate(SYSTEMS):
        system = ElementTree.Element("plugin", filename=file, name=name)
        if file == "gz-sim-sensors-system":
            ElementTree.SubElement(system, "render_engine").text = "ogre2"
        world.insert(k, system)
    world.append(_model(model, albedo))
    for k, pose in enumerate(starts):
        frame = ElementTree.SubElement(world, "frame", name=f"start{k or ''}")
        x, y, z = pose.position.tolist()
        ElementTree.SubElement(frame, "pose").text = f"{x:.6g} {y:.6g} {z:.6g} 0 0 {pose.yaw:.6g}"
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _model(text: str, albedo: str | None) -> ElementTree.Element:
    """Return the model of a model file with paths relative to its folder, and a material for PBR."""
    model = ElementTree.fromstring(text).find("model")
    assert model is not None
    prefix = f"model://{model.get('name')}/"
    for element in model.iter():
        if element.text and element.text.startswith(prefix):
            element.text = element.text.removeprefix(prefix)
    for visual in model.iter("visual"):
        if albedo is not None and visual.find("geometry/mesh") is not None:
            material = ElementTree.SubElement(visual, "material")
            for color in ("ambient", "diffuse"):
                ElementTree.SubElement(material, color).text = "1 1 1 1"
            ElementTree.SubElement(material, "specular").text = "0 0 0 1"
            metal = ElementTree.SubElement(ElementTree.SubElement(material, "pbr"), "metal")
            ElementTree.SubElement(metal, "albedo_map").text = albedo
            ElementTree.SubElement(metal, "roughness").text = "1"
            ElementTree.SubElement(metal, "metalness").text = "0"
    return model
