"""Worlds and robots as GLB, the binary glTF that a browser shows."""

from __future__ import annotations

from dataclasses import replace

import cv2
import mujoco
import numpy as np
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from lirs_envs.robots.robot import Robot
from lirs_wct import HeightField, Pose3, TriangleMesh, World
from lirs_wct.arrays import ByteArray
from lirs_wct.export.appearance import world_parts
from lirs_wct.ground import Terrain
from lirs_wct.meshing.solid import solid_mesh

TEXTURE = 1024
"""Largest side of a texture, pixels; smaller in previews, for speed."""
PREVIEW_TEXTURE = 384
VISUAL = 2
"""Group of the visible geoms."""
SECTIONS = 20
"""Sections of cylinders, capsules and spheres."""


def world_glb(world: World, most: int, texture: int = TEXTURE) -> tuple[bytes, int]:
    """Return a world as GLB, z up, and its number of triangles.

    A surface of more than `most` triangles is shown on a coarser grid; a texture has at most `texture` pixels
    along its longer side.
    """
    shown, count = trimesh.Scene(), 0
    for part in world_parts(world, _shown_mesh(world, most)):
        mesh, picture = part.mesh, Image.fromarray(_at_most(part.wear.pixels(world), texture))
        material = PBRMaterial(baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=1.0)
        visual = TextureVisuals(uv=mesh.uv, material=material)
        shape = trimesh.Trimesh(
            mesh.vertices, mesh.faces, vertex_normals=mesh.normals, process=False, visual=visual
        )
        shown.add_geometry(shape, geom_name=part.wear.name)
        count += len(mesh.faces)
    content: bytes = shown.export(file_type="glb")
    return content, count


def _shown_mesh(world: World, most: int) -> TriangleMesh:
    """Return the mesh that is exported, or a coarser grid of the same surface."""
    surface = world.surface
    plain = isinstance(world.ground, Terrain) and not world.export_options.limited
    if not plain and (len(world.mesh.faces) <= most or world.walls is not None or world.overhangs):
        return world.mesh
    rows, cols = surface.shape
    if plain and 2 * rows * cols <= most:
        return world.mesh
    return solid_mesh(_thin(surface, most))


def _thin(surface: HeightField, most: int) -> HeightField:
    """Return the surface on fewer nodes, its border kept."""
    rows, cols = surface.shape
    share = min(1.0, (most / 2 / (rows * cols)) ** 0.5)
    at = [np.linspace(0, n - 1, max(2, int(n * share))).round().astype(int) for n in (rows, cols)]
    width, depth = surface.size
    cell = (width / (len(at[1]) - 1), depth / (len(at[0]) - 1))
    return replace(surface, z=np.ascontiguousarray(surface.z[np.ix_(*at)]), cell=cell)


def _at_most(bgr: ByteArray, most: int) -> ByteArray:
    """Return a picture as RGB, its longer side at most so many pixels."""
    scale = min(1.0, most / max(bgr.shape[:2]))
    if scale < 1.0:
        bgr = np.asarray(cv2.resize(bgr, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    return np.ascontiguousarray(bgr[..., ::-1])


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
