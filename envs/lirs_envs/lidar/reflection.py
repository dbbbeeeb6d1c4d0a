"""Intensity of returns, from range, incidence and the reflectivity of the surface."""

from __future__ import annotations

import math

import numpy as np

from lirs_envs.lidar.obstacle_rays import WallCells
from lirs_envs.lidar.terrain_rays import EDGE, LEAF, ROW, TerrainMipmap
from lirs_wct.arrays import Float32Array, FloatArray, njit

GROUND, WALL, PROP, WALKER = 0.25, 0.4, 0.5, 0.6
"""Assumed diffuse reflectivities near 905 nm: dry soil, concrete, painted boxes, clothes."""
BRIGHTEST = 255.0
"""Intensity of a white diffuse surface (reflectivity 1) at normal incidence, up to REFERENCE_RANGE."""
REFERENCE_RANGE = 10.0
"""Range up to which the receiver corrects the loss, meters."""
ON_FACE = 1e-6
"""Largest distance of a hit from the face of its wall, cells: far more than rounding."""


def intensities(ranges: Float32Array, reflectances: FloatArray) -> Float32Array:
    """Return (n,) intensities of returns, 0 to BRIGHTEST.

    The lidar equation for diffuse surfaces wider than the beam (Hoefle and Pfeifer, "Correction of laser
    scanning intensity data", ISPRS Journal 2007, eq. 5), without atmosphere.

    Args:
        ranges: (n,) meters; inf = no return.
        reflectances: (n,) reflectivity times cosine of the incidence.
    """
    loss = np.minimum(1.0, np.square(REFERENCE_RANGE / np.maximum(ranges, REFERENCE_RANGE)))
    return (BRIGHTEST * reflectances * loss).astype(np.float32)


def reflect(reflectivity: float, normals: FloatArray, directions: FloatArray) -> FloatArray:
    """Return (n,) reflectances of surfaces: reflectivity times cosine of the incidence.

    Args:
        reflectivity: of the surfaces.
        normals: (n, 3) of any length; 0 where nothing is hit.
        directions: (n, 3) unit vectors of the beams.
    """
    length = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    cosines: FloatArray = np.abs(np.einsum("ij,ij->i", normals, directions)) / length
    return reflectivity * cosines


@njit
def world_reflectances(
    terrain: TerrainMipmap,
    walls: WallCells,
    origins: FloatArray,
    directions: FloatArray,
    ranges: FloatArray,
    reflectances: FloatArray,
) -> None:
    """Fill `reflectances` (n,) of hits at `ranges` (n,) on walls and ground. 0 = no hit."""
    for k in range(len(ranges)):
        reflectances[k] = 0.0
        if ranges[k] < np.inf:
            o, d = origins[min(k, len(origins) - 1)], directions[k]
            x, y, z = o[0] + ranges[k] * d[0], o[1] + ranges[k] * d[1], o[2] + ranges[k] * d[2]
            cosine = _wall_cosine(walls, x, y, z, d)
            reflectances[k] = WALL * cosine if cosine >= 0.0 else GROUND * _ground_cosine(terrain, x, y, d)


@njit
def _wall_cosine(walls: WallCells, x: float, y: float, z: float, d: FloatArray) -> float:
    """Return the cosine of the incidence on a wall's face. -1 = the point is on no face."""
    distance, frame = walls.distance, walls.frame
    if distance.size == 0:
        return -1.0
    rows, columns = distance.shape
    c, s, resolution, height = frame[2], frame[3], frame[4], frame[5]
    u = (c * (x - frame[0]) + s * (y - frame[1])) / resolution
    v = (c * (y - frame[1]) - s * (x - frame[0])) / resolution
    du, dv = c * d[0] + s * d[1], c * d[1] - s * d[0]
    # The cell behind the face lies a little farther along the beam.
    i, j = math.floor(u + math.copysign(ON_FACE, du)), math.floor(v + math.copysign(ON_FACE, dv))
    if not (0 <= i < columns and 0 <= j < rows) or distance[j, i] > 0 or z > height + ON_FACE:
        return -1.0
    if abs(u - round(u)) < ON_FACE:
        return float(abs(du))
    if abs(v - round(v)) < ON_FACE:
        return float(abs(dv))
    return float(abs(d[2])) if abs(z - height) < ON_FACE else -1.0


@njit
def _ground_cosine(terrain: TerrainMipmap, x: float, y: float, d: FloatArray) -> float:
    """Return the cosine of the incidence on the triangle at a point."""
    frame, (nx, ny) = terrain.frame, terrain.cells
    u, v = (x - frame[0]) / frame[2], (y - frame[1]) / frame[3]
    i, j = min(max(int(u), 0), nx - 1), min(max(int(v), 0), ny - 1)
    block = terrain.block[(j >> LEAF) * terrain.width[LEAF] + (i >> LEAF)]
    sw = ROW * (j % EDGE) + i % EDGE
    if u - i >= v - j:
        rise_u, rise_v = block[sw + 1] - block[sw], block[sw + ROW + 1] - block[sw + 1]
    else:
        rise_u, rise_v = block[sw + ROW + 1] - block[sw + ROW], block[sw + ROW] - block[sw]
    a, b = rise_u / frame[2], rise_v / frame[3]
    return float(abs(d[2] - a * d[0] - b * d[1])) / math.sqrt(1.0 + a * a + b * b)
