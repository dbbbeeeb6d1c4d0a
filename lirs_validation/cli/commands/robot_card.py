"""The command `robot`: a table of its data, a picture, and a description for ROS."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from lirs_wct.arrays import ByteArray
from lirs_wct.errors import ConfigError, unknown_name
from lirs_wct.files import atomic_write

if TYPE_CHECKING:
    from lirs_envs.robots.robot import Robot

FORMATS = ("urdf",)


def robot(
    name: Annotated[str, typer.Argument(help="Name of the robot.")],
    to: Annotated[
        str | None, typer.Option(metavar="urdf", help="Write a description for RViz: NAME.urdf.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="File to write; default: NAME.png or NAME.urdf here."),
    ] = None,
) -> None:
    """Show a robot's data and draw its picture, or export it for RViz."""
    from lirs_envs.robots.robot import make_robot
    from lirs_envs.robots.urdf import robot_urdf

    who, out = make_robot(name), Console()
    if to is not None and to not in FORMATS:
        raise unknown_name("format for a robot", to, FORMATS)
    target = output or Path(f"{name}.{to or 'png'}")
    with atomic_write(target) as path:
        if to == "urdf":
            path.write_text(robot_urdf(who), encoding="utf-8")
        else:
            draw(who, path)
    if to is None:
        out.print(card(who))
    out.print(f"{target}", soft_wrap=True, highlight=False)


def card(robot: Robot) -> Table:
    """Return the robot's data as a table."""
    import mujoco

    from lirs_envs.lidar.presets import make_lidar_preset

    model = mujoco.MjModel.from_xml_path(str(robot.mjcf))
    body, lidar, T = model.body("base_link"), make_lidar_preset(robot.lidar), robot.T_base_laser
    wheels = len(robot.left_wheels) + len(robot.right_wheels)
    rows = {
        "mass": f"{model.body_mass.sum():.4g} kg, body {float(body.mass[0]):.4g} kg",
        "inertia of the body": " ".join(f"{v:.4g}" for v in body.inertia) + " kg m2",
        "drive": f"{len(robot.rotors)} rotors" if robot.flies else f"{wheels} driven wheels",
    }
    if not robot.flies:
        rows["wheels"] = (
            f"radius {robot.wheel_radius:g} m, track {robot.track:g} m, wheelbase {robot.wheelbase:g} m"
        )
    rows |= {
        "speed": f"{robot.max_speed:g} m/s, {robot.max_turn_rate:g} rad/s",
        "acceleration": f"{robot.max_acceleration:g} m/s2, {robot.max_turn_acceleration:.3g} rad/s2",
        "radius": f"{robot.radius:g} m",
        "base_link": f"{robot.base_height:g} m above ground",
        "friction": f"{robot.friction:g} (slides at {math.degrees(math.atan(robot.friction)):.0f} deg)",
        "drives on": f"slopes up to {math.degrees(robot.max_slope):.0f} deg",
        "laser": f"{lidar.name}: {lidar.beams} beams, {math.degrees(lidar.fov):g} deg, {lidar.rate:g} Hz, "
        f"{lidar.range_min:g}-{lidar.range_max:g} m",
        "laser's mount": f"{T.x:g} {T.y:g} {T.z:g} m from base_link",
        "timestep": f"{1e3 * model.opt.timestep:g} ms",
        "model": str(robot.mjcf),
    }
    table = Table(title=robot.name, show_header=False)
    for what, figure in rows.items():
        table.add_row(what, figure)
    return table


def draw(robot: Robot, path: Path) -> None:
    """Draw the robot as a PNG with MuJoCo; without OpenGL, as an outline."""
    import cv2

    import lirs_envs  # noqa: F401  chooses OpenGL without a screen, before MuJoCo is imported

    try:
        picture = _render(robot)
    except Exception:
        # MuJoCo and PyOpenGL raise whatever the platform gives them; the outline needs neither.
        _outline(robot, path)
        return
    ok, data = cv2.imencode(".png", picture[:, :, ::-1])
    if not ok:
        raise ConfigError(f"{path}: the picture cannot be encoded")
    path.write_bytes(data.tobytes())


def _render(robot: Robot) -> ByteArray:
    import mujoco

    spec = mujoco.MjSpec.from_file(str(robot.mjcf))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(5, 5, 1), rgba=(0.75, 0.75, 0.72, 1))
    spec.worldbody.add_light(pos=(-3, -3, 5), dir=(0.5, 0.5, -0.8))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    view = mujoco.MjvOption()
    view.geomgroup[:] = (1, 1, 1, 0, 0, 0)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = data.body("base_link").xpos
    camera.lookat[2] += 0.1
    camera.distance, camera.azimuth, camera.elevation = 4.0 * robot.radius, 140, -25
    renderer = mujoco.Renderer(model, 480, 640)
    try:
        renderer.update_scene(data, camera=camera, scene_option=view)
        picture: ByteArray = renderer.render()
        return picture
    finally:
        renderer.close()


def _outline(robot: Robot, path: Path) -> None:
    """Draw the bounding boxes of all geoms, from above and from the right."""
    import mujoco
    from matplotlib.figure import Figure
    from matplotlib.patches import Polygon
    from scipy.spatial import ConvexHull

    model = mujoco.MjModel.from_xml_path(str(robot.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    figure = Figure(figsize=(8, 4), layout="constrained")
    signs = np.array(np.meshgrid(*3 * ((-1, 1),))).reshape(3, -1).T
    for axes, (i, j), title in zip(
        figure.subplots(1, 2), ((0, 1), (0, 2)), ("from above", "from the right"), strict=True
    ):
        for g in range(model.ngeom):
            corners = model.geom_aabb[g, :3] + model.geom_aabb[g, 3:] * signs
            points = (corners @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g])[:, (i, j)]
            touches = bool(model.geom_contype[g])
            hull = points[ConvexHull(points).vertices]
            axes.add_patch(Polygon(hull, fill=not touches, alpha=0.4, color="C3" if touches else "C0"))
        axes.autoscale_view()
        axes.set(aspect="equal", title=f"{robot.name}, {title}", xlabel="m")
    figure.savefig(path, format="png")
