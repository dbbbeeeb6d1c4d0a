"""Time of a laser scan: our ray traversal beside MuJoCo's rays on the same terrain, and every limit it keeps.

    python benchmarks/lidar.py [--quick] [--only terrain|quadruped]

720 beams over 270 degrees, 30 m. `terrain`: from 0.45 m above the ground and tilted by it, on one square of
50 m sampled with 257^2 to 4097^2 heights; every method goes through the same poses one after the other, so
that none keeps a pose's cells in the processor's cache. `quadruped`: `TerrainLidar` on MuJoCo models beside
`mj_multiRay`, on a height field and without one. Times are of the processor; a broken limit exits 1.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray
from rich.progress import track

from benchmarks.steps import arguments, print_limits, print_rows
from lirs_envs.lidar import TerrainLidar
from lirs_envs.lidar.presets import ring_directions
from lirs_envs.lidar.ray_casting import RayCaster, mujoco_hits
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.pose import Pose2

Array = NDArray[np.float64]
Rays = tuple[Array, Array]
Cast = Callable[[Array, Array], Array]
SIDE, RANGE, FOV = 50.0, 30.0, 1.5 * np.pi
SIZES = (257, 513, 1025, 2049, 4097)
SAMPLES, BEAMS, POSES = 1025, 720, 40
LIMITS = {
    "scan_541_ms": ("541 beams at 1025^2 [ms]", "<=", 0.12),
    "rings_16x900_ms": ("16 rings of 900 beams at 1025^2 [ms]", "<=", 2.5),
    "growth_4097_257": ("4097^2, in scans of 257^2", "<=", 3.0),
    "ratio_mesh": ("times faster than MuJoCo's rays on a mesh", ">=", 14.0),
    "ratio_hfield": ("times faster than MuJoCo's rays on an hfield", ">=", 5000.0),
}
"""Limits of the terrains: in words, at most or at least, and how much."""
QUADRUPED_LIMITS = {
    "ratio_field": ("times faster than mj_multiRay on a height field", ">=", 1000.0),
    "share_plane": ("mj_multiRay's times without a height field", "<=", 1.05),
}


def octaves(samples: int, seed: int = 0) -> HeightField:
    """Noise with equal slope in every octave from 25 to 0.1 m: relief 4 m, 95 % of slopes below 21 deg."""
    rng = np.random.default_rng(seed)
    z = np.zeros((samples, samples), np.float32)
    for octave in range(1, 10):
        lattice = rng.standard_normal((2**octave + 3,) * 2).astype(np.float32) * 2.0 ** (1 - octave)
        z += cv2.resize(lattice, (samples, samples), interpolation=cv2.INTER_CUBIC)
    return HeightField.centered(z, (SIDE / (samples - 1),) * 2)


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
    """Return vertices and faces of a surface."""
    rows, cols = surface.shape
    west, south, east, north = surface.bounds
    x, y = np.meshgrid(np.linspace(west, east, cols), np.linspace(south, north, rows))
    k = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    sw, se, nw, ne = k[:-1, :-1], k[:-1, 1:], k[1:, :-1], k[1:, 1:]
    faces = np.stack((sw, se, ne, sw, ne, nw), axis=-1).reshape(-1, 3)
    return np.stack((x, y, surface.south_up), axis=-1).astype(np.float32), faces


def milliseconds(cast: Cast, rays: list[Rays], rounds: int) -> Array:
    """Return for each pose the median time over the rounds; a first scan, which compiles, does not count."""
    times = np.zeros((rounds, len(rays)))
    cast(rays[0][0], rays[0][1][:1])
    for turn in range(rounds):
        for k, (origin, directions) in enumerate(rays):
            begin = time.thread_time()
            cast(origin, directions)
            times[turn, k] = time.thread_time() - begin
    median: Array = np.median(times, axis=0) * 1e3
    return median


def measure_terrains(quick: bool) -> tuple[dict[str, float], list[dict[str, float]]]:
    """Return the figures and a row for each number of samples."""
    rounds, rows, figures = (10 if quick else 30), [], dict[str, float]()
    for samples in track(SIZES, "terrains", transient=True):
        surface = octaves(samples)
        rays = scans(surface, POSES, fan(BEAMS))
        begin = time.perf_counter()
        caster = RayCaster(surface)
        row = {"samples": samples, "build_ms": (time.perf_counter() - begin) * 1e3}

        def ours(o: Array, d: Array, caster: RayCaster = caster) -> Array:
            return caster.cast(o, d, RANGE)

        row["ours_ms"] = float(np.median(milliseconds(ours, rays, rounds)))
        if samples == SAMPLES:
            row |= compare_with_mujoco(surface, ours, rays, 3 if quick else 8)
            figures |= {key: row[key] for key in LIMITS if key in row}
            around = np.linspace(-np.pi, np.pi, 900, endpoint=False)
            rings = np.concatenate([ring_directions(around, up) for up in np.linspace(-0.26, 0.26, 16)])
            for name, beams in (("scan_541_ms", fan(541)), ("rings_16x900_ms", rings)):
                times = milliseconds(ours, scans(surface, POSES, beams), rounds // 3)
                figures[name] = float(np.median(times))
        rows.append(row)
    figures["growth_4097_257"] = rows[-1]["ours_ms"] / rows[0]["ours_ms"]
    return figures, rows


def compare_with_mujoco(surface: HeightField, ours: Cast, rays: list[Rays], rounds: int) -> dict[str, float]:
    """Return times of MuJoCo's rays, and ratios taken pose by pose."""
    mesh, hfield = mujoco_cast(surface, "mesh"), mujoco_cast(surface, "hfield")
    times, mesh_times = milliseconds(ours, rays, rounds), milliseconds(mesh, rays, rounds)
    hfield_times = milliseconds(hfield, rays[:rounds], 1)
    with np.errstate(invalid="ignore"):  # both see nothing
        apart = np.concatenate([np.abs(ours(o, d) - mesh(o, d)) for o, d in rays[:4]])
    return {
        "mesh_ms": float(np.median(mesh_times)),
        "hfield_ms": float(np.median(hfield_times)),
        "difference_m": float(apart[np.isfinite(apart)].max()),
        "ratio_mesh": float(np.median(mesh_times / times)),
        "ratio_hfield": float(np.median(hfield_times / times[:rounds])),
    }


