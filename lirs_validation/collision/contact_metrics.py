"""Metrics of a random drive: penetration, impacts, energy, forces, standing still."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.spatial import ConvexHull

from lirs_envs.robot_model import TIPPED, RobotModel
from lirs_validation.collision.random_drive import DEEP, DeepContact, Leg
from lirs_validation.metrics.world_geometry import mesh_error
from lirs_wct import TriangleMesh, WallGrid, World
from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.contact import ContactGeometry
from lirs_wct.contact.parts import PRISM_ERROR, touching_volume

InsideTest = Callable[[FloatArray], BoolArray]
"""Function of points (n, 3) that returns (n,) whether each is inside ground or wall."""
MOST_HULLS = 500
"""Convex parts above which bodies are touched on their surface (see `shell_parts`)."""
IMPACT = 0.010
"""Meters of penetration that an impact may reach for each meter a second."""
ONSET = 0.1
"""Seconds before a deep contact in which its impact began."""
WINDOW = 1.0
"""Seconds over which energy and standing still are looked at."""
RETURNED = math.exp(-4)
"""Share of an impact's energy that a critically damped contact gives back."""
STANDS = 0.1
"""Below this share of the commanded distance a robot counts as stuck."""


class Bounded(NamedTuple):
    """Worst of many values with individual limits, and its limit."""

    value: float
    limit: float

    @property
    def ratio(self) -> float:
        """Value over limit."""
        return self.value / self.limit


def penetrations(legs: Sequence[Leg]) -> tuple[float, Bounded]:
    """Return the 99.9 % quantile and the worst peak of the penetration, meters."""
    depth = np.concatenate([leg.depth for leg in legs])
    peaks = [_impact(leg, contact) for leg in legs for contact in leg.deep]
    return float(np.quantile(depth, 0.999)), worst(peaks or [Bounded(float(depth.max()), DEEP)])


def _impact(leg: Leg, contact: DeepContact) -> Bounded:
    """Return a deep contact and the depth that the speed of the impact allows it.

    The speed is the highest at which the robot, as one rigid body, moved there into the ground just before.
    """
    since = slice(max(0, contact.step - round(ONSET / leg.timestep)), contact.step + 1)
    arm = contact.point - leg.position[since]
    speed = -(leg.velocity[since] + np.cross(leg.spin[since], arm)) @ contact.normal
    return Bounded(contact.depth, max(DEEP, IMPACT * float(speed.max())))


def energy_gain(legs: Sequence[Leg], weight: float) -> Bounded:
    """Return the largest energy gain within a second, joules.

    The motors' work is subtracted.

    Args:
        legs: of the drive.
        weight: of the robot, newtons.
    """
    return worst(_gain(leg, weight) for leg in legs)


def _gain(leg: Leg, weight: float) -> Bounded:
    span = max(1, round(WINDOW / leg.timestep))
    # A window that ends at each step: the filters are centered.
    size, origin = span + 1, span // 2
    balance = leg.energy - (np.cumsum(leg.work) - leg.work)
    gain = balance - minimum_filter1d(balance, size, origin=origin, mode="nearest")
    # The impact whose energy comes back lies before the lowest point.
    since = span + round(ONSET / leg.timestep)
    kinetic = maximum_filter1d(leg.kinetic, since + 1, origin=since // 2, mode="nearest")
    limit = weight * DEEP + RETURNED * kinetic
    k = int(np.argmax(gain / limit))
    return Bounded(float(gain[k]), float(limit[k]))


def inside_steps(legs: Sequence[Leg], inside: InsideTest) -> int:
    """Return the number of steps in which a body's center was inside ground or wall."""
    return sum(
        int(inside(leg.bodies.reshape(-1, 3)).reshape(len(leg.depth), -1).any(axis=1).sum()) for leg in legs
    )


def stuck_seconds(legs: Sequence[Leg]) -> float:
    """Return the time that the robot stood upright, was commanded to drive, and came nowhere."""
    total = 0
    for leg in legs:
        span = round(WINDOW / leg.timestep)
        for k in range(0, len(leg.depth) - span, span):
            commanded = abs(sum(leg.commanded[k : k + span].tolist())) * leg.timestep
            moved = float(np.linalg.norm(leg.position[k + span] - leg.position[k]))
            upright = bool((leg.upright[k : k + span] >= TIPPED).all())
            total += commanded > 0 and upright and moved < STANDS * commanded
    return total * WINDOW


def forces(legs: Sequence[Leg]) -> tuple[float, float]:
    """Return the largest contact force and the mean force sum during contact, N."""
    total = np.concatenate([leg.force for leg in legs])
    touching = total[total > 0]
    peak = max(float(leg.peak_force.max(initial=0.0)) for leg in legs)
    return peak, float(touching.mean()) if len(touching) else 0.0


def driven(legs: Sequence[Leg]) -> float:
    """Return the distance that base_link travelled, meters."""
    return sum(float(np.linalg.norm(np.diff(leg.position, axis=0), axis=1).sum()) for leg in legs)


def worst(values: Iterable[Bounded]) -> Bounded:
    """Return the value that is highest against its limit."""
    return max(values, key=lambda bounded: bounded.ratio)


def inside_test(world: World, body: RobotModel, terrain: ContactGeometry) -> InsideTest:
    """Return a test of points against the contact geometry, independent of MuJoCo's collision detection."""
    hulls = _hulls(body.model) if terrain == "convex" else []
    if hulls:
        # Thin shells of the body lie inside it; parts by CoACD bulge out of it.
        return partial(_in_hulls, hulls if len(hulls) <= MOST_HULLS else hulls[:1], world.solid)
    if world.walls is not None:
        return partial(_in_walls, world.walls)
    heights, slack = world.surface, 0.0
    if terrain in ("hfield", "mesh"):
        heights = body.contact.heights(heights)
    elif terrain == "prisms":
        limited = world.export_options.limited or world.solid is not None
        slack = mesh_error(world) if limited else PRISM_ERROR
    # Beyond the border the height is NaN, and nothing is below it.
    return lambda points: points[:, 2] < heights.height_at(points[:, 0], points[:, 1]) - slack


def _in_hulls(hulls: Sequence[FloatArray], solid: TriangleMesh | None, points: FloatArray) -> BoolArray:
    """Return whether points are in a convex part, or in the solid."""
    inside = np.zeros(len(points), np.bool_)
    for planes in hulls:
        inside |= (points @ planes[:, :3].T + planes[:, 3] < 0).all(axis=1)
    return inside if solid is None else inside | touching_volume(solid, points)


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
