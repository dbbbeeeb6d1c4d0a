"""Cost of a reset, memory that environments grow by, and what a second process pays before its first step.

    python benchmarks/env_costs.py [--quick]

Memory: resident after 1,000 resets and 100,000 steps of an environment, less that before. Start: processor
time of a process of its own from `make` to the first step, where the world was built before. Reset: processor
time, mean over 100 resets; it exits 1 above the limits.
"""

from __future__ import annotations

import subprocess
import sys
import time
from typing import Any

import gymnasium as gym
import numpy as np

import lirs_envs  # noqa: F401  registers
from benchmarks.steps import arguments, resident_mb

IDS = "LIRS/Mapping-v2", "LIRS/Navigation-v1", "LIRS/Traverse-v1"
RESET_MS = {"LIRS/Navigation-v1": 8.0, "LIRS/Traverse-v1": 10.0}
"""Limits."""
N = 16
START = """
import time
import gymnasium as gym, lirs_envs, lirs_envs.env, lirs_envs.vector_env
begin = time.process_time()
env = gym.make("{id}")
env.reset(seed=1)
env.step(env.action_space.sample())
print(time.process_time() - begin)
"""


def main() -> None:
    """Measure and show."""
    given = arguments(__doc__, quick=False)
    resets, steps = (50, 5_000) if given.quick else (1_000, 100_000)
    found: dict[str, float] = {}

    def add(key: str, value: float) -> None:
        found[key] = value
        print(f"{key}: {value:.2f}", flush=True)

    for name in IDS:
        start_seconds(name)  # builds the world, and compiles
        add(f"{name} reset_ms", reset_ms(name))
        add(f"{name} start_s", start_seconds(name))
        add(f"{name} grown_mb", grown(gym.make(name, time_limit=20.0), 1, resets, steps))
        vector = gym.make_vec(name, num_envs=N, vectorization_mode="vector_entry_point", time_limit=20.0)
        add(f"{name} x {N} grown_mb", grown(vector, N, resets, steps))
    sys.exit(any(found[f"{name} reset_ms"] > limit for name, limit in RESET_MS.items()))


def reset_ms(name: str) -> float:
    """Return the milliseconds of processor time of a reset."""
    env = gym.make(name)
    for seed in range(5):
        env.reset(seed=seed)
    begin = time.process_time()
    for seed in range(100):
        env.reset(seed=seed)
    return (time.process_time() - begin) * 10


def start_seconds(name: str) -> float:
    """Return the seconds of processor time that a process needs for its first step, imports left out."""
    program = START.format(id=name)
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return float(told.stdout)


def grown(env: Any, count: int, resets: int, steps: int) -> float:
    """Return the megabytes that resets and steps of `count` environments leave behind."""
    recorded = (gym.wrappers.vector if count > 1 else gym.wrappers).RecordEpisodeStatistics(env)
    recorded.reset(seed=0)
    action = np.tile(np.array((0.5, 0.1), np.float32), (count, 1) if count > 1 else 1)
    drive(recorded, action, resets // (20 * count) + 1, steps // (20 * count))
    before = resident_mb()
    drive(recorded, action, resets // count, steps // count)
    after = resident_mb()
    recorded.close()
    return after - before


def drive(env: Any, action: np.ndarray, resets: int, steps: int) -> None:
    """Reset, then step; episodes that end begin anew."""
    vector = isinstance(env, gym.vector.VectorEnv)
    for _ in range(resets):
        env.reset()
    for _ in range(steps):
        *_, terminated, truncated, _ = env.step(action)
        if not vector and (terminated or truncated):
            env.reset()


if __name__ == "__main__":
    main()
