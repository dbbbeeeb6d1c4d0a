"""Solids that a robot touches (ground, walls, convex parts): point-in-solid test."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from lirs_envs.robot_model import RobotModel
from lirs_validation.metrics.mesh import mesh_error
from lirs_wct import TriangleMesh, WallGrid, World
from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.contact.contact_geometry import ContactGeometry
from lirs_wct.contact.contact_parts import PRISM_ERROR, touching_volume

MOST_HULLS = 500
"""Convex parts above which bodies are touched on their surface (see `shell_parts`)."""


class ContactSolid:
    """Contact geometry of a world as a solid, independent of MuJoCo's collision detection."""

    def __init__(self, world: World, body: RobotModel, terrain: ContactGeometry) -> None:
        self._walls = world.walls
        self._hulls: list[FloatArray] = []
        self._solid: TriangleMesh | None = None
        self._slack = 0.0
        self._heights = world.surface
        if terrain in ("hfield", "mesh"):
            self._heights = body.contact.heights(world.surface)
        elif terrain == "prisms":
            limited = world.export_options.limited or world.solid is not None
            self._slack = mesh_error(world) if limited else PRISM_ERROR
        else:
            self._solid = world.solid
            # Thin shells of the body lie inside it; parts by CoACD bulge out of it.
            hulls = _hulls(body.model)
            self._hulls = hulls if len(hulls) <= MOST_HULLS else hulls[:1]

    def holds(self, points: FloatArray) -> BoolArray:
        """Return (n,) whether points (n, 3) lie inside."""
        if self._hulls:
            inside = np.zeros(len(points), np.bool_)
            for planes in self._hulls:
                inside |= (points @ planes[:, :3].T + planes[:, 3] < 0).all(axis=1)
            if self._solid is not None:
                inside |= touching_volume(self._solid, points)
            return inside
        x, y, z = points.T
        if self._walls is not None:
            return _in_walls(self._walls, points)
        # Beyond the border the height is NaN, and nothing is below it.
        below: BoolArray = z < self._heights.height_at(x, y) - self._slack
        return below


def _in_walls(walls: WallGrid, points: FloatArray) -> BoolArray:
    """Return whether points are in a wall, or under a floor that is there."""
    cells = np.floor(walls.origin.inverse().apply(points[:, :2]) / walls.resolution).astype(int)
    col, row = cells.T
    rows, cols = walls.shape
    on = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    row, col = np.where(on, row, 0), np.where(on, col, 0)
    z = points[:, 2]
    inside: BoolArray = on & (
        (walls.solid[row, col] & (z < walls.height)) | (walls.floor[row, col] & (z < 0))
    )
    return inside


def _hulls(model: mujoco.MjModel) -> list[FloatArray]:
    """Return (n, 4) the outward planes of each convex part."""
    hulls = []
    for g in np.flatnonzero((model.geom_bodyid == 0) & (model.geom_contype > 0)).tolist():
        mesh = int(model.geom_dataid[g])
        start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[g])
        corners = model.mesh_vert[start : start + count] @ turn.reshape(3, 3).T + model.geom_pos[g]
        hulls.append(np.array(ConvexHull(corners).equations))
    return hulls
