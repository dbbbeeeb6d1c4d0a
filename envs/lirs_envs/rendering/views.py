"""Render modes of the environments, and the window of MuJoCo's viewer."""

from __future__ import annotations

import atexit
import os
import sys
import threading
import warnings
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from lirs_envs.rendering.camera import Camera
from lirs_envs.rendering.map_view import MapView
from lirs_envs.rendering.scene import HIDDEN_GROUPS, RenderScene, Snapshot
from lirs_wct import ConfigError, LaserScan, Pose2, SimulationError
from lirs_wct.arrays import ByteArray, Float32Array

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
        """Show a snapshot; nothing once the user has closed the window.

        Raises:
            SimulationError: there is no screen.
        """
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
        """Close the window and wait for its thread.

        A thread that still draws at exit would crash the program.
        """
        if self._window is not None:
            self._window.close()
            for thread in self._threads:
                thread.join(CLOSING_TIME)
            atexit.unregister(self.close)
        self._window, self._scene, self._threads = None, None, []


def check_screen() -> None:
    """Check that a window can be opened.

    Otherwise MuJoCo's viewer would wait forever.

    Raises:
        SimulationError: there is no screen, or it does not open windows with OpenGL.
    """
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
    """Check a render mode; None is none.

    Raises:
        ConfigError: there is no such mode.
    """
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
        """Return the picture of a mode; None for mode None and for the window `human`.

        Args:
            mode: see `RENDER_MODES`.
            snapshot: state to draw.
            path: driven until now; on the map.
            scan: taken at the snapshot; on the map.

        Raises:
            ConfigError: there is no such mode.
            SimulationError: there is no OpenGL, or no screen.
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
