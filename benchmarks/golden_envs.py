"""Golden outcomes of the environments: every observation, reward, end and info of fixed actions."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np

TASKS = ("LIRS/Mapping-v2", "LIRS/Navigation-v1", "LIRS/Traverse-v1")
ROBOTS = ("husky", "jackal", "turtlebot3_burger")
GROUPS = ("scan", "sectors", "body", "odometry", "attitude", "seen_map", "height_map")
GOAL_GROUPS = ("goal", "goal_direction")
COUNT = 3
"""Robots of a vector."""
SEED = 11
SHOWN = 6
"""Size of the largest array that is stored as numbers; a larger one is stored as digest."""
VARIANTS: dict[str, dict[str, Any]] = {
    "actors": {"world": "simple", "actors": 3, "odometry": "ekf", "noise": "datasheet", "sweep": True},
    "flight": {"task": TASKS[0], "world": "simple", "robot": "quadrotor"},
    "random": {"world": "advanced", "randomize": ["friction", "mass", "sensor", "start"], "control_hz": 20.0},
}
"""Options that the tasks and robots alone do not reach, tried with navigation unless they name a task."""


def environment_outcomes(steps: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name and the steps of every environment, single and vector."""
    for task in TASKS:
        every = [*GROUPS, *(() if task == TASKS[0] else GOAL_GROUPS)]
        for robot in ROBOTS:
            name = f"{task.removeprefix('LIRS/')} {robot}"
            # A time limit ends episodes, so that resets are compared as well.
            for kind, options in (("default", {}), ("every group", {"observe": every, "time_limit": 3.0})):
                yield f"{name}, {kind}", single(task, steps, robot=robot, **options)
                yield f"{name}, {kind}, vector", vector(task, steps, robot=robot, **options)
    for name, options in VARIANTS.items():
        given: dict[str, Any] = {"task": TASKS[1]} | options
        title = f"{given['task'].removeprefix('LIRS/')} {name}"
        yield title, single(steps=steps, **given)
        yield f"{title}, vector", vector(steps=steps, autoreset_mode="SameStep", **given)


def single(task: str, steps: int, **options: Any) -> dict[str, Any]:
    """Return the steps of one environment, which is reset where an episode ends."""
    env = gym.make(f"lirs_envs:{task}", disable_env_checker=True, **options)
    observation, info = env.reset(seed=SEED)
    found = {"step 000": outcome(observation, info)}
    for step in range(1, steps + 1):
        action = actions(step, 1, *(env.action_space.shape or ()))[0]
        observation, reward, terminated, truncated, info = env.step(action)
        ends = {"reward": reward, "terminated": terminated, "truncated": truncated}
        found[f"step {step:03d}"] = outcome(observation, info, **ends)
        if terminated or truncated:
            found[f"step {step:03d}, reset"] = outcome(*env.reset())
    env.close()
    return found


def vector(task: str, steps: int, **options: Any) -> dict[str, Any]:
    """Return the steps of a vector of environments."""
    envs = gym.make_vec(
        f"lirs_envs:{task}", num_envs=COUNT, vectorization_mode="vector_entry_point", **options
    )
    shape = envs.action_space.shape or ()
    found = {"step 000": outcome(*envs.reset(seed=SEED))}
    for step in range(1, steps + 1):
        observation, reward, terminated, truncated, info = envs.step(actions(step, *shape))
        ends = {"reward": reward, "terminated": terminated, "truncated": truncated}
        found[f"step {step:03d}"] = outcome(observation, info, **ends)
    envs.close()
    return found


def actions(step: int, count: int, size: int) -> np.ndarray:
    """Return (count, size) actions of a step: mostly ahead, in curves that differ by robot."""
    phase = 0.13 * step + 1.7 * np.arange(count)[:, None] + 0.9 * np.arange(size)
    return np.clip(np.array([0.5] + [0.0] * (size - 1)) + 0.7 * np.sin(phase), -1.0, 1.0).astype(np.float32)


def outcome(observation: dict[str, Any], info: dict[str, Any], **ends: Any) -> dict[str, Any]:
    """Return what a step gave, the smallest values first."""
    found = {name: plain(value) for name, value in ends.items()}
    found |= {f"info.{name}": plain(value) for name, value in info.items()}
    return found | {f"observation.{name}": plain(value) for name, value in observation.items()}


def plain(value: Any) -> Any:
    """Return a value as JSON holds it; of a large array the type, shape and digest."""
    if isinstance(value, dict):
        return {name: plain(item) for name, item in value.items()}
    array = np.asarray(value)
    if array.dtype == object:
        return [None if item is None else plain(item) for item in array.ravel()]
    if array.size <= SHOWN:
        numbers = array.tolist()
        return str(numbers) if array.dtype.kind == "f" and not np.isfinite(array).all() else numbers
    digest = hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()[:12]
    return f"{array.dtype}{list(array.shape)} {digest}"
