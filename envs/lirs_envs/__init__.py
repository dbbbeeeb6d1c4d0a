"""Gymnasium environments of LIRS-WCT; importing this package registers them."""

import ctypes
import os
import sys

from gymnasium.envs.registration import register


def _choose_opengl() -> None:
    """Select EGL for MuJoCo where no screen exists and EGL is installed.

    MuJoCo reads the variable when it is imported.

    Without EGL nothing is set: selecting a missing EGL would prevent the import of MuJoCo.
    """
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if "MUJOCO_GL" in os.environ or screen or not sys.platform.startswith("linux"):
        return
    try:
        for library in ("libEGL.so.1", "libOpenGL.so.0"):
            ctypes.CDLL(library)
    except OSError:
        return
    os.environ["MUJOCO_GL"] = "egl"


_choose_opengl()

for _id, _task in (("Mapping-v2", "mapping"), ("Navigation-v1", "navigation"), ("Traverse-v1", "traverse")):
    register(
        id=f"LIRS/{_id}",
        entry_point="lirs_envs.env:RobotEnv",
        vector_entry_point="lirs_envs.vector_env:RobotVectorEnv",
        kwargs={"task": _task},
    )
