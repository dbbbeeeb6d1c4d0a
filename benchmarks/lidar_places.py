"""Where the laser's time is measured: rough terrain, also in MuJoCo."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from lirs_envs.lidar.ray_casting import mujoco_hits
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2

Array = NDArray[np.float64]
Rays = tuple[Array, Array]
Cast = Callable[[Array, Array], Array]
SIDE, RANGE, FOV = 50.0, 30.0, 1.5 * np.pi


def octaves(samples: int, seed: int = 0) -> HeightField:
    """Noise with equal slope in every octave from 25 to 0.1 m: relief 4 m, 95 % of slopes below 21 deg."""
    rng = np.random.default_rng(seed)
    z = np.zeros((samples, samples), np.float32)
    for octave in range(1, 10):
        knots = 2**octave
        lattice = rng.standard_normal((knots + 3, knots + 3)).astype(np.float32) * 2.0 ** (1 - octave)
        weights = _catmull_rom(samples, knots)
        z += (weights @ (weights @ lattice).T).T
    return HeightField.centered(z, (SIDE / (samples - 1),) * 2)


def _catmull_rom(samples: int, knots: int) -> sparse.csr_array:
    x = np.linspace(0, knots, samples)
    i = np.minimum(x.astype(int), knots - 1)
    f = x - i
    values = np.stack(
        (
            -0.5 * f + f**2 - 0.5 * f**3,
            1 - 2.5 * f**2 + 1.5 * f**3,
            0.5 * f + 2 * f**2 - 1.5 * f**3,
            -0.5 * f**2 + 0.5 * f**3,
        ),
        axis=1,
    ).astype(np.float32)
    rows, cols = np.repeat(np.arange(samples), 4), (i[:, None] + np.arange(4)).ravel()
    return sparse.csr_array((values.ravel(), (rows, cols)), shape=(samples, knots + 3))


def fan(beams: int) -> Array:
    """(beams, 3) directions over 270 degrees around the front."""
    angles = np.linspace(-FOV / 2, FOV / 2, beams)
    return np.stack((np.cos(angles), np.sin(angles), 0 * angles), axis=1)


def scans(surface: HeightField, count: int, beams: Array, seed: int = 1) -> list[Rays]:
    """Origins and directions of scans of a laser that stands upright on a robot 0.6 m long and wide."""
    rng, half = np.random.default_rng(seed), 0.3
    result = []
    for x, y, yaw in rng.uniform((-20, -20, -np.pi), (20, 20, np.pi), (count, 3)):
        wheels = Pose2(x, y, yaw).apply(((half, 0), (-half, 0), (0, half), (0, -half)))
        z = surface.height_at(wheels[:, 0], wheels[:, 1])
        feet = np.column_stack((wheels, z))
        ahead = (feet[0] - feet[1]) / np.linalg.norm(feet[0] - feet[1])
        up = np.cross(ahead, feet[2] - feet[3])
        up /= np.linalg.norm(up)
        axes = np.stack((ahead, np.cross(up, ahead), up))
        result.append((feet.mean(axis=0) + 0.45 * up, beams @ axes))
    return result


def mujoco_cast(surface: HeightField, kind: str) -> Cast:
    """Rays of MuJoCo on the terrain as one hfield or one mesh (with its bounding volume hierarchy)."""
    spec = mujoco.MjSpec()
    low, relief = float(surface.z.min()), surface.relief
    if kind == "hfield":
        (rows, cols), (width, depth) = surface.shape, surface.size
        data = ((surface.south_up - low) / relief).ravel()
        spec.add_hfield(name="t", nrow=rows, ncol=cols, size=[width / 2, depth / 2, relief, 1], userdata=data)
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="t", pos=[0, 0, low], group=3)
    else:
        vertices, faces = triangles(surface)
        shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.add_mesh(name="t", uservert=vertices.ravel(), userface=faces.ravel(), inertia=shell)
        geom = {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": "t", "group": 3}
        spec.worldbody.add_geom(**geom, contype=0, conaffinity=0)
    model = spec.compile()
    state = mujoco.MjData(model)
    mujoco.mj_forward(model, state)
    return lambda o, d: mujoco_hits(model, state, o, d, RANGE, groups=[3])[0]


def triangles(surface: HeightField) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    rows, cols = surface.shape
    west, south, east, north = surface.bounds
    x, y = np.meshgrid(np.linspace(west, east, cols), np.linspace(south, north, rows))
    k = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    sw, se, nw, ne = k[:-1, :-1], k[:-1, 1:], k[1:, :-1], k[1:, 1:]
    faces = np.stack((sw, se, ne, sw, ne, nw), axis=-1).reshape(-1, 3)
    return np.stack((x, y, surface.south_up), axis=-1).astype(np.float32), faces
