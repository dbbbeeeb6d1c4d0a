"""Writer and conversion of mesh files, upright in every consumer."""

from __future__ import annotations

import io
import re
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from lirs_wct.errors import ConfigError, OutputError
from lirs_wct.export.appearance import cube_uv
from lirs_wct.files import atomic_write
from lirs_wct.formats import MESHES, gazebo
from lirs_wct.formats.meshes.reader import TEXTURED, read_textured, read_upright, upright
from lirs_wct.formats.meshes.writers import MeshPart, write_glb, write_obj, write_parts, write_stl
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.world import World


def write_mesh(path: Path, mesh: TriangleMesh, picture: Image.Image | None = None) -> None:
    """Write a mesh, with its texture if possible, in the format of the suffix.

    A GLB has y up. COLLADA and OBJ store the texture next to the file. COLLADA has texture coordinates;
    missing ones are made by cube projection.
    """
    suffix = path.suffix.lower()
    if suffix == ".stl":
        write_stl(path, mesh)
    elif suffix == ".ply":
        import trimesh  # slow import, needed here only

        with atomic_write(path) as temporary:
            trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(temporary)
    elif suffix == ".glb":
        write_glb(path, [("ground", mesh, picture)])
    elif suffix in (".dae", ".obj"):
        texture = None if picture is None else _write_beside(path, picture)
        if suffix == ".dae":
            whole = mesh if mesh.uv is not None and mesh.normals is not None else cube_uv(mesh)
            write_parts(path, (MeshPart("ground", whole, texture),))
        else:
            write_obj(path, [("ground", mesh, texture)])
    else:
        raise ConfigError(f"{path}: not a mesh that is written; legal: {', '.join(MESHES)}")


def convert_mesh(source: Path, target: Path, rotate_x: float = 0.0) -> TriangleMesh:
    """Convert a mesh file and return its shape with equal vertices merged.

    Texture and texture coordinates are kept if both formats support them; a warning names the losses. The
    mesh is rotated by `rotate_x` degrees about the x axis.
    """
    shape, whole = read_upright(source).rotated_x(rotate_x), read_textured(source)
    keeps_texture, lost = target.suffix.lower() in TEXTURED, []
    if whole.mesh.uv is None or not keeps_texture:
        write_mesh(target, shape)
    else:
        if whole.picture is None:
            warnings.warn(f"{source}: its texture coordinates are kept, no texture was found", stacklevel=2)
        write_mesh(target, upright(source, whole.mesh).rotated_x(rotate_x), whole.picture)
    if whole.mesh.uv is not None and not keeps_texture:
        lost.append("texture and texture coordinates" if whole.picture else "texture coordinates")
    if whole.vertex_colors:
        lost.append("the colors of vertices or faces")
    if lost:
        warnings.warn(f"{target}: {' and '.join(lost)} of {source} are left out", stacklevel=2)
    return shape


def _write_beside(path: Path, picture: Image.Image) -> str:
    """Write a texture next to a mesh file; return its name, which has no spaces."""
    name = f"{re.sub(r'[^A-Za-z0-9_.-]+', '_', path.stem)}-texture.png"
    place, content = path.with_name(name), io.BytesIO()
    picture.convert("RGBA" if picture.mode in ("RGBA", "LA", "PA") else "RGB").save(content, format="PNG")
    if place.exists() and place.read_bytes() != content.getvalue():
        raise OutputError(f"{place}: is another picture, and the texture of {path} is to be written there")
    with atomic_write(place) as temporary:
        temporary.write_bytes(content.getvalue())
    return name


SUN = 3000.0
"""Intensity of the distant light."""


def require_usd() -> None:
    """Check that USD's library is installed."""
    try:
        import_module("pxr.Usd")
    except ImportError:
        raise ConfigError("usd needs the package usd-core: pip install 'lirs-wct[usd]'") from None


