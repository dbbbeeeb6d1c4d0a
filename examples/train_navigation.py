"""PPO learns to reach goals from the scan, with four robots in the worlds of the benchmark's training split.

python examples/train_navigation.py [--steps 400000] [--seed 0] [--data FOLDER] [-o FOLDER]
lirs-wct bench straight random go_to_goal examples.train_navigation:LearnedPolicy --set lirs --task navigation
    --split validation -o out/bench

Needs Stable-Baselines3 (`pip install '.[rl]'`). FOLDER gets `policy.zip` and `curve.csv`.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TextIO

import gymnasium as gym
import numpy as np

import lirs_envs  # noqa: F401  registers LIRS/...
from lirs_envs.policies import PolicyContext
from lirs_envs.sb3 import as_vec_env
from lirs_validation.bench.task_worlds import WorldSpec
from lirs_validation.bench.tasks import SETS, task_set
from lirs_wct.world import World

FOLDER = Path("out/navigation")
OBSERVE = ("sectors", "goal_direction", "attitude", "body")
ROBOTS_PER_PLACE = 2
DIFFICULTY = 0.5
CONTROL_HZ = 5.0
"""Decisions a second."""
SAVE_EVERY = 8192
"""Environment steps."""
FURTHER_PLANS = 3
"""Floor plans to train on beside the benchmark's: rooms and doors are what is learnt last."""

Place = tuple[World, str]
"""A world, and the robot in it."""


def training_places(data: Path | None) -> list[Place]:
    """Return worlds and robots of the benchmark's navigation tasks to train on, those that are here."""
    tasks = [task for name in SETS for task in task_set(name).chosen("navigation", "train")]
    named = dict.fromkeys((task.world, task.robot) for task in tasks)
    plans = [place for place in named if place[0].maker == "floor plan"]
    for seed in range(FURTHER_PLANS):
        world = WorldSpec(name=f"further-plan-{seed}", maker="floor plan", options=(("seed", 1000 + seed),))
        named[world, plans[seed % len(plans)][1]] = None
    return [(world.world(data), robot) for world, robot in named if data or not world.files]


def main() -> None:
    """Train."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=400_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--data", type=Path, help="folder with the maps and pictures that do not ship")
    parser.add_argument("-o", "--out", type=Path, default=FOLDER)
    given = parser.parse_args()
    if find_spec("stable_baselines3") is None:
        parser.error("needs Stable-Baselines3: pip install '.[rl]'")
    given.out.mkdir(parents=True, exist_ok=True)
    train(training_places(given.data), given.steps, given.seed, given.out)


def train(places: Sequence[Place], steps: int, seed: int, folder: Path) -> None:
    """Train for a number of environment steps; save weights and learning curve."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    torch.set_num_threads(1)  # networks are small: more threads cost more than they bring
    envs = VecNormalize(training_envs(places), norm_obs=False)  # scales the rewards
    policy = {"net_arch": [128, 128], "log_std_init": -0.5}
    model = PPO(
        "MultiInputPolicy", envs, n_steps=256, batch_size=512, n_epochs=6, policy_kwargs=policy,
        learning_rate=lambda left: 5e-4 * max(left, 0.1), seed=seed, device="cpu",
    )  # fmt: skip
    wall, cpu = time.perf_counter(), time.process_time()
    with (folder / "curve.csv").open("w", newline="", encoding="utf-8") as file:
        model.learn(steps, callback=Notes(file, folder / "policy.zip", places))
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    print(f"{model.num_timesteps} steps in {wall:.0f} s, {cpu:.0f} s of processor time")
    model.save(folder / "policy.zip")
    envs.close()


def training_envs(places: Sequence[Place]) -> Any:
    """Return robots in all the worlds that are trained on, as Stable-Baselines3 takes them."""
    from stable_baselines3.common.vec_env import VecMonitor

    vectors = [
        gym.make_vec(
            "LIRS/Navigation-v1", num_envs=ROBOTS_PER_PLACE, autoreset_mode="SameStep", world=world,
            robot=robot, observe=OBSERVE, control_hz=CONTROL_HZ, difficulty=DIFFICULTY,
        )
        for world, robot in places
    ]  # fmt: skip
    return VecMonitor(as_vec_env(*vectors), info_keywords=("success", "collision"))


class Notes:
    """Writes a line for each episode that ends, and the weights every few thousand steps."""

    def __init__(self, file: TextIO, weights: Path, places: Sequence[Place]) -> None:
        self._file, self._weights, self._places = file, weights, places
        self._saved = 0
        self._writer = csv.writer(file)
        self._writer.writerow(("steps", "world", "robot", "return", "seconds", "success", "collision"))

    def __call__(self, local: dict[str, Any], _: dict[str, Any]) -> bool:
        """Look at a step; training goes on."""
        model = local["self"]
        for i, ended in enumerate(info.get("episode") for info in local["infos"]):
            if ended is not None:
                world, robot = self._places[i // ROBOTS_PER_PLACE]
                outcome = ended["r"], ended["l"] / CONTROL_HZ, int(ended["success"]), int(ended["collision"])
                self._writer.writerow((model.num_timesteps, world.name, robot, *outcome))
        if model.num_timesteps >= self._saved + SAVE_EVERY:
            self._saved = model.num_timesteps
            model.save(self._weights)
            self._file.flush()
        return True


class LearnedPolicy:
    """The policy that was trained, at any rate of steps.

    lirs-wct bench examples.train_navigation:LearnedPolicy --set lirs --task navigation -o out/bench
    """

    observe = OBSERVE

    def __init__(self, context: PolicyContext, weights: str | Path = FOLDER / "policy.zip") -> None:
        from stable_baselines3 import PPO

        self._model = PPO.load(weights, device="cpu")
        self._hold = max(1, round(1 / CONTROL_HZ / context.period))
        self._left = 0

    def reset(self, info: Mapping[str, Any]) -> None:
        """Begin an episode."""
        self._left = 0

    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """Return an action, decided anew five times a second."""
        if self._left == 0:
            seen = {name: observation[name] for name in OBSERVE}
            self._action, _ = self._model.predict(seen, deterministic=True)
            self._left = self._hold
        self._left -= 1
        return self._action


if __name__ == "__main__":
    main()
