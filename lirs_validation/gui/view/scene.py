"""The three-dimensional part of a page: the world, seen from the south at first, as on a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import viser

from lirs_validation.gui.session.world_glb import PREVIEW_TEXTURE, TEXTURE, world_glb
from lirs_wct.world import World


@dataclass(frozen=True, kw_only=True)
class Detail:
    """How many triangles a browser is given.

    Attributes:
        preview: while controls are moved.
        built: after Build.
    """

    preview: int = 33_000
    built: int = 200_000


class Scene:
    """The world of a page.

    Args:
        client: the page.
        detail: triangles that it is given.
    """

    def __init__(self, client: viser.ClientHandle, detail: Detail) -> None:
        self._client, self._detail = client, detail
        self._bounds: tuple[float, ...] | None = None
        self._world: viser.GlbHandle | None = None
        client.scene.set_up_direction("+z")
        client.scene.configure_default_lights(True, cast_shadow=False)

    def show_world(self, world: World, *, coarse: bool) -> int:
        """Show a world in place of the one before; return its number of triangles as shown."""
        detail = self._detail
        most, texture = (detail.preview, PREVIEW_TEXTURE) if coarse else (detail.built, TEXTURE)
        content, triangles = world_glb(world, most, texture)
        self._world = self._client.scene.add_glb("/world", content)
        self._look_at(world)
        return triangles

    def clear(self) -> None:
        """Show no world."""
        if self._world is not None:
            self._world.remove()
        self._world = self._bounds = None

    def _look_at(self, world: World) -> None:
        """Move the camera to where another extent is seen as a whole; the user's own view stays."""
        bounds = world.surface.bounds
        if bounds == self._bounds:
            return
        self._bounds = bounds
        west, south, east, north = bounds
        middle = np.array(((west + east) / 2, (south + north) / 2, float(np.median(world.surface.z))))
        span = max(east - west, north - south)
        camera = self._client.camera
        with self._client.atomic():
            camera.near, camera.far = span / 2000, 20 * span
            camera.position = tuple(middle + span * np.array((0.0, -0.85, 0.65)))
            camera.look_at = tuple(middle)
