"""PPO learns to reach goals from the scan, and is compared with policies without learning in unseen worlds.

python examples/train_navigation.py [--steps 120000] [--seed 0] [--episodes 20] [-o FOLDER]

Needs Stable-Baselines3 (`pip install 'lirs-wct[rl]'`). FOLDER gets `policy.zip` and `curve.csv`; with
--episodes 0 nothing is compared, with --steps 0 the policy in FOLDER is compared as it is.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable, Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TextIO

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import stats

import lirs_envs  # noqa: F401  registers LIRS/...
from lirs_envs.env import RobotEnv
from lirs_envs.generators.natural import EDGE, NATURAL_TERRAINS, NODES
from lirs_envs.generators.terrain import generate
from lirs_envs.policies.blind import RandomActions, StraightAhead
from lirs_envs.policies.go_to_goal import GoToGoal
from lirs_envs.policies.policy import Policy, PolicyContext
from lirs_envs.sb3 import as_vec_env
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.ground import Terrain
from lirs_wct.world import World

HERE = Path(__file__).parent
FOLDER = Path("out/navigation")
OBSERVE = ("sectors", "goal_direction", "attitude")
ROBOTS_PER_WORLD = 2
CONTROL_HZ = 5.0
"""Decisions a second."""
SAVE_EVERY = 8192
"""Environment steps."""


def course(kind: str, difficulty: float, seed: int) -> World:
    """Return a generated course as a world to navigate in."""
    return generate(kind, difficulty, np.random.default_rng(seed)).world()


def natural(kind: str, seed: int) -> World:
    """Return natural ground, 50 m square."""
    heights = NATURAL_TERRAINS[kind](np.random.default_rng(seed)).astype(np.float32)
    cell = EDGE / (NODES - 1)
    return World(kind, Terrain(HeightField.centered(heights, (cell, cell))), scale="generated")


Worlds = Mapping[str, Callable[[], str | World]]
TRAINED_ON: Worlds = {
    "simple": lambda: "simple",
    "office": lambda: str(HERE / "data" / "office.yaml"),
    "dunes": lambda: str(HERE / "data" / "dunes.png"),
    "plain with rocks": lambda: natural("plain with rocks", 1001),
    "hills with rocks": lambda: natural("hills with rocks", 1002),
    "open maze": lambda: course("mazes", 0.2, 1003),
    "maze": lambda: course("mazes", 0.5, 1004),
    "rough hills": lambda: natural("rough hills", 1005),
}
UNSEEN: Worlds = {
    "medium": lambda: "medium",
    "advanced": lambda: "advanced",
    "hills with rocks": lambda: natural("hills with rocks", 2001),
    "maze": lambda: course("mazes", 0.5, 2002),
}


def main() -> None:
    """Train, then compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=120_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=20, help="in each unseen world")
    parser.add_argument("-o", "--out", type=Path, default=FOLDER)
    given = parser.parse_args()
    if find_spec("stable_baselines3") is None:
        parser.error("needs Stable-Baselines3: pip install 'lirs-wct[rl]'")
    if given.steps:
        given.out.mkdir(parents=True, exist_ok=True)
        train(given.steps, given.seed, given.out)
    elif not (given.out / "policy.zip").is_file():
        parser.error(f"{given.out} holds no policy.zip: train one with --steps above 0")
    if given.episodes:
        compare(given.out / "policy.zip", given.episodes)


