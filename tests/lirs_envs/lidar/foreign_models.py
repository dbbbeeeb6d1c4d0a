"""Twenty MuJoCo models in the styles of users, and brute force over the triangles of their height fields."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEG = """
<body pos="{x} {y} 0"><joint axis="1 0 0"/><geom type="sphere" size=".05"/>
  <body pos="0 {side} 0"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 -.1 0 -.22" size=".03"/>
    <body pos="-.1 0 -.22"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .1 0 -.22" size=".02"/>
      <geom type="ellipsoid" pos=".1 0 -.22" size=".04 .02 .03"/></body></body></body>
"""
QUADRUPED = f"""
<body name="trunk" pos="0 0 1"><freejoint/><geom type="box" size=".25 .12 .06"/>
  <site name="lidar" pos=".3 0 .12" euler="0 -10 0"/>
  {"".join(LEG.format(x=x, y=y, side=0.3 * y) for x in (0.2, -0.2) for y in (0.13, -0.13))}</body>
"""
DRONE = """
<body name="frame" pos="0 0 2"><freejoint/><geom type="cylinder" size=".12 .03"/>
  <geom type="capsule" fromto="-.2 -.2 0 .2 .2 0" size=".01"/>
  <geom type="capsule" fromto="-.2 .2 0 .2 -.2 0" size=".01"/>
  <body pos=".2 .2 .03"><joint axis="0 0 1"/><geom type="ellipsoid" size=".12 .02 .004"/></body>
  <body name="gimbal" pos="0 0 -.06"><joint axis="0 1 0"/><geom type="sphere" size=".03"/>
    <site name="lidar" pos="0 0 -.05" euler="0 90 0"/></body></body>
"""
ARM = """
<body name="link1" pos="0 0 .2"><joint axis="0 0 1"/><geom type="cylinder" size=".1 .2"/>
  <body name="link2" pos="0 0 .3"><joint axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .6 0 .2" size=".06"/>
    <body name="link3" pos=".6 0 .2"><joint axis="0 1 0"/><geom type="mesh" mesh="wedge"/>
      <body name="wrist" pos=".5 0 0"><joint axis="1 0 0"/><geom type="box" size=".05 .04 .03"/>
        <site name="lidar" pos=".1 0 0"/></body></body></body></body>
"""
WHEEL = """
<body pos="{x} {y} -.1"><joint axis="0 1 0"/><geom type="cylinder" size=".15 .05" euler="90 0 0"/></body>
"""
ROVER = f"""
<body name="chassis" pos="0 0 .6"><freejoint/><geom type="mesh" mesh="wedge"/>
  <geom type="box" size=".1 .1 .02" pos="0 0 .1"/>
  {"".join(WHEEL.format(x=x, y=y) for x in (0.3, 0, -0.3) for y in (0.25, -0.25))}
  <body name="mast" pos=".1 0 .1"><joint axis="0 0 1"/><geom type="capsule" fromto="0 0 0 0 0 .4" size=".02"/>
    <site name="lidar" pos="0 0 .5" euler="5 0 45"/></body></body>
"""
ROBOTS = {"quadruped": QUADRUPED, "drone": DRONE, "arm": ARM, "rover": ROVER}

CLUTTER = """
<geom type="box" size=".4 .2 .5" pos="2 1 .5" euler="0 0 30"/>
<geom type="ellipsoid" size=".5 .3 .4" pos="-1.5 2 .8"/>
<geom type="mesh" mesh="wedge" pos="-2 -1 1" euler="20 0 10"/>
"""
MOVING = '<inertial pos="0 0 0" mass="3" diaginertia="1 1 1"/>'
TERRAINS = {
    "square": '<geom type="hfield" hfield="square"/>',
    "long": '<geom type="plane" size="0 0 1" pos="0 0 -2"/><geom type="hfield" hfield="long"/>' + CLUTTER,
    "turned": '<geom type="hfield" hfield="long" pos="1 0 -.5" euler="15 -20 35"/>' + CLUTTER,
    "several": """
      <geom type="hfield" hfield="square" pos="-4 0 0"/>
      <geom type="hfield" hfield="long" pos="4 1 -.3" euler="0 0 90"/>
      <body pos="0 0 4" euler="180 0 0"><geom type="hfield" hfield="steps"/></body>""",
    "moving": f"""
      <geom type="plane" size="9 9 1" pos="0 0 -1"/>
      <body pos="2 0 .5"><freejoint/>{MOVING}<geom type="hfield" hfield="steps"/></body>
      <body pos="-3 0 0"><joint axis="1 1 0"/>{MOVING}
        <geom type="hfield" hfield="long" euler="0 0 50"/></body>""",
}
FIELDS = {"square": (41, 41, "4 4 1.2 .3"), "long": (23, 70, "6 2.5 .8 .1"), "steps": (38, 17, "1 2 .37 1.5")}
WORLD = """
<mujoco><size memory="4M"/><compiler angle="degree"/><asset>
  <mesh name="wedge" vertex="-.3 -.2 -.1  .3 -.2 -.1  .3 .2 -.1  -.3 .2 -.1  -.2 0 .15  .2 0 .1"/>{assets}
