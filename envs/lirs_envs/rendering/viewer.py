"""MuJoCo's viewer on the scenes of a simulation, where a screen is."""

from __future__ import annotations

import atexit
import os
import sys
import threading
import warnings
from importlib import import_module
from typing import Any

from lirs_envs.rendering.scene import HIDDEN_GROUPS, Scene
from lirs_envs.rendering.snapshot import Snapshot
from lirs_wct.errors import SimulationError

INSTEAD = "without one take rgb_array or map"
CLOSING_TIME = 10.0
"""Longest time that the window is given to close, seconds."""


class Viewer:
    """A window that shows the latest snapshot; it opens with the first one."""

    def __init__(self) -> None:
        self._scene: Scene | None = None
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
        self._scene = Scene(snapshot.world, snapshot.config)
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
        """Close the window and wait for its thread, which would crash the program if it drew at its end."""
        if self._window is not None:
            self._window.close()
            for thread in self._threads:
                thread.join(CLOSING_TIME)
            atexit.unregister(self.close)
        self._window, self._scene, self._threads = None, None, []


def check_screen() -> None:
    """Check that a window can be opened: MuJoCo's viewer waits for ever for one that cannot.

    Raises:
        SimulationError: there is no screen, or it does not open windows with OpenGL.
    """
    linux = sys.platform.startswith("linux")
    if linux and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise SimulationError(f"render mode human needs a screen (DISPLAY or WAYLAND_DISPLAY); {INSTEAD}")
    glfw: Any = import_module("glfw")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # That GLFW cannot is said below.
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
