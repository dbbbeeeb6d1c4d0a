"""Lidar for any MuJoCo model, with height fields traced through their maximum mipmaps.

MuJoCo's own ray tests every cell of a height field below it, and from within a field it meets an inner plane.
Here each height field is a closed solid: triangles of its cells, four side walls and a bottom.
`mj_multiRay` meets all other geoms, in a copy of the model that hides the height fields.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple, get_args

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from lirs_envs.lidar.noise import (
    DATASHEET,
    LEVELS,
    NO_DRAWS,
    LidarNoise,
    NoiseLevel,
    draw_noise,
    lidar_noise,
    measure,
)
from lirs_envs.lidar.presets import LidarPreset, make_lidar_preset
from lirs_envs.lidar.terrain_rays import TerrainMipmap, build_terrain_mipmap, side_ranges, terrain_ranges
from lirs_wct import ConfigError, HeightField, SimulationError, unknown_name
from lirs_wct.arrays import BoolArray, FloatArray, IntArray, njit


class FieldGeom(NamedTuple):
    """Height field geom of a model.

    Attributes:
        terrain: Field in the geom's frame; heights in units of `elevation`, in which MuJoCo stores them.
        elevation: meters a unit of height.
        base: height of the bottom, in units of `elevation`.
    """

    geom: int
    terrain: TerrainMipmap
    elevation: float
    base: float


class TerrainLidar:
    """Lidar at a site of a compiled MuJoCo model.

    The model is read once, when the lidar is created; model and data are never changed. After a change of the
    model (`hfield_data`, `geom_size`), create the lidar again.

    Args:
        model: any compiled model.
        site: name or id of a site; x ahead, z up.
        pattern: name of a device (`vlp16`, `os1_32`, `utm30lx`, ...), or unit vectors (n, 3) in the site's
            frame.
        noise: `none`; `simulated` or `datasheet`, those of the pattern's device; or the name of a device, for
            its data sheet with any pattern.
        rng: random generator of the noise; required with noise.
        range_min: smallest range, meters; default: the device's, 0 for unit vectors.
        range_max: largest range, meters; default: the device's, inf for unit vectors.
        exclude: names or ids of bodies that beams pass through, one or several, each with all bodies below it
            unless it is the world. "" = all bodies without a name. Default: the site's body alone.
        groups: geom groups (0 to 5) that beams meet.

    Raises:
        ConfigError: an argument has an illegal value, or a name does not exist.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        site: str | int,
        pattern: str | ArrayLike,
        *,
        noise: str = "none",
        rng: np.random.Generator | None = None,
        range_min: float | None = None,
        range_max: float | None = None,
        exclude: str | int | Iterable[str | int] | None = None,
        groups: Collection[int] = range(mujoco.mjNGROUP),
    ) -> None:
        preset = make_lidar_preset(pattern) if isinstance(pattern, str) else None
        self._beams = _unit_vectors(pattern if preset is None else preset.all_directions)
        low, high = (0.0, math.inf) if preset is None else (preset.range_min, preset.range_max)
        self._limits = (low if range_min is None else range_min), (high if range_max is None else range_max)
        if not 0 <= self._limits[0] < self._limits[1]:
            raise ConfigError(
                "range_min must be at least 0 and below range_max, got {:g} and {:g} m".format(*self._limits)
            )
        self._noise, self._rng = _noise(noise, preset), rng
        self._parameters, self._exact = self._noise.parameters, np.zeros(len(self._beams))
        if rng is None and self._noise != LidarNoise():
            raise ConfigError(f"noise {noise!r} needs rng, such as numpy.random.default_rng(0)")
        self._site = _find_site(model, site)
        if not set(groups) <= set(range(mujoco.mjNGROUP)):
            raise ConfigError(f"geom groups must be 0 to {mujoco.mjNGROUP - 1}, got {sorted(groups)}")
        self._groups = np.array([group in groups for group in range(mujoco.mjNGROUP)], np.uint8)
        seen = _seen_geoms(model, _excluded_bodies(model, self._site, exclude), self._groups)
        fields = (model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD) & seen
        self._fields = [_field_geom(model, int(geom)) for geom in np.flatnonzero(fields)]
        self._model = model.__copy__()
        self._model.geom_matid[fields | ~seen] = -1
        self._model.geom_rgba[fields | ~seen, 3] = 0
        # Rays would mark the boxes that they meet in the user's data, for drawing.
        self._model.vis.global_.bvactive = 0

    def trace(self, data: mujoco.MjData | Sequence[mujoco.MjData]) -> FloatArray:
        """Return ranges (n,) in meters along the pattern's beams, or (m, n) of m states.

        inf = nothing in range, -inf = too near, NaN = lost (REP 117). A device's rings follow each other from
        the lowest up, counter-clockwise. Poses are those in `data`: after `mj_step`, those at its start until
        `mj_kinematics`. Of `data`, only MuJoCo's scratch stack is used, as by every ray of MuJoCo.

        Args:
            data: state of the model, or a sequence of states.

        Raises:
            ConfigError: the data belong to another model.
            SimulationError: the site's pose is not finite, or not yet computed.
        """
        if isinstance(data, mujoco.MjData):
            return self._trace(data)
        ranges = np.empty((len(data), len(self._beams)))
        for row, state in zip(ranges, data, strict=True):
            row[:] = self._trace(state)
        return ranges

    def _trace(self, data: mujoco.MjData) -> FloatArray:
        sizes = (self._model.nsite, self._model.ngeom)
        if (len(data.site_xpos), len(data.geom_xpos)) != sizes:
            raise ConfigError(
                f"data must belong to the lidar's model with {sizes[0]} sites and {sizes[1]} geoms, "
                f"got {len(data.site_xpos)} and {len(data.geom_xpos)}"
            )
        origin, n = data.site_xpos[self._site], len(self._beams)
        directions = np.empty((n, 3))
        rotation = data.site_xmat[self._site]
        if not (abs(rotation @ rotation - 3.0) < 1e-3 and math.isfinite(origin.sum())):
            raise SimulationError(
                f"the site's pose must be finite and computed, got position {origin}, rotation {rotation}: "
                "call mujoco.mj_kinematics(model, data) first"
            )
        _turn_beams(self._beams, rotation, directions)
        geoms, ranges, limit = np.empty(n, np.int32), np.empty(n), self._limits[1]
        rays = origin, directions.reshape(-1), self._groups
        cutoff = min(limit, mujoco.mjMAXVAL)
        mujoco.mj_multiRay(self._model, data, *rays, True, -1, geoms, ranges, None, n, cutoff)
        ranges[geoms < 0] = np.inf
        for field in self._fields:
            geom, *solid = field
            pose = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
            _field_ranges(*solid, *pose, origin, directions, limit, ranges)
        normal, uniform = self._exact, NO_DRAWS
        if self._rng is not None:
            normal, uniform = draw_noise(self._noise, n, self._rng)
        measured = np.empty(n)
        measure(ranges, normal, uniform, self._limits, self._parameters, measured)
        return measured