LEG = """<body pos="{x} {y} 0"><joint axis="1 0 0"/><geom type="sphere" size=".05"/>
  <body><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 -.1 0 -.22" size=".03"/>
    <body pos="-.1 0 -.22"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .1 0 -.22" size=".02"/>
      <geom type="sphere" pos=".1 0 -.22" size=".025"/></body></body></body>"""
QUADRUPED = f"""<body name="trunk" pos="0 0 .5"><freejoint/><geom type="box" size=".25 .12 .06"/>
  <site name="lidar" pos=".2 0 .2"/>
  {"".join(LEG.format(x=x, y=y) for x in (0.2, -0.2) for y in (0.13, -0.13))}</body>"""
CLUTTER = "".join(
    f'<geom type="{kind}" size=".3 .4 .5" pos="{3 * np.cos(k)} {3 * np.sin(k)} .5"/>'
    for k, kind in enumerate(("box", "sphere", "capsule", "cylinder", "ellipsoid"))
)
FIELD = f'<hfield name="ground" nrow="{SAMPLES}" ncol="{SAMPLES}" size="{SIDE / 2} {SIDE / 2} {{relief}} 1"/>'
MODEL = "<mujoco><asset>{assets}</asset><worldbody>{ground}{robot}</worldbody></mujoco>"


def on_field() -> mujoco.MjModel:
    """Return the quadruped on rough terrain."""
    surface = octaves(SAMPLES)
    assets, ground = FIELD.format(relief=surface.relief), '<geom type="hfield" hfield="ground"/>'
    model = mujoco.MjModel.from_xml_string(MODEL.format(assets=assets, ground=ground, robot=QUADRUPED))
    model.hfield_data[:] = ((surface.south_up - surface.z.min()) / surface.relief).ravel()
    return model


def on_plane() -> mujoco.MjModel:
    """Return the quadruped on a plane between five bodies."""
    ground = '<geom type="plane" size="0 0 1"/>' + CLUTTER
    return mujoco.MjModel.from_xml_string(MODEL.format(assets="", ground=ground, robot=QUADRUPED))


def states(model: mujoco.MjModel, count: int) -> list[mujoco.MjData]:
    """Return states of the robot at random places, half a meter above the ground, tilted by up to 0.1 rad."""
    rng, placed = np.random.default_rng(1), []
    group, geom = np.ones(6, np.uint8), np.empty(1, np.int32)
    for x, y, yaw, pitch in rng.uniform((-20, -20, -np.pi, -0.1), (20, 20, np.pi, 0.1), (count, 4)):
        data = mujoco.MjData(model)
        data.qpos[:3] = x, y, 100.0
        mujoco.mj_kinematics(model, data)
        down = mujoco.mj_ray(model, data, data.qpos[:3] - (0, 0, 1), (0, 0, -1.0), group, True, 1, geom)
        data.qpos[2] += 0.5 - (1 + down)
        mujoco.mju_euler2Quat(data.qpos[3:7], np.array((yaw, pitch, 0.0)), "zyx")
        mujoco.mj_kinematics(model, data)
        placed.append(data)
    return placed


def measure_quadruped(model: mujoco.MjModel, count: int, rounds: int) -> float:
    """Return the median of mj_multiRay's times over ours, scan by scan; calls alternate."""
    beams, body = fan(BEAMS), model.site_bodyid[0]
    lidar, placed = TerrainLidar(model, "lidar", beams, range_max=RANGE), states(model, count)
    geoms, ranges = np.empty(BEAMS, np.int32), np.empty(BEAMS)

    def theirs(data: mujoco.MjData) -> None:
        d = (beams @ data.site_xmat[0].reshape(3, 3).T).ravel()
        origin = data.site_xpos[0]
        mujoco.mj_multiRay(model, data, origin, d, None, True, body, geoms, ranges, None, BEAMS, RANGE)

    lidar.trace(placed[0])
    times = np.empty((rounds, count, 2))
    for turn in range(rounds):
        for k, data in enumerate(placed):
            for which, trace in enumerate((lidar.trace, theirs)):
                begin = time.thread_time()
                trace(data)
                times[turn, k, which] = time.thread_time() - begin
    return float(np.median(times[..., 1] / times[..., 0]))


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, quick=False, only="")
    kept, figures = True, dict[str, Any]()
    if given.only != "quadruped":
        figures, rows = measure_terrains(given.quick)
        print_rows(sorted(rows, key=len, reverse=True), width=120)
        kept = print_limits(figures, LIMITS)
    if given.only != "terrain":
        figures["ratio_field"] = measure_quadruped(on_field(), 3 if given.quick else 10, 1)
        figures["share_plane"] = 1 / measure_quadruped(on_plane(), 20, 20 if given.quick else 200)
        kept &= print_limits(figures, QUADRUPED_LIMITS)
    sys.exit(not kept)


if __name__ == "__main__":
    main()