def train(steps: int, seed: int, folder: Path) -> None:
    """Train for a number of environment steps; save weights and learning curve."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    torch.set_num_threads(1)  # networks are small: more threads cost more than they bring
    envs = VecNormalize(training_envs(), norm_obs=False)  # scales the rewards
    policy = {"net_arch": [128, 128], "log_std_init": -0.5}
    model = PPO(
        "MultiInputPolicy", envs, n_steps=256, batch_size=512, n_epochs=6, policy_kwargs=policy,
        learning_rate=lambda left: 5e-4 * max(left, 0.1), seed=seed, device="cpu",
    )  # fmt: skip
    wall, cpu = time.perf_counter(), time.process_time()
    with (folder / "curve.csv").open("w", newline="", encoding="utf-8") as file:
        model.learn(steps, callback=Notes(file, folder / "policy.zip"))
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    print(f"{model.num_timesteps} steps in {wall:.0f} s, {cpu:.0f} s of processor time")
    model.save(folder / "policy.zip")
    envs.close()


def training_envs() -> Any:
    """Return robots in all the worlds that are trained on, as Stable-Baselines3 takes them."""
    from stable_baselines3.common.vec_env import VecMonitor

    vectors = [
        gym.make_vec(
            "LIRS/Navigation-v0", num_envs=ROBOTS_PER_WORLD, autoreset_mode="SameStep", world=world(),
            observe=OBSERVE, control_hz=CONTROL_HZ, difficulty=0.3,
        )
        for world in TRAINED_ON.values()
    ]  # fmt: skip
    return VecMonitor(as_vec_env(*vectors), info_keywords=("success", "collision"))


class Notes:
    """Writes a line for each episode that ends, and the weights every few thousand steps."""

    def __init__(self, file: TextIO, weights: Path) -> None:
        self._file, self._weights, self._worlds = file, weights, list(TRAINED_ON)
        self._writer = csv.writer(file)
        self._writer.writerow(("steps", "world", "return", "seconds", "success", "collision"))

    def __call__(self, local: dict[str, Any], _: dict[str, Any]) -> bool:
        """Look at a step; training goes on."""
        model = local["self"]
        for i, ended in enumerate(info.get("episode") for info in local["infos"]):
            if ended is not None:
                world, seconds = self._worlds[i // ROBOTS_PER_WORLD], ended["l"] / CONTROL_HZ
                outcome = int(ended["success"]), int(ended["collision"])
                self._writer.writerow((model.num_timesteps, world, ended["r"], seconds, *outcome))
        if model.num_timesteps % SAVE_EVERY == 0:
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


def compare(weights: Path, episodes: int) -> None:
    """Print success and SPL in the unseen worlds, in the same episodes, with 95 % intervals."""
    policies: Mapping[str, Callable[[PolicyContext], Policy]] = {
        "straight": StraightAhead,
        "random": RandomActions,
        "go to goal": GoToGoal,
        "PPO": partial(LearnedPolicy, weights=weights),
    }
    table = Table("policy", *UNSEEN, "success", "SPL")
    outcomes: dict[str, list[list[tuple[bool, float]]]] = {name: [] for name in policies}
    for world in UNSEEN.values():
        env = RobotEnv("navigation", world=world(), difficulty=0.5, observe=["scan", "goal", *OBSERVE])
        for name, make in policies.items():
            rows = [episode(env, make(PolicyContext.of(env.episodes.config, k)), k) for k in range(episodes)]
            outcomes[name].append(rows)
    for name, worlds in outcomes.items():
        shares = [f"{np.mean([success for success, _ in rows]):.2f}" for rows in worlds]
        success, spl = np.array([row for rows in worlds for row in rows], dtype=np.float64).T
        told = [
            f"{values.mean():.2f} [{low:.2f}, {high:.2f}]"
            for values, (low, high) in ((success, success_interval(success)), (spl, mean_interval(spl)))
        ]
        table.add_row(name, *shares, *told)
    Console(width=120).print(table)


def episode(env: RobotEnv, policy: Policy, seed: int) -> tuple[bool, float]:
    """Return success of an episode, and success weighted by path length (SPL, Anderson et al. 2018)."""
    observation, info = env.reset(seed=seed)
    policy.reset(info)
    driven, ended = 0.0, False
    while not ended:
        before = info["T_world_base"][:2]
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        driven += float(np.hypot(*(info["T_world_base"][:2] - before)))
        ended = terminated or truncated
    shortest = info["shortest_path"]
    return info["success"], info["success"] * shortest / max(driven, shortest)


def success_interval(success: np.ndarray) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson 1927)."""
    low, high = stats.binomtest(int(success.sum()), len(success)).proportion_ci(method="wilson")
    return low, high


def mean_interval(values: np.ndarray) -> tuple[float, float]:
    """Return the bootstrapped 95 % interval of a mean."""
    found = stats.bootstrap((values,), np.mean, method="percentile", rng=np.random.default_rng(0))
    return tuple(found.confidence_interval)


if __name__ == "__main__":
    main()