@njit
def _turn_beams(beams: FloatArray, rotation: FloatArray, directions: FloatArray) -> None:
    """Fill directions (n, 3) with beams in the world's frame.

    A matrix product of such shapes takes NumPy twice as long.
    """
    a, b, c, d, e, f, g, h, i = rotation
    for k in range(len(beams)):
        x, y, z = beams[k, 0], beams[k, 1], beams[k, 2]
        directions[k, 0] = a * x + b * y + c * z
        directions[k, 1] = d * x + e * y + f * z
        directions[k, 2] = g * x + h * y + i * z


@njit
def _field_ranges(
    terrain: TerrainMipmap,
    elevation: float,
    base: float,
    rotation: FloatArray,
    position: FloatArray,
    origin: FloatArray,
    directions: FloatArray,
    max_range: float,
    ranges: FloatArray,
) -> None:
    """Shorten `ranges` (n,) to a solid height field at a pose.

    In units of the elevation the float32 heights are MuJoCo's own, without rounding.
    """
    start, local = np.empty((1, 3)), np.empty((len(directions), 3))
    for axis in range(3):
        unit = 1.0 / elevation if axis == 2 else 1.0
        a, b, c = rotation[0, axis] * unit, rotation[1, axis] * unit, rotation[2, axis] * unit
        x, y, z = origin[0] - position[0], origin[1] - position[1], origin[2] - position[2]
        start[0, axis] = a * x + b * y + c * z
        for k in range(len(directions)):
            local[k, axis] = a * directions[k, 0] + b * directions[k, 1] + c * directions[k, 2]
    terrain_ranges(terrain, start, local, max_range, ranges)
    side_ranges(terrain, base, start[0], local, max_range, ranges)


