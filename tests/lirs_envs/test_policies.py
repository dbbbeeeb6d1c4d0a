"""The policies without learning: what they answer to what they see, and that they arrive."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import lirs_envs  # noqa: F401  registers
from lirs_envs.episodes.config import EnvConfig
from lirs_envs.policies import BACK_OFF, PATIENCE, GoToGoal, PolicyContext, StraightAhead

CONTEXT = PolicyContext.of(EnvConfig())
Array = np.ndarray[Any, np.dtype[Any]]


def scan_of(walls: Any = ()) -> Array:
    """Ranges of the Husky's lidar to discs (x, y, radius) in the laser's frame."""
    lidar = CONTEXT.lidar
    angles = lidar.angle_min + lidar.angle_increment * np.arange(lidar.beams)
    ranges = np.full(lidar.beams, lidar.range_max)
    for x, y, radius in walls:
        along = x * np.cos(angles) + y * np.sin(angles)
        inside = radius**2 - (x * np.sin(angles) - y * np.cos(angles)) ** 2
        met = (inside > 0) & (along > 0)
        ranges[met] = np.minimum(ranges[met], along[met] - np.sqrt(inside[met]))
    return ranges.astype(np.float32)


def answer(bearing: float, walls: Any = (), distance: float = 10.0) -> tuple[float, float]:
    policy = GoToGoal(CONTEXT)
    policy.reset({})
    ahead, turn = policy.act({"scan": scan_of(walls), "goal": np.array((distance, bearing))}).tolist()
    return ahead, turn


def test_on_open_ground_it_turns_to_the_goal_and_drives_at_full_speed() -> None:
    assert answer(0.0) == pytest.approx((1.0, 0.0), abs=0.05)
    for side in (-1, 1):
        ahead, turn = answer(side * 1.0)
        assert turn * side > 0.5
        assert ahead < 0.5


def test_it_goes_around_what_stands_in_its_way() -> None:
    ahead, turn = answer(0.0, [(2.0, 0.3, 0.5)])
    assert turn < -0.2
    assert ahead < 1.0
    assert answer(0.0, [(2.0, -0.3, 0.5)])[1] > 0.2
    # Beside the way, or behind the goal, it counts for nothing.
    assert answer(0.0, [(3.0, 2.5, 0.5)]) == pytest.approx((1.0, 0.0), abs=0.05)
    assert answer(0.0, [(3.5, 0.0, 0.5)], distance=1.5)[0] == pytest.approx(1.0, abs=0.05)


def test_without_progress_it_backs_off_for_a_while() -> None:
    policy = GoToGoal(CONTEXT)
    policy.reset({})
    seen = {"scan": scan_of(), "goal": np.array((5.0, 0.0))}
    speeds = [float(policy.act(seen)[0]) for _ in range(round((PATIENCE + 2 * BACK_OFF) / CONTEXT.period))]
    back = np.flatnonzero(np.array(speeds) < 0)
    assert back[0] * CONTEXT.period == pytest.approx(PATIENCE, abs=0.3)
    assert len(back) * CONTEXT.period == pytest.approx(BACK_OFF, abs=0.2)
    assert speeds[-1] > 0


@pytest.mark.parametrize(
    ("robot", "world"), [pytest.param("husky", "medium", marks=pytest.mark.slow), ("jackal", "simple")]
)
def test_it_reaches_goals_where_straight_ahead_does_not(robot: str, world: str) -> None:
    env: Any = gym.make("LIRS/Navigation-v1", world=world, robot=robot, difficulty=0.3).unwrapped
    successes = {GoToGoal: 0, StraightAhead: 0}
    for policy in successes:
        for seed in range(3):
            driver = policy(PolicyContext.of(env.episodes.config, seed))
            observation, info = env.reset(seed=seed)
            driver.reset(info)
            ended = False
            while not ended:
                observation, _, terminated, truncated, info = env.step(driver.act(observation))
                ended = terminated or truncated
            successes[policy] += bool(info["success"])
    assert successes[GoToGoal] == 3
    assert successes[StraightAhead] < 2
