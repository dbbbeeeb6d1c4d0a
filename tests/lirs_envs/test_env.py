"""Every environment keeps Gymnasium's contract, with every robot, and says clearly what it cannot do."""

import copy
import gc
import hashlib
import json
import pickle
import resource
import subprocess
import sys
import weakref
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import (
    FlattenObservation,
    FrameStackObservation,
    NormalizeObservation,
    RecordEpisodeStatistics,
)

import lirs_envs  # noqa: F401  registers
from lirs_envs.env import RobotEnv
from lirs_envs.robots.robot import ROBOTS
from lirs_wct.errors import ConfigError, SimulationError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.world import World

IDS = ("LIRS/Mapping-v2", "LIRS/Navigation-v1", "LIRS/Traverse-v1")
ALL_GROUPS = ["scan", "scans", "odometry", "attitude", "seen_map", "height_map"]


def episode(env: gym.Env[Any, Any], seed: int, steps: int = 30) -> bytes:
    """What an episode of random actions says, as bytes."""
    observation, info = env.reset(seed=seed)
    rng, told = np.random.default_rng(seed), []
    for _ in range(steps):
        told += [v.tobytes() for v in observation.values()]
        told += [repr(sorted((k, repr(v)) for k, v in info.items())).encode()]
        observation, reward, terminated, truncated, info = env.step(
            rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        )
        told.append(repr(reward).encode())
        if terminated or truncated:
            observation, info = env.reset()
    return b"".join(told)


def digest(name: str) -> str:
    return hashlib.sha256(episode(gym.make(name, observe=ALL_GROUPS), 3)).hexdigest()


@pytest.mark.filterwarnings("ignore:.*observation space (minimum|maximum) value is")
@pytest.mark.filterwarnings("ignore:.*Not able to test alternative render modes")
@pytest.mark.parametrize(
    ("name", "robot"),
    [
        pytest.param("LIRS/Mapping-v2", "husky", marks=pytest.mark.slow),
        ("LIRS/Navigation-v1", "turtlebot2"),
        ("LIRS/Mapping-v2", "quadrotor"),
        *(
            pytest.param("LIRS/Traverse-v1", name, marks=[pytest.mark.slow] if name != "jackal" else ())
            for name, robot in sorted(ROBOTS.items())
            if not robot.flies
        ),
    ],
)
def test_check_env(name: str, robot: str) -> None:
    check_env(gym.make(name, robot=robot, world="simple").unwrapped, skip_render_check=True)


@pytest.mark.parametrize("name", IDS)
def test_a_spec_survives_pickle_and_json(name: str) -> None:
    options = {"observe": ["scan", "seen_map"], "randomize": {"friction": [0.5, 1.0]}, "control_hz": 20}
    env = gym.make(name, **options)
    assert env.spec is not None
    assert pickle.loads(pickle.dumps(env.spec)) == env.spec
    assert json.loads(env.spec.to_json())["kwargs"]["control_hz"] == 20
    assert episode(gym.make(EnvSpec.from_json(env.spec.to_json())), 1, 5) == episode(env, 1, 5)


def test_wrappers_of_gymnasium(plane: World) -> None:
    env: Any = RecordEpisodeStatistics(RobotEnv("navigation", world=plane, time_limit=0.5))
    env = NormalizeObservation(FrameStackObservation(FlattenObservation(env), 3))
    env.reset(seed=0)
    total, ended = 0.0, False
    while not ended:
        observation, reward, terminated, truncated, info = env.step(np.array((0.5, 0.1), np.float32))
        total, ended = total + reward, terminated or truncated
    assert np.isfinite(observation).all()
    assert info["episode"]["r"] == pytest.approx(total)