def _unit_vectors(pattern: ArrayLike) -> FloatArray:
    """Return a checked pattern (n, 3), normalized to rounding."""
    beams = np.array(pattern, dtype=np.float64)
    if beams.ndim != 2 or beams.shape[1:] != (3,) or not len(beams):
        raise ConfigError(f"pattern must be a device or unit vectors (n, 3), got shape {beams.shape}")
    lengths = np.linalg.norm(beams, axis=-1)
    # float32 vectors are this exact.
    if not (np.abs(lengths - 1) < 1e-6).all():
        worst = lengths[np.argmax(np.abs(lengths - 1))]
        raise ConfigError(f"beams of a pattern must have length 1, got {worst:g}")
    unit: FloatArray = beams / lengths[:, None]
    return unit


def _noise(name: str, preset: LidarPreset | None) -> LidarNoise:
    """Return the noise of a name."""
    if name == "none":
        return LidarNoise()
    for level in get_args(NoiseLevel):
        if name == level and preset is not None:
            return lidar_noise(preset, level)
    if name in LEVELS:
        raise ConfigError(f"noise {name!r} is a device's: name the device as pattern, or as noise")
    if name not in DATASHEET:
        raise unknown_name("noise", name, (*LEVELS, *DATASHEET))
    return DATASHEET[name]


def _find_site(model: mujoco.MjModel, site: str | int) -> int:
    """Return the id of a site."""
    names = [model.site(k).name for k in range(model.nsite)]
    if site in names:
        return names.index(str(site))
    if isinstance(site, str) or not 0 <= site < model.nsite:
        raise unknown_name("site", str(site), [name or str(k) for k, name in enumerate(names)])
    return int(site)


def _excluded_bodies(
    model: mujoco.MjModel, site: int, exclude: str | int | Iterable[str | int] | None
) -> IntArray:
    """Return ids of the bodies that beams pass through."""
    if exclude is None:
        own: IntArray = model.site_bodyid[site : site + 1].astype(np.int64)
        return own[own > 0]
    names = [model.body(k).name for k in range(model.nbody)]
    found = np.zeros(model.nbody, np.bool_)
    if isinstance(exclude, str) or not isinstance(exclude, Iterable):
        exclude = [exclude]
    for body in exclude:
        if isinstance(body, int | np.integer):
            given = [k for k in range(model.nbody) if k == body]
        else:
            given = [k for k, name in enumerate(names) if name == body]
        if not given:
            raise unknown_name("body", str(body), [name or str(k) for k, name in enumerate(names)])
        found[given] = True
    for k in range(1, model.nbody):  # A parent comes before its children.
        parent = model.body_parentid[k]
        found[k] |= found[parent] and parent > 0
    return np.flatnonzero(found)


def _seen_geoms(model: mujoco.MjModel, excluded: IntArray, groups: np.ndarray) -> BoolArray:
    """Return (ngeom,) geoms that beams meet, by MuJoCo's rules: transparent ones are invisible."""
    opacity = model.geom_rgba[:, 3].copy()
    painted = model.geom_matid >= 0
    opacity[painted] = model.mat_rgba[model.geom_matid[painted], 3]
    group = np.clip(model.geom_group, 0, mujoco.mjNGROUP - 1)
    seen: BoolArray = (opacity > 0) & (groups[group] > 0) & ~np.isin(model.geom_bodyid, excluded)
    return seen


def _field_geom(model: mujoco.MjModel, geom: int) -> FieldGeom:
    """Return the height field of a geom."""
    field = int(model.geom_dataid[geom])
    rows, cols = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    begin = int(model.hfield_adr[field])
    x, y, elevation, base = map(float, model.hfield_size[field])
    heights = model.hfield_data[begin : begin + rows * cols].reshape(rows, cols)[::-1].copy()
    surface = HeightField(heights, (2 * x / (cols - 1), 2 * y / (rows - 1)), (-x, -y))
    return FieldGeom(geom, build_terrain_mipmap(surface), elevation, -base / elevation)
