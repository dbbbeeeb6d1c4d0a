"""URDF of a robot, for ROS: the same bodies, masses and shapes."""

from __future__ import annotations

import math
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import mujoco
import numpy as np

from lirs_envs.robots.robot import Robot
from lirs_wct.geometry import Pose3


def robot_urdf(robot: Robot) -> str:
    """Return the robot's URDF.

    Frames after REP 105 and REP 103: `base_footprint` on the ground, `base_link`, one link for each wheel,
    and `laser`. URDF knows neither capsules nor ellipsoids: both become the cylinders that they stand for.
    """
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf))
    root = Element("robot", name=robot.name)
    SubElement(root, "link", name="base_footprint")
    _joint(root, "base_joint", "fixed", "base_footprint", "base_link", Pose3(z=robot.base_height))
    for body in range(1, model.nbody):
        name = model.body(body).name
        _link(root, model, body)
        if name != "base_link":
            parent = model.body(int(model.body_parentid[body])).name
            T = Pose3.from_arrays(model.body_pos[body], model.body_quat[body])
            joint = _joint(root, f"{name}_joint", "continuous", parent, name, T)
            SubElement(joint, "axis", xyz="0 1 0")
    SubElement(root, "link", name="laser")
    _joint(root, "laser_joint", "fixed", "base_link", "laser", robot.T_base_laser)
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _link(root: Element, model: mujoco.MjModel, body: int) -> None:
    link = SubElement(root, "link", name=model.body(body).name)
    inertial = SubElement(link, "inertial")
    _origin(inertial, Pose3.from_arrays(model.body_ipos[body], model.body_iquat[body]))
    SubElement(inertial, "mass", value=f"{model.body_mass[body]:.6g}")
    xx, yy, zz = (f"{v:.6g}" for v in model.body_inertia[body])
    SubElement(inertial, "inertia", ixx=xx, ixy="0", ixz="0", iyy=yy, iyz="0", izz=zz)
    for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
        kind = "collision" if model.geom_contype[geom] else "visual"
        element = SubElement(link, kind)
        _origin(element, Pose3.from_arrays(model.geom_pos[geom], model.geom_quat[geom]))
        geometry, shape = SubElement(element, "geometry"), int(model.geom_type[geom])
        a, b, c = model.geom_size[geom].tolist()
        if shape == mujoco.mjtGeom.mjGEOM_BOX:
            SubElement(geometry, "box", size=f"{2 * a:.6g} {2 * b:.6g} {2 * c:.6g}")
        elif shape == mujoco.mjtGeom.mjGEOM_SPHERE:
            SubElement(geometry, "sphere", radius=f"{a:.6g}")
        else:
            half = {mujoco.mjtGeom.mjGEOM_CAPSULE: b + a, mujoco.mjtGeom.mjGEOM_ELLIPSOID: c}.get(shape, b)
            SubElement(geometry, "cylinder", radius=f"{a:.6g}", length=f"{2 * half:.6g}")
        if kind == "visual":
            color = " ".join(f"{v:.3g}" for v in model.geom_rgba[geom])
            material = SubElement(element, "material", name=f"color_{geom}")
            SubElement(material, "color", rgba=color)


def _joint(root: Element, name: str, kind: str, parent: str, child: str, T: Pose3) -> Element:
    joint = SubElement(root, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    _origin(joint, T)
    return joint


def _origin(element: Element, T: Pose3) -> None:
    roll, pitch, yaw = T.roll, T.pitch, T.yaw
    if abs(abs(pitch) - math.pi / 2) < 1e-9:
        # At the pole only the difference of roll and yaw is defined.
        roll, yaw = 2 * math.atan2(T.qx, T.qw), 0.0
    xyz = " ".join(f"{v:.6g}" for v in (T.x, T.y, T.z))
    SubElement(element, "origin", xyz=xyz, rpy=f"{roll:.6g} {pitch:.6g} {yaw:.6g}")