</asset><worldbody>{terrain}{robot}</worldbody></mujoco>
"""
NAMES = [f"{robot}-{terrain}" for robot in ROBOTS for terrain in TERRAINS]


def model_of(name: str, *, fields: bool = True) -> mujoco.MjModel:
    """Return one of the models, or the same without its height fields."""
    robot, terrain = name.split("-")
    assets = "".join(
        f'<hfield name="{field}" nrow="{rows}" ncol="{cols}" size="{size}"/>'
        for field, (rows, cols, size) in FIELDS.items()
    )
    spec = mujoco.MjSpec.from_string(
        WORLD.format(assets=assets, terrain=TERRAINS[terrain], robot=ROBOTS[robot])
    )
    if not fields:
        for geom in [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_HFIELD]:
            spec.delete(geom)
        return spec.compile()
    model = spec.compile()
    for k, (field, (rows, cols, _)) in enumerate(FIELDS.items()):
        rng = np.random.default_rng(k)
        z = np.cumsum(np.cumsum(rng.standard_normal((rows, cols)), axis=0), axis=1)
        z = (z - z.min()) / np.ptp(z) + 0.1 * rng.random((rows, cols))
        if field == "steps":
            z = np.round(4 * z) / 4
        z = (z - z.min()) / np.ptp(z)
        begin = model.hfield_adr[model.hfield(field).id]
        model.hfield_data[begin : begin + rows * cols] = z.ravel()
    return model


def place(model: mujoco.MjModel, rng: np.random.Generator) -> mujoco.MjData:
    """Return a state with free bodies anywhere, also inside of the ground, and all joints at random."""
    data = mujoco.MjData(model)
    for k in range(model.njnt):
        at = model.jnt_qposadr[k]
        if model.jnt_type[k] == mujoco.mjtJoint.mjJNT_FREE:
            data.qpos[at : at + 3] = rng.uniform((-5, -4, -1), (5, 4, 3))
            turn = rng.standard_normal(4)
            data.qpos[at + 3 : at + 7] = turn / np.linalg.norm(turn)
        else:
            data.qpos[at] = rng.uniform(-3, 3)
    mujoco.mj_kinematics(model, data)
    return data


def solid_triangles(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Return (n, 3, 3) corners of all height fields' surfaces, side walls and bottoms in the world frame."""
    found = [np.empty((0, 3, 3))]
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD):
        local = _field_triangles(model, model.geom_dataid[geom])
        found.append(local @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
    return np.concatenate(found)


def _field_triangles(model: mujoco.MjModel, field: int) -> Array:
    rows, cols = model.hfield_nrow[field], model.hfield_ncol[field]
    half_x, half_y, elevation, base = model.hfield_size[field]
    begin = model.hfield_adr[field]
    z = model.hfield_data[begin : begin + rows * cols].reshape(rows, cols) * elevation
    x, y = np.meshgrid(np.linspace(-half_x, half_x, cols), np.linspace(-half_y, half_y, rows))
    node = np.stack((x, y, z), axis=-1)
    sw, se, nw, ne = node[:-1, :-1], node[:-1, 1:], node[1:, :-1], node[1:, 1:]
    parts = [np.stack(corners, axis=2).reshape(-1, 3, 3) for corners in ((sw, se, ne), (sw, ne, nw))]
    for rim in (node[0], node[-1], node[:, 0], node[:, -1]):
        low = rim * (1, 1, 0) - (0, 0, base)
        parts.append(np.stack((rim[:-1], rim[1:], low[1:]), axis=1))
        parts.append(np.stack((rim[:-1], low[1:], low[:-1]), axis=1))
    a, b, c, d = (node[k] * (1, 1, 0) - (0, 0, base) for k in ((0, 0), (0, -1), (-1, -1), (-1, 0)))
    return np.concatenate([*parts, [(a, b, c), (a, c, d)]])


@njit
def triangle_ranges(triangles: Array, origin: Array, directions: Array, ranges: Array) -> None:
    """Shorten ranges (n,) to the nearest triangle (Moeller and Trumbore 1997)."""
    for m in range(len(triangles)):
        a, e, f = triangles[m, 0], triangles[m, 1] - triangles[m, 0], triangles[m, 2] - triangles[m, 0]
        sx, sy, sz = origin[0] - a[0], origin[1] - a[1], origin[2] - a[2]
        qx, qy, qz = sy * e[2] - sz * e[1], sz * e[0] - sx * e[2], sx * e[1] - sy * e[0]
        for k in range(len(directions)):
            x, y, z = directions[k, 0], directions[k, 1], directions[k, 2]
            px, py, pz = y * f[2] - z * f[1], z * f[0] - x * f[2], x * f[1] - y * f[0]
            volume = px * e[0] + py * e[1] + pz * e[2]
            if volume == 0.0:
                continue
            u, v = (sx * px + sy * py + sz * pz) / volume, (x * qx + y * qy + z * qz) / volume
            t = (f[0] * qx + f[1] * qy + f[2] * qz) / volume
            if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and 0.0 <= t < ranges[k]:
                ranges[k] = t


@dataclass(frozen=True)
class BruteForce:
    """The nearest hit of every ray with every triangle, and MuJoCo's single rays for all else."""

    model: mujoco.MjModel
    bare: mujoco.MjModel

    def ranges(self, data: mujoco.MjData, directions: Array) -> Array:
        """Return (n,) ranges along directions (n, 3) in the site's frame."""
        other = mujoco.MjData(self.bare)
        other.qpos[:] = data.qpos
        mujoco.mj_kinematics(self.bare, other)
        site = self.model.site("lidar").id
        origin, body = data.site_xpos[site].copy(), self.model.site_bodyid[site]
        d = np.ascontiguousarray(directions @ data.site_xmat[site].reshape(3, 3).T)
        hit = np.empty(1, np.int32)
        ranges = np.array([mujoco.mj_ray(self.bare, other, origin, row, None, True, body, hit) for row in d])
        ranges[ranges < 0] = np.inf
        triangle_ranges(solid_triangles(self.model, data), origin, d, ranges)
        return ranges


def random_beams(count: int, rng: np.random.Generator) -> Array:
    """Return (count, 3) unit vectors in all directions."""
    v = rng.standard_normal((count, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]
