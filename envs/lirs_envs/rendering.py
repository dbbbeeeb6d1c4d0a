"""Rendering of a simulation's snapshots: maps from above, cameras through OpenGL, MuJoCo's viewer.

The ground in a camera's scene is a simplified mesh, whose vertical error is bounded, instead of the height
field: software OpenGL renders it faster. In the world `medium` the height field of the wheels (513 x 513
nodes) takes 0.3 s, the mesh of the finer lidar surface 0.04 s.
"""

from __future__ import annotations

import atexit
import math
import os
import sys
import threading
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any
from zlib import crc32

import cv2
import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig, add_props
from lirs_envs.walkers import RADIUS, add_walkers
from lirs_wct import (
    ByteArray,
    ConfigError,
    Float32Array,
    FloatArray,
    Int32Array,
    LaserScan,
    Pose2,
    Pose3,
    SimulationError,
    TriangleMesh,
    World,
)
from lirs_wct.export.appearance import Part, ground_texture, world_parts
from lirs_wct.geometry.mesh import MUJOCO_FACES, split_tiles
from lirs_wct.meshing.simplify import simplified_solid


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """A moment of a simulation.

    Attributes:
        world: World of the robot.
        config: Robot, props and number of walkers.
        qpos: (nq,) MuJoCo's positions of robot and props.
        walkers: (n, 3) middles of the walkers, meters.
        goal: Goal to mark; None = none.
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
            qpos=simulation.states[i].qpos.copy(),
            walkers=simulation.walkers(i),
            goal=goal,
        )

    @property
    def T_world_base(self) -> Pose3:  # noqa: N802  a frame pair
        """Pose of base_link."""
        x, y, z, qw, qx, qy, qz = self.qpos[:7].tolist()
        return Pose3(x, y, z, qw, qx, qy, qz)


PIXELS = 640
"""Longer side of a picture."""
ROBOT, OUTLINE = (30, 30, 35), (255, 255, 255)
PATH, SCAN, GOAL, WALKER = (20, 80, 200), (200, 40, 40), (215, 25, 60), (60, 90, 150)
"""Colors: red, green, blue."""
MIN_RADIUS = 5
"""A robot is drawn at least this large, pixels."""
FRACTION = 4
"""Number of fractional bits of OpenCV's pixel coordinates."""


