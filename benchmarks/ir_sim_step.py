"""A step of ir-sim with a robot and a lidar: prints microseconds of processor time, beside `envs.py`.

Run by an interpreter that has ir-sim (`pip install ir-sim`), which need not have LIRS-WCT. A disc of a
Husky's size with its lidar (541 beams, 270 deg, 20 m) among 40 discs, or with the argument `squares` among
40 squares, on 50 m, by random actions that are held; flat, without physics of wheels, without noise.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from pathlib import Path

import irsim
import numpy as np

WORLD = """
world: {height: 50, width: 50, step_time: 0.04, sample_time: 0.04, collision_mode: unobstructed}
robot:
  - kinematics: {name: diff}
    shape: {name: circle, radius: 0.58}
    state: [25, 25, 0]
    vel_min: [-1, -2]
    vel_max: [1, 2]
    sensors:
      - {type: lidar2d, range_min: 0.5, range_max: 20, angle_range: 4.712, number: 541}
obstacle:
"""
SHAPES = {"discs": "{name: circle, radius: 1.0}", "squares": "{name: rectangle, length: 2.0, width: 2.0}"}
OBSTACLE = "  - {shape: %s, state: [%.2f, %.2f, 0]}\n"
STEPS, HELD, ROUNDS = 50, 10, 3


def main() -> None:
    """Measure."""
    shape = SHAPES[sys.argv[1] if len(sys.argv) > 1 else "discs"]
    rng = np.random.default_rng(0)
    places = [place for place in rng.uniform(2, 48, (60, 2)) if np.hypot(*(place - 25)) > 4][:40]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "world.yaml"
        file.write_text(WORLD + "".join(OBSTACLE % (shape, *place) for place in places), encoding="utf-8")
        env = irsim.make(str(file), display=False, disable_all_plot=True, log_level="ERROR")
    told = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        for k in range(STEPS):
            if k % HELD == 0:
                action = rng.uniform((-1, -2), (1, 2))
            env.step(action)
            ranges = env.get_lidar_scan()["ranges"]
        told.append((time.process_time() - begin) / STEPS * 1e6)
    assert len(ranges) == 541
    print(statistics.median(told))


if __name__ == "__main__":
    main()
