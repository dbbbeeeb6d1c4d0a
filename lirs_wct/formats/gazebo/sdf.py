"""Gazebo's files: the model package and a world that includes it (SDF 1.6, read by Gazebo 9 to Harmonic)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

from lirs_wct.errors import ConfigError
from lirs_wct.field_validators import require_above, require_at_least
from lirs_wct.geometry.geodesy.place import Place
from lirs_wct.geometry.pose import Pose3
from lirs_wct.geometry.viewpoint import Viewpoint

VERSION = "1.6"
FRICTION = 0.9
"""Coulomb's coefficient of the ground."""


@dataclass(frozen=True, kw_only=True)
class Physics:
    """How Gazebo steps the world.

    Attributes:
        timestep: seconds.
        real_time_factor: simulated seconds a wall second aimed at; 0 = as fast as possible.
        gravity: meters a second squared along x, y, z.

    Raises:
        ConfigError: the timestep is not above 0, or the factor is negative.
    """

    timestep: float = 0.001
    real_time_factor: float = 1.0
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.80665)

    def __post_init__(self) -> None:
        require_above(self, 0, "timestep", unit="s")
        require_at_least(self, 0, "real_time_factor")


def model_config(name: str, *, author: str = "LIRS-WCT", description: str = "") -> str:
    """Return `model.config`, which makes a folder a Gazebo model package."""
    return f"""<?xml version="1.0"?>
<model>
  <name>{escape(name)}</name>
  <version>1.0</version>
  <sdf version="{VERSION}">model.sdf</sdf>
  <author>
    <name>{escape(author)}</name>
    <email></email>
  </author>
  <description>{escape(description or "Static world built by LIRS-WCT.")}</description>
</model>
"""


def model_sdf(name: str, *, mesh: str | None = None, friction: float = FRICTION) -> str:
    """Return `model.sdf`: one static link whose visual and collision geometry is the same mesh.

    Args:
        name: of the model and of its folder.
        mesh: path of the mesh inside the package; default `meshes/NAME.dae`.
        friction: Coulomb's coefficient of the surface.

    Raises:
        ConfigError: the name holds spaces, or friction is not above 0.
    """
    if not 0 < friction < float("inf"):
        raise ConfigError(f"friction must be a finite number above 0, got {friction}")
    uri = model_uri(name, mesh or f"meshes/{name}.dae")
    geometry = f"<geometry><mesh><uri>{escape(uri)}</uri></mesh></geometry>"
    return f"""<?xml version="1.0"?>
<sdf version="{VERSION}">
  <model name={quoteattr(name)}>
    <static>true</static>
    <link name="ground">
      <visual name="visual">
        {geometry}
      </visual>
      <collision name="collision">
        {geometry}
        <surface>
          <friction>
            <ode><mu>{friction:g}</mu><mu2>{friction:g}</mu2></ode>
          </friction>
        </surface>
      </collision>
    </link>
  </model>
</sdf>
"""


def spherical_coordinates(place: Place | None) -> str:
    """Return the element that says where the world lies; nothing where its latitude is not known.

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
    name: str,
    *,
    model: str | None = None,
    physics: Physics | None = None,
    view: Viewpoint | None = None,
    place: Place | None = None,
    starts: Sequence[Pose3] = (),
) -> str:
    """Return a world file with a sun and the model, which is its only ground.

    Args:
        name: of the world.
        model: name of the included model; default the same.
        physics: timestep, pace, gravity.
        view: of the user's camera as the window opens; None = Gazebo's, near the origin.
        place: of the world on the earth.
        starts: of robots, on the ground. Gazebo classic keeps no such poses: a comment has the commands.
    """
    step = physics or Physics()
    # Without a target update rate Gazebo runs as fast as it can.
    rate = step.real_time_factor / step.timestep
    x, y, z = step.gravity
    return f"""<?xml version="1.0"?>
<sdf version="{VERSION}">
  <world name={quoteattr(name)}>
    <gravity>{x:g} {y:g} {z:g}</gravity>
    <physics name="default" type="ode">
      <max_step_size>{step.timestep:g}</max_step_size>
      <real_time_factor>{step.real_time_factor:g}</real_time_factor>
      <real_time_update_rate>{rate:g}</real_time_update_rate>
    </physics>{spherical_coordinates(place)}
{_spawning(starts)}{_gui(view)}{_DAYLIGHT}    <include>
      <uri>{escape(model_uri(model or name))}</uri>
    </include>
  </world>
</sdf>
"""


def _spawning(starts: Sequence[Pose3]) -> str:
    """Return a comment with the commands that set a robot down at a start."""
    if not starts:
        return ""
    at, *others = (f"-x {p.x:.3f} -y {p.y:.3f} -z {p.z:.3f} -Y {p.yaw:.4f}" for p in starts)
    more = "".join(f"\n         or at {other}" for other in others)
    return f"""    <!-- Starts on the ground; add to z how high the origin of the robot's model is:
         ros2 run gazebo_ros spawn_entity.py -entity robot -file robot.urdf {at}
         gz model -f robot.sdf -m robot {at}{more}
    -->
"""


def _gui(view: Viewpoint | None) -> str:
    if view is None:
        return ""
    pose = " ".join(f"{value:.6g}" for value in (*view.position, 0.0, view.pitch, view.yaw))
    return f"""    <gui>
      <camera name="user_camera">
        <pose>{pose}</pose>
      </camera>
    </gui>
"""


def model_uri(name: str, inside: str = "") -> str:
    """Return the URI of a model package or of a file in it.

    Raises:
        ConfigError: spaces, which Gazebo does not find.
    """
    uri = f"model://{name}/{inside}" if inside else f"model://{name}"
    if any(c.isspace() for c in uri):
        raise ConfigError(f"Gazebo finds no names with spaces, got {uri!r}")
    return uri
