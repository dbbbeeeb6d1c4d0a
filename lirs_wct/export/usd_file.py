"""USD stage of a world for Isaac Sim, Omniverse and Blender: textured collision meshes."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from lirs_wct.errors import ConfigError
from lirs_wct.formats.gazebo import FRICTION, GRAVITY
from lirs_wct.formats.meshes.collada import MeshPart
from lirs_wct.world import World

SUN = 3000.0
"""Intensity of the distant light."""


def require_usd() -> None:
    """Check that USD's library is installed.

    Raises:
        ConfigError: usd-core is not installed.
    """
    try:
        import_module("pxr.Usd")
    except ImportError:
        raise ConfigError("usd needs the package usd-core: pip install '.[usd]'") from None


def write_usd(path: Path, world: World, parts: list[MeshPart]) -> None:
    """Write a stage in meters with z up.

    `/World` is its default prim. Each part of the world is a static mesh without subdivision, with exact
    collision (`UsdPhysics.MeshCollisionAPI`, approximation none), the texture as a preview surface, and
    Coulomb friction. `/World/starts` has a frame for each start pose.

    Args:
        path: output file with suffix `.usd`, `.usda` or `.usdc`.
        world: source of the start poses.
        parts: meshes in the world frame; texture paths are relative to the file.

    Raises:
        ConfigError: usd-core is not installed.
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
    scene.CreateGravityMagnitudeAttr(GRAVITY)
    sun = lux.DistantLight.Define(stage, "/World/sun")
    sun.CreateIntensityAttr(SUN)
    geom.XformCommonAPI(sun.GetPrim()).SetRotate((30.0, 15.0, 0.0))
    for part in parts:
        _add_part(stage, part)
    geom.Xform.Define(stage, "/World/starts")
    for k, pose in enumerate(world.spawn_poses):
        frame = geom.XformCommonAPI(geom.Xform.Define(stage, f"/World/starts/start{k or ''}"))
        frame.SetTranslate((pose.x, pose.y, float(world.surface.height_at(pose.x, pose.y))))
        frame.SetRotate((0.0, 0.0, float(np.degrees(pose.yaw))))
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
    touched.CreateStaticFrictionAttr(FRICTION)
    touched.CreateDynamicFrictionAttr(FRICTION)
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
        reader = shade.Shader.Define(stage, f"{place}/coordinates")
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", types.String).Set("st")
        texture = shade.Shader.Define(stage, f"{place}/texture")
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", types.Asset).Set(sdf.AssetPath(part.texture))
        for side in ("wrapS", "wrapT"):
            texture.CreateInput(side, types.Token).Set("repeat")
        coordinates = reader.CreateOutput("result", types.Float2)
        texture.CreateInput("st", types.Float2).ConnectToSource(coordinates)
        color = texture.CreateOutput("rgb", types.Float3)
        surface.CreateInput("diffuseColor", types.Color3f).ConnectToSource(color)
    return material
