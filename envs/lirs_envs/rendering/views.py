"""The render modes of the environments."""

from __future__ import annotations

from collections.abc import Sequence

from lirs_envs.rendering.camera import Camera
from lirs_envs.rendering.map_view import MapView
from lirs_envs.rendering.snapshot import Snapshot
from lirs_envs.rendering.viewer import Viewer
from lirs_wct.arrays import ByteArray, Float32Array
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import LaserScan

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
    """What shows a simulation, one for each mode that was asked for; a copy begins without any."""

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
        """Return what a mode shows; None of mode None, and of `human`, which shows a window.

        Args:
            mode: see `RENDER_MODES`.
            snapshot: that is shown.
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
        """Free what OpenGL holds, and close the window."""
        self._camera.close()
        self._viewer.close()

    def __getstate__(self) -> dict[str, object]:
        # OpenGL belongs to the process and to what made it.
        return {}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__init__()  # type: ignore[misc]
