"""A robot as a GLB in its base frame: the visual shapes of its MJCF."""

from __future__ import annotations

import mujoco
import numpy as np
import trimesh
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from lirs_envs.robots.robot import Robot
from lirs_wct.geometry.pose import Pose3

VISUAL = 2
"""Group of the geoms that are seen."""
SECTIONS = 20
"""Sides of what is round."""


def robot_glb(robot: Robot) -> bytes:
    """Return the robot at rest, base_link at the origin, x ahead."""
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    base = model.body("base_link").id
    T_base_world = Pose3.from_arrays(data.xpos[base], data.xquat[base]).inverse()
    scene = trimesh.Scene()
    for geom in np.flatnonzero(model.geom_group == VISUAL).tolist():
        shape = _shape(int(model.geom_type[geom]), model.geom_size[geom].tolist())
        if shape is None:
            continue
        placed = np.eye(4)
        placed[:3, :3] = T_base_world.rotation @ data.geom_xmat[geom].reshape(3, 3)
        placed[:3, 3] = T_base_world.apply(data.geom_xpos[geom])
        shape.apply_transform(placed)
        color = (255 * model.geom_rgba[geom]).astype(np.uint8)
        material = PBRMaterial(baseColorFactor=color, metallicFactor=0.1, roughnessFactor=0.7)
        shape.visual = TextureVisuals(uv=np.zeros((len(shape.vertices), 2)), material=material)
        scene.add_geometry(shape)
    content: bytes = scene.export(file_type="glb")
    return content


def _shape(kind: int, size: list[float]) -> trimesh.Trimesh | None:
    a, b, c = size
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        shape = trimesh.creation.box(extents=(2 * a, 2 * b, 2 * c))
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        shape = trimesh.creation.cylinder(radius=a, height=2 * b, sections=SECTIONS)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        shape = trimesh.creation.capsule(radius=a, height=2 * b, count=(SECTIONS, SECTIONS))
    elif kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        shape = trimesh.creation.uv_sphere(radius=1.0, count=(SECTIONS // 2, SECTIONS))
        shape.apply_scale((a, a, a) if kind == mujoco.mjtGeom.mjGEOM_SPHERE else (a, b, c))
    else:
        return None
    shape.unmerge_vertices()  # flat shading shows the edges
    return shape
