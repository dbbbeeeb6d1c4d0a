"""Gazebo's files: model packages, worlds and heightmaps.

Models and worlds are SDF 1.6, which Gazebo 9 to Harmonic read; worlds for gz-sim are SDF 1.9.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from lirs_wct.errors import ConfigError
from lirs_wct.formats.picture import write_image
from lirs_wct.geometry import ByteArray, HeightField, Pose3, Viewpoint, resample
from lirs_wct.geometry.geodesy import Place

VERSION = "1.6"
GRAVITY = 9.80665
FRICTION = 0.9
"""Coulomb's coefficient of the ground."""


def model_config(name: str) -> str:
    """Return `model.config`, which makes a folder a Gazebo model package."""
    return f"""<?xml version="1.0"?>
<model>
  <name>{escape(name)}</name>
  <version>1.0</version>
  <sdf version="{VERSION}">model.sdf</sdf>
  <author>
    <name>LIRS-WCT</name>
    <email></email>
  </author>
  <description>Static world built by LIRS-WCT.</description>
</model>
"""


def model_sdf(name: str, mesh: str) -> str:
    """Return `model.sdf`: one static link whose visual and collision geometry is the same mesh."""
    geometry = f"<geometry><mesh><uri>{escape(model_uri(name, mesh))}</uri></mesh></geometry>"
    surface = f"""
        <surface>
          <friction>
            <ode><mu>{FRICTION}</mu><mu2>{FRICTION}</mu2></ode>
          </friction>
        </surface>"""
    return _static_model(name, geometry, geometry + surface)


def _static_model(name: str, visual: str, collision: str) -> str:
    """Return a model of one static link with its visual and collision elements."""
    return f"""<?xml version="1.0"?>
<sdf version="{VERSION}">
  <model name={quoteattr(name)}>
    <static>true</static>
    <link name="ground">
      <visual name="visual">
        {visual}
      </visual>
      <collision name="collision">
        {collision}
      </collision>
    </link>
  </model>
</sdf>
"""


def spherical_coordinates(place: Place | None) -> str:
    """Return the element of the world's place on the earth; empty without a known latitude.

    The heading is the angle from east to the world's x axis, counter-clockwise, as gz-sim's NavSat applies it
    (gz-math, `LOCAL2`). Gazebo classic needs 180 deg minus this value (gazebo-classic #2022).
    """
    if place is None:
        return ""
    try:
        latitude, longitude = (float(value) for value in place.to_geographic(0.0, 0.0))
        heading = place.heading()
    except ConfigError:
        return ""
    return f"""
    <spherical_coordinates>
      <surface_model>EARTH_WGS84</surface_model>
      <world_frame_orientation>ENU</world_frame_orientation>
      <latitude_deg>{latitude:.9f}</latitude_deg>
      <longitude_deg>{longitude:.9f}</longitude_deg>
      <elevation>{place.height or 0.0:.4f}</elevation>
      <heading_deg>{heading:.6f}</heading_deg>
    </spherical_coordinates>"""


_DAYLIGHT = """    <scene>
      <ambient>0.4 0.4 0.4 1</ambient>
      <background>0.7 0.8 0.9 1</background>
      <shadows>true</shadows>
    </scene>
    <light name="sun" type="directional">
      <pose>0 0 100 0 0 0</pose>
      <cast_shadows>true</cast_shadows>
      <diffuse>0.8 0.8 0.8 1</diffuse>
      <specular>0.2 0.2 0.2 1</specular>
      <attenuation>
        <range>10000</range>
        <constant>0.9</constant>
        <linear>0.01</linear>
        <quadratic>0.001</quadratic>
      </attenuation>
      <direction>-0.5 0.1 -0.9</direction>
    </light>
"""


def world_sdf(
    name: str, *, view: Viewpoint | None = None, place: Place | None = None, starts: Sequence[Pose3] = ()
) -> str:
    """Return a world file with a sun and the model, which is its only ground.

    The view is that of the user's camera as the window opens. Gazebo classic stores no start poses of robots;
    a comment holds the commands.
    """
    gui = ""
    if view is not None:
        pose = " ".join(f"{value:.6g}" for value in (*view.position, 0.0, view.pitch, view.yaw))
        gui = f"""    <gui>
      <camera name="user_camera">
        <pose>{pose}</pose>
      </camera>
    </gui>
"""
    return f"""<?xml version="1.0"?>
<sdf version="{VERSION}">
  <world name={quoteattr(name)}>
    <gravity>0 0 {-GRAVITY}</gravity>
    <physics name="default" type="ode">
      <max_step_size>0.001</max_step_size>
      <real_time_factor>1</real_time_factor>
      <real_time_update_rate>1000</real_time_update_rate>
    </physics>{spherical_coordinates(place)}
{_spawning(starts)}{gui}{_DAYLIGHT}    <include>
      <uri>{escape(model_uri(name))}</uri>
    </include>
  </world>
</sdf>
"""


