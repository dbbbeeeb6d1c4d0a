"""Reasons for the ends of episodes of a learner: navigation in four worlds that are not trained on.

    python benchmarks/episode_ends.py [--episodes 200] [--seed 0]

Random actions are those of a learner that begins; `go_to_goal` with random actions in a third of the seconds
is one that explores. The worlds are of the benchmark's split `validation`.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from benchmarks.steps import arguments
from lirs_envs.policies import GoToGoal, PolicyContext, RandomActions
from lirs_envs.vector_env import RobotVectorEnv
from lirs_extensions.bench.tasks import task_set

WORLDS = (("lirs", "medium"), ("hills", "hills-10"), ("hills", "dunes-11"), ("hills", "boulders-12"))
"""Set and name of each world."""
ROBOTS, ROBOT, TIME_LIMIT, EXPLORE = 16, "husky", 60.0, 1 / 3


def main() -> None:
    """Print the share of each reason."""
    given = arguments(__doc__, episodes=200, seed=0)
    named = {
        (name, t.world.name): t.world for name in ("lirs", "hills") for t in task_set(name).tasks if t.world
    }
    worlds = [named[place].world(None) for place in WORLDS]
    for explore in (1.0, EXPLORE):
        envs = RobotVectorEnv(
            ROBOTS, "navigation", autoreset_mode="SameStep", world=worlds, robot=ROBOT,
            observe=("scan", "goal"), time_limit=TIME_LIMIT,
        )  # fmt: skip
        ends = count_ends(envs, explore, given.episodes, np.random.default_rng(given.seed))
        envs.close()
        count = sum(ends.values())
        shares = ", ".join(f"{reason} {n} ({100 * n / count:.1f} %)" for reason, n in ends.most_common())
        print(f"random in {100 * explore:.0f} % of the seconds, {count} episodes: {shares}", flush=True)


def count_ends(envs: RobotVectorEnv, explore: float, least: int, rng: np.random.Generator) -> Counter[str]:
    """Run episodes until a number have ended; return the reasons.

    All rows run the same number of steps; episodes that have not ended do not count.
    """
    context = PolicyContext.of(envs.episodes.config)
    drivers = [GoToGoal(context) for _ in range(ROBOTS)]
    wild = [RandomActions(PolicyContext.of(envs.episodes.config, int(rng.integers(2**31)))) for _ in drivers]
    observed, _ = envs.reset(seed=int(rng.integers(2**31)))
    ends: Counter[str] = Counter()
    random, step = np.ones(ROBOTS, np.bool_), 0
    while sum(ends.values()) < least:
        if step % round(1 / context.period) == 0:
            random = rng.random(ROBOTS) < explore
        rows = [{name: values[i] for name, values in observed.items()} for i in range(ROBOTS)]
        actions = [(wild if random[i] else drivers)[i].act(row) for i, row in enumerate(rows)]
        observed, _, terminated, truncated, infos = envs.step(np.array(actions))
        for i in np.flatnonzero(terminated | truncated).tolist():
            ends[str(infos["final_info"]["reason"][i]) or "time"] += 1
            drivers[i].reset({})
        step += 1
    return ends


if __name__ == "__main__":
    main()