def write_usd(path: Path, world: World, parts: list[MeshPart]) -> None:
    """Write a stage in meters with z up.

    `/World` is its default prim. Each part of the world is a static mesh without subdivision, with exact
    collision (`UsdPhysics.MeshCollisionAPI`, approximation none), the texture as a preview surface, and
    Coulomb friction. `/World/starts` has a frame for each start pose.
    """
    require_usd()
    usd, geom, physics, lux, gf = (
        import_module(f"pxr.{name}") for name in ("Usd", "UsdGeom", "UsdPhysics", "UsdLux", "Gf")
    )
    stage: Any = usd.Stage.CreateNew(str(path))
    geom.SetStageUpAxis(stage, geom.Tokens.z)
    geom.SetStageMetersPerUnit(stage, 1.0)
    root = geom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(root.GetPrim())
    scene = physics.Scene.Define(stage, "/World/physics")
    scene.CreateGravityDirectionAttr(gf.Vec3f(0, 0, -1))
    scene.CreateGravityMagnitudeAttr(gazebo.GRAVITY)
    sun = lux.DistantLight.Define(stage, "/World/sun")
    sun.CreateIntensityAttr(SUN)
    geom.XformCommonAPI(sun.GetPrim()).SetRotate((30.0, 15.0, 0.0))
    for part in parts:
        _add_part(stage, part)
    geom.Xform.Define(stage, "/World/starts")
    for k, start in enumerate(world.starts_on_ground):
        frame = geom.XformCommonAPI(geom.Xform.Define(stage, f"/World/starts/start{k or ''}"))
        frame.SetTranslate((start.x, start.y, start.z))
        frame.SetRotate((0.0, 0.0, float(np.degrees(start.yaw))))
    stage.GetRootLayer().Save()


def _add_part(stage: Any, part: MeshPart) -> None:
    geom, physics, shade, sdf, vt = (
        import_module(f"pxr.{name}") for name in ("UsdGeom", "UsdPhysics", "UsdShade", "Sdf", "Vt")
    )
    mesh = geom.Mesh.Define(stage, f"/World/{part.name}")
    vertices, faces, uv, normals = part.mesh.vertices, part.mesh.faces, part.mesh.uv, part.mesh.normals
    assert uv is not None
    assert normals is not None
    mesh.CreatePointsAttr(vt.Vec3fArray.FromNumpy(vertices.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr(vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(vt.IntArray.FromNumpy(faces.ravel().astype(np.int32)))
    mesh.CreateSubdivisionSchemeAttr(geom.Tokens.none)
    mesh.CreateNormalsAttr(vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
    mesh.SetNormalsInterpolation(geom.Tokens.vertex)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    mesh.CreateExtentAttr(vt.Vec3fArray.FromNumpy(np.stack((low, high)).astype(np.float32)))
    st = geom.PrimvarsAPI(mesh).CreatePrimvar("st", sdf.ValueTypeNames.TexCoord2fArray, geom.Tokens.vertex)
    st.Set(vt.Vec2fArray.FromNumpy(uv.astype(np.float32)))
    physics.CollisionAPI.Apply(mesh.GetPrim())
    physics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(physics.Tokens.none)
    material = _material(stage, part)
    touched = physics.MaterialAPI.Apply(material.GetPrim())
    touched.CreateStaticFrictionAttr(gazebo.FRICTION)
    touched.CreateDynamicFrictionAttr(gazebo.FRICTION)
    shade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)


def _material(stage: Any, part: MeshPart) -> Any:
    """Return a rough, non-metallic material with the part's texture."""
    shade, sdf = (import_module(f"pxr.{name}") for name in ("UsdShade", "Sdf"))
    types, place = sdf.ValueTypeNames, f"/World/Looks/{part.name}"
    material = shade.Material.Define(stage, place)
    surface = shade.Shader.Define(stage, f"{place}/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", types.Float).Set(1.0)
    surface.CreateInput("metallic", types.Float).Set(0.0)
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    if part.texture is not None:
        lookup = shade.Shader.Define(stage, f"{place}/coordinates")
        lookup.CreateIdAttr("UsdPrimvarReader_float2")
        lookup.CreateInput("varname", types.String).Set("st")
        texture = shade.Shader.Define(stage, f"{place}/texture")
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", types.Asset).Set(sdf.AssetPath(part.texture))
        for side in ("wrapS", "wrapT"):
            texture.CreateInput(side, types.Token).Set("repeat")
        coordinates = lookup.CreateOutput("result", types.Float2)
        texture.CreateInput("st", types.Float2).ConnectToSource(coordinates)
        color = texture.CreateOutput("rgb", types.Float3)
        surface.CreateInput("diffuseColor", types.Color3f).ConnectToSource(color)
    return material