def _spawning(starts: Sequence[Pose3]) -> str:
    """Return a comment with the commands that place a robot at a start."""
    if not starts:
        return ""
    at, *others = (f"-x {p.x:.3f} -y {p.y:.3f} -z {p.z:.3f} -Y {p.yaw:.4f}" for p in starts)
    more = "".join(f"\n         or at {other}" for other in others)
    return f"""    <!-- Starts on the ground; add to z how high the origin of the robot's model is:
         ros2 run gazebo_ros spawn_entity.py -entity robot -file robot.urdf {at}
         gz model -f robot.sdf -m robot {at}{more}
    -->
"""


def model_uri(name: str, inside: str = "") -> str:
    """Return the URI of a model package or of a file in it."""
    uri = f"model://{name}/{inside}" if inside else f"model://{name}"
    if any(c.isspace() for c in uri):
        raise ConfigError(f"Gazebo finds no names with spaces, got {uri!r}")
    return uri


GZ_VERSION = "1.9"
SYSTEMS = (
    ("gz-sim-physics-system", "gz::sim::systems::Physics"),
    ("gz-sim-user-commands-system", "gz::sim::systems::UserCommands"),
    ("gz-sim-scene-broadcaster-system", "gz::sim::systems::SceneBroadcaster"),
    ("gz-sim-contact-system", "gz::sim::systems::Contact"),
    ("gz-sim-imu-system", "gz::sim::systems::Imu"),
    ("gz-sim-sensors-system", "gz::sim::systems::Sensors"),
)
"""Plugins that gz-sim needs in the file to step and show a world and to run lidars, cameras and IMUs."""


def gz_world_sdf(classic: str, model: str, *, starts: Sequence[Pose3] = (), albedo: str | None = None) -> str:
    """Return a world file for gz-sim that contains the model, with relative paths.

    Args:
        classic: World file of Gazebo classic, whose physics, light, scene and place on earth are kept.
        model: Text of the included model's file.
        starts: Poses of the frames `start`, `start1`, ... for robots.
        albedo: Path of the texture of the model's visual; None = the mesh file's material.
    """
    root = ElementTree.fromstring(classic)
    root.set("version", GZ_VERSION)
    world = root.find("world")
    assert world is not None
    for element in (*world.findall("gui"), *world.findall("include")):
        world.remove(element)
    for k, (file, name) in enumerate(SYSTEMS):
        system = ElementTree.Element("plugin", filename=file, name=name)
        if file == "gz-sim-sensors-system":
            ElementTree.SubElement(system, "render_engine").text = "ogre2"
        world.insert(k, system)
    world.append(_included_model(model, albedo))
    for k, pose in enumerate(starts):
        frame = ElementTree.SubElement(world, "frame", name=f"start{k or ''}")
        x, y, z = pose.position.tolist()
        ElementTree.SubElement(frame, "pose").text = f"{x:.6g} {y:.6g} {z:.6g} 0 0 {pose.yaw:.6g}"
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _included_model(text: str, albedo: str | None) -> ElementTree.Element:
    """Return the model element with paths relative to its folder, and a PBR material."""
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


SIDES = tuple(2**n + 1 for n in range(4, 13))
"""Legal pixels per side: 17 to 4097."""


def write_heightmap(path: Path, surface: HeightField) -> None:
    """Write gray levels as PNG: 0 is the lowest point, 255 the highest.

    The picture has the smallest legal side that is not coarser than the surface, at most 4097. It has 8 bits,
    since Gazebo reads 16 bits as infinite heights.
    """
    side = next((side for side in SIDES if side >= max(surface.shape)), SIDES[-1])
    above = surface.z - surface.z.min()
    levels = resample(above, side, side) * np.float32(255 / max(surface.relief, 1e-9))
    write_image(path, np.clip(np.rint(levels), 0, 255).astype(np.uint8))


@dataclass(frozen=True)
class Layer:
    """Texture of a heightmap: its files inside the package, and the meters until it repeats."""

    diffuse: str
    normal: str
    span: float


def flat_normals() -> ByteArray:
    """Return the (16, 16, 3) BGR normal map of a flat texture (normals along z)."""
    return np.full((16, 16, 3), (255, 128, 128), np.uint8)


def heightmap_sdf(name: str, surface: HeightField, picture: str, layer: Layer | None = None) -> str:
    """Return `model.sdf` of a heightmap model; without a layer, it is Gazebo's gray."""
    width, depth = surface.size
    west, south, east, north = surface.bounds
    # Gazebo divides by the height: level ground gets a millimeter.
    size = f"<size>{width:.9g} {depth:.9g} {max(surface.relief, 1e-3):.9g}</size>"
    place = f"<pos>{(west + east) / 2:.9g} {(south + north) / 2:.9g} {float(surface.z.min()):.9g}</pos>"
    uri = f"<uri>{escape(model_uri(name, picture))}</uri>"
    look = ""
    if layer is not None:
        diffuse, normal = (escape(model_uri(name, path)) for path in (layer.diffuse, layer.normal))
        look = (
            f"<texture><diffuse>{diffuse}</diffuse><normal>{normal}</normal>"
            f"<size>{layer.span:.9g}</size></texture>"
        )
    visual, collision = (
        f"<geometry><heightmap>{uri}{texture}{size}{place}</heightmap></geometry>" for texture in (look, "")
    )
    return _static_model(name, visual, collision)