@pytest.mark.slow
def test_a_second_process_says_the_same() -> None:
    program = (
        "import lirs_envs\n"
        "from tests.lirs_envs.test_env import IDS, digest\n"
        "print(*(digest(name) for name in IDS))"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == [digest(name) for name in IDS]


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("name", IDS)
def test_a_copy_in_mid_episode_goes_on_bit_for_bit(name: str, copied: Callable[[Any], Any]) -> None:
    env = gym.make(name, observe=ALL_GROUPS, randomize=None).unwrapped
    episode(env, 1, 7)
    again = copied(env)
    for _ in range(5):
        one, two = (e.step(np.array((0.8, -0.4), np.float32)) for e in (again, env))
        assert [v.tobytes() for v in one[0].values()] == [v.tobytes() for v in two[0].values()]
        assert repr(one[1:]) == repr(two[1:])
    assert again.reset()[0]["scan"].tobytes() == env.reset()[0]["scan"].tobytes()


def test_observations_are_nobody_else_s() -> None:
    env = gym.make("LIRS/Mapping-v2", observe=ALL_GROUPS)
    first, _ = env.reset(seed=0)
    kept = {name: value.copy() for name, value in first.items()}
    env.step(env.action_space.sample())
    for name, value in first.items():
        assert (value == kept[name]).all()


def test_step_before_reset_and_after_the_end(plane: World) -> None:
    env = RobotEnv("mapping", world=plane, time_limit=0.2)
    action = np.zeros(2, np.float32)
    with pytest.raises(SimulationError, match="must be reset before its first step"):
        env.step(action)
    env.reset(seed=0)
    env.step(action)
    *_, terminated, truncated, info = env.step(action)
    assert (terminated, truncated, info["reason"], info["timeout"]) == (False, True, "timeout", True)
    with pytest.raises(SimulationError, match=r"the episode has ended \(timeout\): a reset comes"):
        env.step(action)
    env.reset()
    env.step(action)


@pytest.mark.parametrize(
    ("task", "options", "words"),
    [
        ("mapping", {"strat": 1}, "unknown option of reset 'strat'; legal: start"),
        ("mapping", {"start": [0, 0]}, r"options\['start'\] must be 3 finite numbers"),
        ("navigation", {"goal": [0, float("nan")]}, r"options\['goal'\] must be 2 finite numbers"),
        ("navigation", {"difficulty": 1.5}, r"a difficulty must be within \[0, 1\], got 1.5"),
        ("traverse", {"kind": "lava"}, "unknown kind of terrain 'lava'; legal: craters"),
    ],
)
def test_options_of_reset(plane: World, task: str, options: dict[str, Any], words: str) -> None:
    env = RobotEnv(task, world=plane)
    with pytest.raises(ConfigError, match=words):
        env.reset(options=options)
    env.reset(seed=1)


@pytest.mark.parametrize("action", [np.zeros(3), 0.5, np.zeros((1, 2)), np.array((np.nan, 0.0)), "ahead"])
def test_wrong_actions(plane: World, action: Any) -> None:
    env = RobotEnv("mapping", world=plane)
    env.reset(seed=0)
    with pytest.raises(ConfigError, match=r"(actions must be numbers of shape|an action must be finite)"):
        env.step(action)
    env.step(np.zeros(2))


def test_goals_and_starts_that_cannot_be(rough: World) -> None:
    env = RobotEnv("navigation", world=rough)
    with pytest.raises(SimulationError, match=r"no way leads from .* to the goal \(9\.00, 40\.00\)"):
        env.reset(seed=0, options={"goal": [9, 40]})
    with pytest.raises(SimulationError, match=r"husky cannot start at|no way leads"):
        env.reset(seed=0, options={"start": [14.2, 0, 0], "goal": [0, 0]})
    with pytest.raises(SimulationError, match=r"the start \(14\.90, 0\.00\) is not on free ground"):
        RobotEnv("mapping", world=rough).reset(options={"start": Pose2(14.9, 0.0)})


def test_an_episode_that_diverges_ends_with_a_valid_observation(plane: World) -> None:
    env = RobotEnv("navigation", world=plane, observe=[*ALL_GROUPS, "goal"])
    env.reset(seed=0)
    env.step(np.zeros(2, np.float32))
    env.episodes.simulation.states[0].qvel[0] = np.inf
    observation, reward, terminated, truncated, info = env.step(np.zeros(2, np.float32))
    assert env.observation_space.contains(observation)
    assert np.isfinite(reward)
    assert (terminated, truncated) == (True, False)
    assert info["error"].startswith("the simulation diverged")
    env.reset()
    assert "error" not in env.step(np.zeros(2, np.float32))[-1]


@pytest.mark.parametrize("make", [gym.make, partial(gym.make_vec, num_envs=2)])
def test_an_unknown_keyword_is_a_type_error(make: Any, plane: World) -> None:
    """Programs that try a keyword rely on it."""
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'; legal: actors"):
        make("LIRS/Mapping-v2", world=plane, frameskip=4)


@pytest.mark.parametrize(
    ("made", "options", "steps"),
    [
        ({}, {}, 1200),
        ({}, {"time_limit": 2.0, "control_hz": 5}, 10),
        ({"max_episode_steps": 3}, {}, 3),
        ({"max_episode_steps": 3}, {"time_limit": 0.2}, 2),
        ({"max_episode_steps": 2000}, {}, 2000),
    ],
)
def test_a_limit_of_steps_is_told(
    made: dict[str, Any], options: dict[str, Any], steps: int, plane: World
) -> None:
    """Single and vector name a timeout, and wrappers of Gymnasium find the limit in the specification."""
    single = gym.make("LIRS/Mapping-v2", world=plane, **made, **options)
    vector = gym.make_vec("LIRS/Mapping-v2", num_envs=1, world=plane, **made, **options)
    single.reset(seed=0)
    vector.reset(seed=0)
    for one in (single, vector):
        assert one.unwrapped.episodes.max_steps == steps  # type: ignore[attr-defined]
    assert vector.spec.max_episode_steps == steps
    assert single.spec.max_episode_steps == made.get("max_episode_steps", steps)
    for step in range(1, min(steps, 10) + 1):
        *_, terminated, truncated, info = single.step(np.zeros(2, np.float32))
        *_, truncations, infos = vector.step(np.zeros((1, 2)))
        assert truncated == truncations[0] == (step == steps)
        assert (info["timeout"], info["reason"]) == (truncated, "timeout" if truncated else "")
        assert (infos["timeout"][0], infos["reason"][0]) == (info["timeout"], info["reason"])
        assert not terminated


def test_a_reset_keeps_nothing_of_its_callers_alive(plane: World) -> None:
    env = gym.make("LIRS/Mapping-v2", world=plane, max_episode_steps=3)
    env.reset(seed=0)
    gone = weakref.ref(env)
    del env
    gc.collect()
    assert gone() is None


def test_randomization_changes_what_it_names(rough: World) -> None:
    def model_of(randomize: Any, seed: int) -> tuple[float, float, float]:
        env = RobotEnv("mapping", world=rough, randomize=randomize)
        env.reset(seed=seed)
        simulation = env.episodes.simulation
        model = simulation.groups[0].bodies.models[0]
        base = model.body("base_link")
        friction = float(model.geom("front_left_wheel").friction[0])
        return friction, float(base.subtreemass[0]), simulation.lidar_noise[0].sigma

    nominal = model_of(["start"], 0)
    assert model_of(["start"], 1) == nominal
    for k, name in enumerate(("friction", "mass", "sensor")):
        drawn = {model_of({"start": None, name: [0.5, 0.9]}, seed) for seed in range(4)}
        assert len({d[k] for d in drawn}) == 4
        for values in drawn:
            for j in range(3):
                share = values[j] / nominal[j]
                assert 0.5 <= share <= 0.9 if j == k else share == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads the memory from /proc")
@pytest.mark.parametrize("name", ["LIRS/Mapping-v2", "LIRS/Traverse-v1"])
def test_memory_does_not_grow(name: str) -> None:
    """Episodes keep no records: 60 resets and 800 steps, of which a leak of 25 kB a reset would show."""

    def megabytes() -> float:
        gc.collect()
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6

    env = gym.make(name, time_limit=5.0)
    env.reset(seed=0)

    def run(resets: int, steps: int) -> None:
        for _ in range(resets):
            env.reset()
        for _ in range(steps):
            *_, terminated, truncated, _ = env.step(np.array((0.5, 0.1), np.float32))
            if terminated or truncated:
                env.reset()

    run(20, 200)
    before = megabytes()
    run(60, 800)
    assert megabytes() - before < 1.5
