"""Episodes: what a policy does wrong costs its own episode, what it is worth is what was driven."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_extensions.bench.episode import SPENT, episode_metrics, make_task_env, run_episode
from lirs_extensions.bench.policies import PolicyChoice
from lirs_extensions.bench.tasks import BenchTask, WorldSpec
from lirs_wct.errors import ConfigError

PLAN = WorldSpec(name="plan", maker="floor plan", options=(("seed", 0),))
THERE = BenchTask(
    name="there",
    task="navigation",
    split="test",
    robot="jackal",
    seed=5,
    time_limit=60.0,
    world=PLAN,
    start=(-2.0, -6.0, 0.0),
    goal=(4.5, -6.5),
)
AROUND = BenchTask(
    name="around",
    task="mapping",
    split="test",
    robot="jackal",
    seed=5,
    time_limit=20.0,
    world=PLAN,
    start=(-6.0, -5.0, 0.0),
    path_budget=5.0,
)
ACROSS = BenchTask(
    name="across",
    task="traverse",
    split="test",
    robot="husky",
    seed=1,
    time_limit=3.0,
    course="waves",
    difficulty=0.0,
)
MODULE = '''
"""Policies of a user."""

import sys
import numpy as np

class Ahead:
    observe = ("scan", "goal")
    def __init__(self, action_space, seed, speed="1"):
        self.action = np.array([float(speed), 0.0], np.float32)
        self.steps, self.seed = 0, seed
    def reset(self, info):
        assert info["time"] == 0
    def act(self, observation):
        assert set(observation) == {"scan", "goal"}
        self.steps += 1
        return self.act_now()
    def act_now(self):
        return self.action

class Raises(Ahead):
    def act_now(self):
        if self.steps == 4:
            raise IndexError("list index\\nout of range")
        return self.action

class Exits(Ahead):
    def act_now(self):
        sys.exit(7)

class Short(Ahead):
    def act_now(self):
        return np.zeros(1)

class Endless(Ahead):
    def act_now(self):
        return [np.nan, 0.0]

class Silent(Ahead):
    def act_now(self):
        return None

class BadReset(Ahead):
    def reset(self, info):
        raise KeyError("weights")

class Mute:
    def act(self, observation): ...

class Unmade:
    def __init__(self):
        raise OSError("no weights")
    def reset(self, info): ...
    def act(self, observation): ...

class Blind(Ahead):
    observe = "scan"

def factory(context):
    assert context.robot.name == "jackal"
    return Ahead(None, 0)

factory.observe = Ahead.observe
'''


@pytest.fixture
def _theirs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "their_policies.py").write_text(MODULE)
    monkeypatch.delitem(__import__("sys").modules, "their_policies", raising=False)


def run(task: BenchTask, name: str, **arguments: str) -> tuple[Any, dict[str, Any]]:
    log = run_episode(task, PolicyChoice(name, tuple(arguments.items())))
    return log, episode_metrics(task, log)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("Raises", "act(observation) raised IndexError: list index out of range"),
        ("Exits", "act(observation) raised SystemExit: 7"),
        ("Short", "act(observation) must return 2 finite numbers in [-1, 1], got array([0.])"),
        ("Endless", "act(observation) must return 2 finite numbers in [-1, 1], got [nan, 0.0]"),
        ("Silent", "act(observation) must return 2 finite numbers in [-1, 1], got None"),
        ("BadReset", "reset(info) raised KeyError: 'weights'"),
        ("Mute", "policy 'their_policies:Mute': lacks reset(); a policy has reset(), act()"),
        ("Unmade", "policy 'their_policies:Unmade': cannot be made: OSError: no weights"),
    ],
)
@pytest.mark.usefixtures("_theirs")
def test_what_a_policy_does_wrong_ends_its_episode_with_score_0(name: str, reason: str) -> None:
    log, metrics = run(THERE, f"their_policies:{name}")
    assert log.reason == reason
    assert log.trace.startswith("Traceback")
    assert metrics["score"] == 0.0
    assert len(log.poses) == (4 if name == "Raises" else 1)


@pytest.mark.usefixtures("_theirs")
def test_a_policy_gets_what_it_takes() -> None:
    slow, _ = run(THERE, "their_policies:Ahead", speed="0.1")
    fast, _ = run(THERE, "their_policies:factory")
    assert slow.trace == fast.trace == ""
    assert slow.driven[20] < 0.3 * fast.driven[20]
    with pytest.raises(ConfigError, match="takes no parameter 'sped'; it takes action_space, seed, speed"):
        PolicyChoice("their_policies:Ahead", (("sped", "1"),)).make(make_task_env(THERE, None, None), THERE)
    with pytest.raises(ConfigError, match="observe must be a list of groups, got 'scan'"):
        _ = PolicyChoice("their_policies:Blind").observe


def test_the_upper_bound_and_the_explorer_reach_a_goal_in_another_room() -> None:
    for name in ("astar", "frontier"):
        log, metrics = run(THERE, name)
        assert log.reason == "success", name
        assert metrics["score"] == pytest.approx(
            min(1.0, metrics["shortest_path"] / metrics["path_length"]), abs=1e-9
        )
        assert metrics["score"] > 0.8, name


def test_mapping_ends_when_its_way_is_driven_and_earns_what_was_newly_seen() -> None:
    log, metrics = run(AROUND, "astar")
    assert log.reason == SPENT
    assert AROUND.path_budget is not None
    assert AROUND.path_budget <= metrics["path_length"] < AROUND.path_budget + 0.3
    assert metrics["first_coverage"] < metrics["coverage"] < 0.95
    first = metrics["first_coverage"]
    assert 0.0 < metrics["score"] < (metrics["coverage"] - first) / (0.95 - first)


def test_traverse_earns_its_share_of_the_distance() -> None:
    log, metrics = run(ACROSS, "straight")
    assert log.reason == "timeout"
    start, end = log.poses[0], log.poses[-1]
    assert metrics["progress"] == pytest.approx(math.hypot(*(end - start)[:2]), abs=0.3)
    assert metrics["score"] == pytest.approx(metrics["progress"] / metrics["distance"])


def test_an_episode_is_the_same_each_time() -> None:
    first, second = (run(THERE, "random")[0] for _ in range(2))
    assert np.array_equal(np.array(first.poses), np.array(second.poses))
