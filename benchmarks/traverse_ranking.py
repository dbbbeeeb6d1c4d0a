"""Mean return and mean score of policies on courses to traverse: both must rank the policies alike.

    python benchmarks/traverse_ranking.py [--courses N]

Eight policies drive a Husky over 20 test courses of the benchmark's set `generated`. The score is that of
`lirs-wct bench`: the share of the distance to the goal that is gained at the end. It exits 1 where Spearman's
rank correlation of the two means is below .8, or where standing still earns as much as a drive to the goal.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from rich.progress import track
from scipy.stats import spearmanr

from benchmarks.steps import arguments, print_rows
from lirs_envs.env import RobotEnv
from lirs_envs.policies import GoToGoal, Policy, PolicyContext, RandomActions, StraightAhead
from lirs_extensions.bench.episode import distance_share, make_task_env, reset_options
from lirs_extensions.bench.policies import BASELINES
from lirs_extensions.bench.tasks import BenchTask, task_set

LEAST = 0.8


class Constant:
    """The same action in each step."""

    def __init__(self, speed: float, turn: float) -> None:
        self._action = np.array((speed, turn), np.float32)

    def reset(self, info: object) -> None:
        """Begin an episode."""

    def act(self, observation: object) -> np.ndarray:
        """Return the one action."""
        return self._action


class Beeline:
    """Straight towards the goal, whatever is between."""

    def __init__(self, context: PolicyContext, speed: float) -> None:
        self._turn_rate, self._speed = context.robot.max_turn_rate, speed

    def reset(self, info: object) -> None:
        """Begin an episode."""

    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """Turn to the goal and drive."""
        bearing = float(observation["goal"][1])
        ahead = self._speed * max(0.0, np.cos(bearing))
        return np.array((ahead, np.clip(2 * bearing / self._turn_rate, -1, 1)), np.float32)


POLICIES: dict[str, Callable[[RobotEnv, PolicyContext], Policy]] = {
    "still": lambda env, context: Constant(0.0, 0.0),
    "spin": lambda env, context: Constant(0.0, 1.0),
    "random": lambda env, context: RandomActions(context),
    "straight": lambda env, context: StraightAhead(context),
    "beeline": lambda env, context: Beeline(context, 1.0),
    "slow beeline": lambda env, context: Beeline(context, 0.4),
    "go_to_goal": lambda env, context: GoToGoal(context),
    "astar": BASELINES["astar"].make,
}


def drive(name: str, task: BenchTask) -> tuple[float, float, str]:
    """Return return, score and reason of the end of an episode."""
    env = make_task_env(task, None, ("scan", "goal"))
    observation, first = env.reset(seed=task.seed, options=reset_options(task))
    policy = POLICIES[name](env, PolicyContext.of(env.episodes.config, task.seed))
    policy.reset(first)
    earned, ended = 0.0, False
    while not ended:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        earned, ended = earned + reward, terminated or truncated
    env.close()
    score = 1.0 if info["success"] else distance_share(info["progress"], first["distance"])
    return earned, score, str(info["reason"])


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, courses=20)
    tasks = task_set("generated").chosen("traverse", "test")[: given.courses]
    rows = []
    for name in track(POLICIES, "policies", transient=True):
        driven = [drive(name, task) for task in tasks]
        reasons = [reason for *_, reason in driven]
        accidents = sum(reason in ("tipped over", "left the world") for reason in reasons)
        earned, score = np.mean([row[:2] for row in driven], axis=0).tolist()
        row = {"policy": name, "mean return": earned, "mean score": score, "goals": reasons.count("success")}
        rows.append(row | {"tipped or left": accidents})
    rows.sort(key=lambda row: row["mean score"])
    print_rows(rows)
    means = {row["policy"]: row["mean return"] for row in rows}
    rank = float(spearmanr(list(means.values()), [row["mean score"] for row in rows]).statistic)
    print(f"Spearman {rank:.3f} over {len(rows)} policies x {len(tasks)} courses")
    sys.exit(rank < LEAST or means["still"] >= min(means["beeline"], means["slow beeline"]))


if __name__ == "__main__":
    main()
