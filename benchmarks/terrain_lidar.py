"""`TerrainLidar` beside `mj_multiRay` on MuJoCo models: a quadruped on a height field, and one without it.

    python benchmarks/terrain_lidar.py [--quick]

720 beams over 270 degrees, 30 m, from a lidar on the quadruped's back. It exits 1 below 1,000 times the
speed of `mj_multiRay` on a square of 50 m with 1025^2 heights, or above 1.05 times its time on a plane.
Both turn the beams into the world's frame first. Calls alternate, times are of the processor, and the figures
are medians.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import mujoco
import numpy as np

from benchmarks.lidar import RANGE, SIDE, Array, fan, octaves
from benchmarks.steps import arguments
from lirs_envs.lidar import TerrainLidar

SAMPLES, BEAMS = 1025, 720
SPEED, SHARE = 1000.0, 1.05
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
    rng, found = np.random.default_rng(1), []
    group, geom = np.ones(6, np.uint8), np.empty(1, np.int32)
    for x, y, yaw, pitch in rng.uniform((-20, -20, -np.pi, -0.1), (20, 20, np.pi, 0.1), (count, 4)):
        data = mujoco.MjData(model)
        data.qpos[:3] = x, y, 100.0
        mujoco.mj_kinematics(model, data)
        down = mujoco.mj_ray(model, data, data.qpos[:3] - (0, 0, 1), (0, 0, -1.0), group, True, 1, geom)
        data.qpos[2] += 0.5 - (1 + down)
        mujoco.mju_euler2Quat(data.qpos[3:7], np.array((yaw, pitch, 0.0)), "zyx")
        mujoco.mj_kinematics(model, data)
        found.append(data)
    return found


def theirs(model: mujoco.MjModel) -> Callable[[mujoco.MjData], Array]:
    """Return the same scan by `mj_multiRay`."""
    beams, body = fan(BEAMS), model.site_bodyid[0]

    def trace(data: mujoco.MjData) -> Array:
        geoms, ranges = np.empty(BEAMS, np.int32), np.empty(BEAMS)
        d = (beams @ data.site_xmat[0].reshape(3, 3).T).ravel()
        mujoco.mj_multiRay(
            model, data, data.site_xpos[0], d, None, True, body, geoms, ranges, None, BEAMS, RANGE
        )
        return ranges

    return trace


def compare(model: mujoco.MjModel, count: int, rounds: int) -> tuple[float, float, float]:
    """Return milliseconds of ours and theirs, and the median of theirs over ours, scan by scan."""
    lidar, mujoco_scan = TerrainLidar(model, "lidar", fan(BEAMS), range_max=RANGE), theirs(model)
    placed = states(model, count)
    lidar.trace(placed[0])
    times = np.empty((rounds, count, 2))
    for turn in range(rounds):
        for k, data in enumerate(placed):
            for which, trace in enumerate((lidar.trace, mujoco_scan)):
                begin = time.thread_time()
                trace(data)
                times[turn, k, which] = time.thread_time() - begin
    ours, other = np.median(times[..., 0]) * 1e3, np.median(times[..., 1]) * 1e3
    return float(ours), float(other), float(np.median(times[..., 1] / times[..., 0]))


def main() -> None:
    """Measure and print."""
    quick = arguments(__doc__, quick=False).quick
    ours, other, speed = compare(on_field(), 3 if quick else 10, 1)
    print(f"height field of {SAMPLES}^2: {ours:.3f} ms, mj_multiRay {other:.0f} ms: {speed:,.0f} x as fast")
    ours, other, inverse = compare(on_plane(), 20, 20 if quick else 200)
    print(f"without height field: {ours:.3f} ms, mj_multiRay {other:.3f} ms: {1 / inverse:.3f} x its time")
    sys.exit(speed < SPEED or 1 / inverse > SHARE)


if __name__ == "__main__":
    main()