class MapView:
    """Pictures of a world from above, row 0 = north. The ground is drawn once per world."""

    def __init__(self, pixels: int = PIXELS) -> None:
        self._pixels = pixels
        self._world: World | None = None

    def picture(
        self, snapshot: Snapshot, *, path: Sequence[Pose2] = (), scan: LaserScan | None = None
    ) -> ByteArray:
        """Return a picture (rows, cols, 3) of the whole world, with the path until now and a scan's hits."""
        if self._world is not snapshot.world:
            self._world, self._ground = snapshot.world, self._draw_ground(snapshot.world)
        picture = self._ground.copy()
        if len(path) > 1:
            points = self._pixel(np.array([(pose.x, pose.y) for pose in path]))
            cv2.polylines(picture, [points], False, PATH, 2, cv2.LINE_AA, FRACTION)
        for x, y in self._pixel(snapshot.walkers[:, :2]).tolist():
            radius = round(2**FRACTION * max(RADIUS * self._per_meter, 2.5))
            cv2.circle(picture, (x, y), radius, WALKER, cv2.FILLED, cv2.LINE_AA, FRACTION)
        if scan is not None:
            hits = (snapshot.T_world_base @ scan.T_base_laser).apply(scan.points)
            for x, y in self._pixel(hits[:, :2]).tolist():
                cv2.circle(picture, (x, y), 2**FRACTION, SCAN, cv2.FILLED, cv2.LINE_AA, FRACTION)
        if snapshot.goal is not None:
            x, y = self._pixel(np.array(((snapshot.goal.x, snapshot.goal.y),)))[0].tolist()
            for radius, width in ((9, 2), (3, cv2.FILLED)):
                cv2.circle(picture, (x, y), radius << FRACTION, GOAL, width, cv2.LINE_AA, FRACTION)
        self._draw_robot(picture, snapshot)
        return picture

    def _draw_ground(self, world: World) -> ByteArray:
        """Return the ground's picture, and note its scale."""
        width, depth = world.surface.size
        self._per_meter = self._pixels / max(width, depth)
        west, _, _, north = world.surface.bounds
        self._corner = np.array((west, north))
        above = ground_texture(world.surface, world.walls)[..., ::-1]
        rows, cols = (max(1, round(side * self._per_meter)) for side in (depth, width))
        return np.ascontiguousarray(cv2.resize(above, (cols, rows), interpolation=cv2.INTER_AREA), np.uint8)

    def _pixel(self, points: FloatArray) -> Int32Array:
        """Return (n, 2) column and row of world points (n, 2), in fractions of a pixel."""
        pixels = (points - self._corner) * (self._per_meter, -self._per_meter)
        fractions: Int32Array = np.round(np.clip(pixels, -1e4, 1e4) * 2**FRACTION).astype(np.int32)
        return fractions

    def _draw_robot(self, picture: ByteArray, snapshot: Snapshot) -> None:
        """Draw an arrowhead as long as the robot."""
        here = snapshot.T_world_base.to_pose2()
        radius = max(snapshot.config.robot.radius, MIN_RADIUS / self._per_meter)
        turns = np.array((0.0, 2.5, math.pi, -2.5)) + here.yaw
        reach = radius * np.array((1.3, 1.1, 0.4, 1.1))
        corners = np.column_stack((here.x + reach * np.cos(turns), here.y + reach * np.sin(turns)))
        outline: NDArray[np.int32] = self._pixel(corners)
        cv2.fillPoly(picture, [outline], ROBOT, cv2.LINE_AA, FRACTION)
        cv2.polylines(picture, [outline], True, OUTLINE, 1, cv2.LINE_AA, FRACTION)


MAX_ERROR = 0.02
"""Vertical deviation of the drawn ground from the true one, meters."""
SKY = (0.62, 0.74, 0.86), (0.93, 0.95, 0.97)
"""Color above and at the horizon."""
NEAR_CLIP = 0.05
"""Near clipping distance of the cameras, meters."""
CREASE = math.radians(35)
"""Angle between two triangles from which on their edge looks sharp."""
PNG_FAST = (cv2.IMWRITE_PNG_COMPRESSION, 1)
HIDDEN_GROUPS = (3, 4)
"""Hidden geom groups: collision geometry."""


class RenderScene:
    """A world with a robot, props and walkers, to be drawn; nothing in its model touches anything."""

    def __init__(self, world: World, config: SimulationConfig) -> None:
        self.world = world
        self.model = _scene_spec(world, config).compile()
        # MuJoCo takes it as a share of the model's extent.
        self.model.vis.map.znear = NEAR_CLIP / self.model.stat.extent
        self.data = mujoco.MjData(self.model)

    def place(self, snapshot: Snapshot) -> None:
        """Put all where a snapshot has them."""
        self.data.qpos[:] = snapshot.qpos
        self.data.mocap_pos[:] = snapshot.walkers
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)


def _scene_spec(world: World, config: SimulationConfig) -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_file(str(config.robot.mjcf))
    spec.modelname = world.name
    add_props(spec, world, config.props)
    add_walkers(spec, config.actors)
    ground = world.mesh
    if world.walls is None and not world.overhangs:
        ground = simplified_solid(world.surface, max_error=MAX_ERROR)
    # Split along sharp edges, for separate shading of each side.
    shared = trimesh.Trimesh(ground.vertices, ground.faces, process=False)
    split = trimesh.graph.smooth_shade(shared, angle=CREASE)
    creased = TriangleMesh(np.asarray(split.vertices), np.asarray(split.faces, dtype=np.int32))
    for part in world_parts(world, creased):
        _add_part(spec, part, part.wear.pixels(world))
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


