"""The Gymnasium environment: drive slowly ahead, turn where the scan shows an obstacle; draw the last scan.

python examples/drive_with_gymnasium.py [--steps 200] [-o PICTURE]
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from matplotlib.figure import Figure

import lirs_envs  # noqa: F401  registers LIRS/...


def main() -> None:
    """Run one episode."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("-o", "--out", type=Path, default=Path("scan.png"))
    given = parser.parse_args()
    env = gym.make("LIRS/Mapping-v2", world="medium", robot="husky")
    observation, _ = env.reset(seed=1)
    earned = 0.0
    for _ in range(given.steps):
        observation, reward, terminated, truncated, _ = env.step(avoid(observation["scan"]))
        earned += float(reward)
        if terminated or truncated:
            break
    print(f"{given.steps} steps, return {earned:.1f}")
    draw(observation, given.out)
    env.close()


def avoid(scan: np.ndarray) -> np.ndarray:
    """Return speed and turn rate in [-1, 1]: ahead where the middle of the scan is free, else turn away."""
    right, ahead, left = (np.nanmin(part) for part in np.array_split(scan, 3))
    return np.array((0.6, 0.0) if ahead > 1.5 else (0.0, 1.0 if left > right else -1.0), np.float32)


def draw(observation: dict[str, Any], path: Path) -> None:
    """Save a picture of the scan: range over beam."""
    figure = Figure(figsize=(7, 2.5), layout="constrained")
    axes = figure.subplots()
    axes.plot(observation["scan"], linewidth=0.8)
    axes.set(xlabel="beam", ylabel="range [m]")
    figure.savefig(path)


if __name__ == "__main__":
    main()
