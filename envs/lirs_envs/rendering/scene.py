"""Scene that cameras render: robot, props and walkers on a simplified ground mesh.

The mesh, whose vertical error is bounded, replaces the height field: software OpenGL renders it faster.
In the world `medium` the height field of the wheels (513 x 513 nodes) takes 0.3 s, the mesh of the finer
lidar surface 0.04 s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from zlib import crc32

import cv2
import mujoco
import numpy as np
import trimesh

from lirs_envs.props import add_props
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_envs.walkers import add_walkers
from lirs_wct import Pose2, Pose3, TriangleMesh, World
from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.export.appearance import world_parts
from lirs_wct.geometry.mesh import MUJOCO_FACES, split_tiles
from lirs_wct.meshing.simplify import simplified_solid


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """A moment of a simulation.

    Attributes:
        world: world of the robot.
        config: robot, props and number of walkers.
        qpos: (nq,) MuJoCo's positions of robot and props.
        walkers: (n, 3) middles of the walkers, meters.
        goal: goal to mark; None = none.
    """

    world: World
    config: SimulationConfig
    qpos: FloatArray
    walkers: FloatArray
    goal: Pose2 | None = None

    @staticmethod
    def of(simulation: Simulation, i: int = 0, goal: Pose2 | None = None) -> Snapshot:
        """Return the present state of robot `i`."""
        return Snapshot(
            world=simulation.worlds[i],
            config=simulation.config,
            qpos=simulation.qpos(i).copy(),
            walkers=simulation.walkers(i),
            goal=goal,
        )

    @property
    def T_world_base(self) -> Pose3:  # noqa: N802  a frame pair
        """Pose of base_link."""
        x, y, z, qw, qx, qy, qz = self.qpos[:7].tolist()
        return Pose3(x, y, z, qw, qx, qy, qz)


MAX_ERROR = 0.02
"""Vertical deviation of the drawn ground from the true one, meters."""
SKY = (0.62, 0.74, 0.86), (0.93, 0.95, 0.97)
"""Color above and at the horizon."""
NEAR = 0.05
"""Near clipping distance of the cameras, meters."""
CREASE = math.radians(35)
"""Angle between two triangles from which on their edge looks sharp."""
PNG_FAST = (cv2.IMWRITE_PNG_COMPRESSION, 1)
HIDDEN_GROUPS = (3, 4)
"""Hidden geom groups: collision geometry."""


class RenderScene:
    """A world with a robot, props and walkers, to be drawn.

    Attributes:
        model: compiled; nothing in it touches anything.
        data: state of robot, props and walkers.
        world: rendered world.
    """

    def __init__(self, world: World, config: SimulationConfig) -> None:
        self.world = world
        self.model = _scene_spec(world, config).compile()
        # MuJoCo takes it as a share of the model's extent.
        self.model.vis.map.znear = NEAR / self.model.stat.extent
        self.data = mujoco.MjData(self.model)

    def place(self, snapshot: Snapshot) -> None:
        """Put all where a snapshot has them."""
        self.data.qpos[:] = snapshot.qpos
        self.data.mocap_pos[:] = snapshot.walkers
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)


def scene_options() -> mujoco.MjvOption:
    """Return the options that draw visible geoms and hide collision geoms."""
    options = mujoco.MjvOption()
    options.geomgroup[:] = [group not in HIDDEN_GROUPS for group in range(mujoco.mjNGROUP)]
    return options


def _scene_spec(world: World, config: SimulationConfig) -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_file(str(config.robot.mjcf))
    spec.modelname = world.name
    add_props(spec, world, config.props)
    add_walkers(spec, config.actors)
    _add_ground(spec, world)
    spec.worldbody.add_light(
        pos=(0, 0, 50), dir=(0.5, -0.5, -0.7), type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, castshadow=False
    )
    spec.visual.headlight.ambient[:] = 0.45
    spec.visual.headlight.diffuse[:] = 0.25
    spec.visual.headlight.specular[:] = 0.0
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1920, 1080
    zenith, horizon = SKY
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=zenith,
        rgb2=horizon,
        width=64,
        height=384,
    )
    return spec


def _add_ground(spec: mujoco.MjSpec, world: World) -> None:
    """Add the ground's mesh in tiles, and that of walls, which wear the world's textures."""
    for part in world_parts(world, _with_creases(_ground_mesh(world))):
        _add_material(spec, part.wear.name, part.wear.pixels(world))
        for k, tile in enumerate(split_tiles(part.mesh, aim=MUJOCO_FACES // 2)):
            _add_tile(spec, f"{part.wear.name}{k}", part.wear.name, tile)


def _add_material(spec: mujoco.MjSpec, name: str, pixels: ByteArray) -> None:
    _, encoded = cv2.imencode(".png", pixels, PNG_FAST)
    # MuJoCo caches files by name: other content needs another name.
    file = f"{name}-{crc32(encoded.data):08x}.png"
    spec.assets = dict(spec.assets) | {file: encoded.tobytes()}
    spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=file)
    material = spec.add_material(name=name, specular=0.0, shininess=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def _add_tile(spec: mujoco.MjSpec, name: str, material: str, tile: TriangleMesh) -> None:
    assert tile.uv is not None, "a part has texture coordinates"
    assert tile.normals is not None, "and normals"
    # v runs from the picture's first row, which is in the north.
    uv = np.stack((tile.uv[:, 0], 1 - tile.uv[:, 1]), axis=1)
    spec.add_mesh(
        name=name,
        uservert=tile.vertices.ravel(),
        userface=tile.faces.ravel(),
        usernormal=np.ascontiguousarray(tile.normals, dtype=np.float32).ravel(),
        usertexcoord=np.ascontiguousarray(uv, dtype=np.float32).ravel(),
        # A tile is open: it has no volume to take an inertia from.
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        material=material,
        rgba=(1.0, 1.0, 1.0, 1.0),
        contype=0,
        conaffinity=0,
        priority=0,
        group=0,
    )


def _with_creases(mesh: TriangleMesh) -> TriangleMesh:
    """Return a mesh with vertices split along sharp edges, for separate shading of each side."""
    shared = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    split = trimesh.graph.smooth_shade(shared, angle=CREASE)
    return TriangleMesh(np.asarray(split.vertices), np.asarray(split.faces, dtype=np.int32))


def _ground_mesh(world: World) -> TriangleMesh:
    if world.walls is not None or world.overhangs:
        return world.mesh
    return simplified_solid(world.surface, max_error=MAX_ERROR)