def _add_part(spec: mujoco.MjSpec, part: Part, pixels: ByteArray) -> None:
    """Add the ground or the walls as a mesh in tiles, which wears a texture."""
    name = part.wear.name
    _, encoded = cv2.imencode(".png", pixels, PNG_FAST)
    # MuJoCo caches files by name: other content needs another name.
    file = f"{name}-{crc32(encoded.data):08x}.png"
    spec.assets = dict(spec.assets) | {file: encoded.tobytes()}
    spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=file)
    material = spec.add_material(name=name, specular=0.0, shininess=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    for k, tile in enumerate(split_tiles(part.mesh, aim=MUJOCO_FACES // 2)):
        _add_tile(spec, f"{name}{k}", name, tile)


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


SHAPE = (480, 640)
"""Height and width of a picture, pixels."""
CHASE = "chase"
"""The camera behind a robot, which every robot has."""
_drawing: set[int] = set()
"""Number of the process that draws with OpenGL; none before the first picture."""
GOAL_HEIGHT, GOAL_RADIUS, GOAL_COLOR = 2.0, 0.06, (0.85, 0.1, 0.2, 1.0)


class Camera:
    """Camera for pictures of (height, width) pixels; the scene is rebuilt when the world changes."""

    def __init__(self, shape: tuple[int, int] = SHAPE) -> None:
        self._shape = shape
        self._options = mujoco.MjvOption()
        self._options.geomgroup[:] = [group not in HIDDEN_GROUPS for group in range(mujoco.mjNGROUP)]
        self._scene: RenderScene | None = None
        self._renderer: mujoco.Renderer | None = None

    def rgb(self, snapshot: Snapshot) -> ByteArray:
        """Return a picture (height, width, 3)."""
        renderer = self._see(snapshot)
        if snapshot.goal is not None:
            _mark_goal(renderer.scene, snapshot)
        picture: ByteArray = renderer.render()
        return picture

    def depth(self, snapshot: Snapshot) -> Float32Array:
        """Return (height, width) float32 distances from the camera's plane, meters; the sky is far away."""
        renderer = self._see(snapshot)
        renderer.enable_depth_rendering()
        try:
            depth: Float32Array = renderer.render()
        finally:
            renderer.disable_depth_rendering()
        return depth

    def close(self) -> None:
        """Release OpenGL resources; the next picture allocates them again."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = self._scene = None

    def _see(self, snapshot: Snapshot) -> mujoco.Renderer:
        if _drawing and os.getpid() not in _drawing:  # OpenGL would wait forever.
            raise SimulationError(
                "no picture in a process that was forked after one was drawn: start it with spawn, or use "
                "render mode map"
            )
        if self._scene is None or self._scene.world is not snapshot.world:
            self.close()
            self._scene = RenderScene(snapshot.world, snapshot.config)
        self._scene.place(snapshot)
        if self._renderer is None:
            self._renderer = _make_renderer(self._scene.model, self._shape)
        self._renderer.update_scene(self._scene.data, camera=CHASE, scene_option=self._options)
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        return self._renderer


def _make_renderer(model: mujoco.MjModel, shape: tuple[int, int]) -> mujoco.Renderer:
    try:
        renderer = mujoco.Renderer(model, *shape)
    except Exception as error:
        # MuJoCo and PyOpenGL raise whatever the platform gives them.
        raise SimulationError(
            "a picture needs OpenGL: a screen, or libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0 and "
            f"lirs_envs imported before mujoco (or MUJOCO_GL=egl); render mode map needs none: {error}"
        ) from error
    _drawing.add(os.getpid())
    return renderer


def _mark_goal(scene: mujoco.MjvScene, snapshot: Snapshot) -> None:
    """Add a pole at the goal."""
    goal = snapshot.goal
    if goal is None or scene.ngeom >= scene.maxgeom:
        return
    ground = float(snapshot.world.surface.height_at(goal.x, goal.y))
    mujoco.mjv_initGeom(
        scene.geoms[scene.ngeom],
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=np.array((GOAL_RADIUS, GOAL_HEIGHT / 2, 0.0)),
        pos=np.array((goal.x, goal.y, ground + GOAL_HEIGHT / 2)),
        mat=np.eye(3).ravel(),
        rgba=np.array(GOAL_COLOR, np.float32),
    )
    scene.ngeom += 1


INSTEAD = "without one take rgb_array or map"
CLOSING_TIME = 10.0
"""Longest wait for the window to close, seconds."""


class Viewer:
    """A window that shows the latest snapshot; it opens with the first one."""

    def __init__(self) -> None:
        self._scene: RenderScene | None = None
        self._window: Any = None
        self._threads: list[threading.Thread] = []

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot; nothing once the user has closed the window."""
        if self._scene is None or self._scene.world is not snapshot.world:
            self._open(snapshot)
        assert self._scene is not None, "it was opened"
        if self._window.is_running():
            with self._window.lock():
                self._scene.place(snapshot)
            self._window.sync()

    def _open(self, snapshot: Snapshot) -> None:
        self.close()
        check_screen()
        self._scene = RenderScene(snapshot.world, snapshot.config)
        self._scene.place(snapshot)
        viewer: Any = import_module("mujoco.viewer")
        others = set(threading.enumerate())
        try:
            self._window = viewer.launch_passive(self._scene.model, self._scene.data)
        except RuntimeError as error:  # macOS: only the program mjpython can open it.
            self._scene = None
            raise SimulationError(f"render mode human: {error}") from None
        self._threads = [thread for thread in threading.enumerate() if thread not in others]
        atexit.register(self.close)
        for group in HIDDEN_GROUPS:
            self._window.opt.geomgroup[group] = 0

    def close(self) -> None:
        """Close the window and wait for its thread, which would crash the program if it drew at exit."""
        if self._window is not None:
            self._window.close()
            for thread in self._threads:
                thread.join(CLOSING_TIME)
            atexit.unregister(self.close)
        self._window, self._scene, self._threads = None, None, []


def check_screen() -> None:
    """Check that a window can be opened; otherwise MuJoCo's viewer would wait forever."""
    linux = sys.platform.startswith("linux")
    if linux and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise SimulationError(f"render mode human needs a screen (DISPLAY or WAYLAND_DISPLAY); {INSTEAD}")
    glfw: Any = import_module("glfw")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # A failure of GLFW is reported below.
        window = None
        if glfw.init():
            glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
            window = glfw.create_window(16, 16, "", None, None)
            glfw.default_window_hints()
    if window is None:
        screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") or sys.platform
        raise SimulationError(
            f"render mode human needs a screen with OpenGL, {screen!r} opens no window; {INSTEAD}"
        )
    glfw.destroy_window(window)


RENDER_MODES = ("human", "rgb_array", "depth_array", "map")
"""A window; a picture of the chase camera; its depths; a picture from above, which needs no OpenGL."""


def check_render_mode(mode: str | None, legal: Sequence[str] = RENDER_MODES) -> None:
    """Check a render mode; None is none."""
    if mode is not None and mode not in legal:
        raise ConfigError(f"unknown render mode {mode!r}; legal: {', '.join(legal)}, None")


class Views:
    """Renderers of a simulation, created on first use; a copy starts without any."""

    def __init__(self) -> None:
        self._camera, self._map, self._viewer = Camera(), MapView(), Viewer()

    def render(
        self,
        mode: str | None,
        snapshot: Snapshot,
        *,
        path: Sequence[Pose2] = (),
        scan: LaserScan | None = None,
    ) -> ByteArray | Float32Array | None:
        """Return the picture of one of `RENDER_MODES`; None for mode None and for the window `human`.

        Maps show the path until now, and a scan taken at the snapshot.
        """
        check_render_mode(mode)
        if mode == "rgb_array":
            return self._camera.rgb(snapshot)
        if mode == "depth_array":
            return self._camera.depth(snapshot)
        if mode == "map":
            return self._map.picture(snapshot, path=path, scan=scan)
        if mode == "human":
            self._viewer.show(snapshot)
        return None

    def close(self) -> None:
        """Release OpenGL resources and close the window."""
        self._camera.close()
        self._viewer.close()

    def __getstate__(self) -> dict[str, object]:
        # OpenGL contexts belong to the process and thread that created them.
        return {}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__init__()  # type: ignore[misc]
