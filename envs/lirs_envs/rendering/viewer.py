"""MuJoCo's viewer on the scenes of a simulation, where a screen is."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from typing import Any

from lirs_envs.rendering.scene import HIDDEN_GROUPS, Scene
from lirs_envs.rendering.snapshot import Snapshot
from lirs_wct.errors import SimulationError


class Viewer:
    """A window that shows the latest snapshot; it opens with the first one."""

    def __init__(self) -> None:
        self._scene: Scene | None = None
        self._window: Any = None

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot.

        Raises:
            SimulationError: there is no screen.
        """
        if self._scene is None or self._scene.world is not snapshot.world:
            self.close()
            check_screen()
            self._scene = Scene(snapshot.world, snapshot.config)
            self._scene.place(snapshot)
            viewer: Any = import_module("mujoco.viewer")
            self._window = viewer.launch_passive(self._scene.model, self._scene.data)
            for group in HIDDEN_GROUPS:
                self._window.opt.geomgroup[group] = 0
        with self._window.lock():
            self._scene.place(snapshot)
        self._window.sync()

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            self._window.close()
        self._window = self._scene = None


def check_screen() -> None:
    """Check that a window can be opened.

    Raises:
        SimulationError: there is no screen.
    """
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise SimulationError(
            "render mode human needs a screen (DISPLAY or WAYLAND_DISPLAY); without one take rgb_array or map"
        )
