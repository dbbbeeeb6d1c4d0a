"""Pictures and depths of a camera, through OpenGL."""

from __future__ import annotations

import os

import mujoco
import numpy as np

from lirs_envs.rendering.scene import RenderScene, Snapshot, scene_options
from lirs_wct.arrays import ByteArray, Float32Array
from lirs_wct.errors import SimulationError

SHAPE = (480, 640)
"""Height and width of a picture, pixels."""
CHASE = "chase"
"""The camera behind a robot, which every robot has."""
_drawing: set[int] = set()
"""Number of the process that draws with OpenGL; none before the first picture."""
GOAL_HEIGHT, GOAL_RADIUS, GOAL_COLOR = 2.0, 0.06, (0.85, 0.1, 0.2, 1.0)


class Camera:
    """Camera for snapshots; the scene is rebuilt when the world changes.

    Args:
        shape: height and width of a picture, pixels.
    """

    def __init__(self, shape: tuple[int, int] = SHAPE) -> None:
        self._shape = shape
        self._options = scene_options()
        self._scene: RenderScene | None = None
        self._renderer: mujoco.Renderer | None = None

    def rgb(self, snapshot: Snapshot) -> ByteArray:
        """Return a picture (height, width, 3).

        Raises:
            SimulationError: there is no OpenGL.
        """
        renderer = self._see(snapshot)
        if snapshot.goal is not None:
            _mark_goal(renderer.scene, snapshot)
        picture: ByteArray = renderer.render()
        return picture

    def depth(self, snapshot: Snapshot) -> Float32Array:
        """Return (height, width) float32 distances from the camera's plane, meters; the sky is far away.

        Raises:
            SimulationError: there is no OpenGL.
        """
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
        _check_process()
        if self._scene is None or self._scene.world is not snapshot.world:
            self.close()
            self._scene = RenderScene(snapshot.world, snapshot.config)
        self._scene.place(snapshot)
        if self._renderer is None:
            self._renderer = _make_renderer(self._scene.model, self._shape)
        self._renderer.update_scene(self._scene.data, camera=CHASE, scene_option=self._options)
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        return self._renderer


def _check_process() -> None:
    """Check that OpenGL was not used before this process was forked: it would wait forever."""
    if _drawing and os.getpid() not in _drawing:
        raise SimulationError(
            "no picture in a process that was forked after one was drawn: start it with spawn, or use render "
            "mode map"
        )


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
