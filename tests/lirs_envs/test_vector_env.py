"""N environments as one: the same to the bit as N single ones, at any number of threads."""

import copy
import multiprocessing
import os
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as wrappers

import lirs_envs  # noqa: F401  registers
from lirs_envs.env import RobotEnv
from lirs_envs.vector_env import RobotVectorEnv
from lirs_wct.errors import ConfigError, SimulationError
from lirs_wct.geometry.pose import Pose3
from lirs_wct.world import World

IDS = ("LIRS/Mapping-v2", "LIRS/Navigation-v1", "LIRS/Traverse-v1")
N = 3


def assert_same(a: Any, b: Any, where: str = "") -> None:
    """Check that two results are equal in keys, types and every byte."""
    if isinstance(a, dict):
        assert a.keys() == b.keys(), (where, a.keys() ^ b.keys())
        for key in a:
            assert_same(a[key], b[key], f"{where}/{key}")
    elif isinstance(a, np.ndarray) and a.dtype == object:
        for one, two in zip(a, b, strict=True):
            assert_same(one, two, where)
    else:
        a, b = np.asarray(a), np.asarray(b)
        assert a.dtype == b.dtype, (where, a.dtype, b.dtype)
        assert np.array_equal(a, b), (where, a, b)


def assert_alike(one: RobotVectorEnv, many: SyncVectorEnv) -> None:
    """Check that two vectors say the same over a reset and some steps."""
    assert_same(dict(enumerate(one.reset(seed=4))), dict(enumerate(many.reset(seed=4))))
    for row in actions(12):
        assert_same(dict(enumerate(one.step(row))), dict(enumerate(many.step(row))))


def options_of(name: str) -> dict[str, Any]:
    drawn = "terrain" if "Traverse" in name else "start"
    goal = [] if "Mapping" in name else ["goal"]
    return {
        "observe": ["scan", "odometry", "attitude", "seen_map", "height_map", *goal],
        "randomize": ["friction", "mass", "sensor", "pushes", "latency", "slip", drawn],
        "time_limit": 0.5,
    }


def actions(steps: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (steps, N, 2)).astype(np.float32)


@pytest.mark.parametrize(("mode", "threads"), [("NextStep", 1), ("SameStep", 3)])
@pytest.mark.parametrize("name", IDS)
def test_equal_to_single_environments(name: str, mode: str, threads: int) -> None:
    options = options_of(name)
    one = gym.make_vec(
        name,
        num_envs=N,
        vectorization_mode="vector_entry_point",
        autoreset_mode=mode,
        threads=threads,
        **options,
    )
    many = SyncVectorEnv([lambda: gym.make(name, **options) for _ in range(N)], autoreset_mode=mode)
    assert one.metadata["autoreset_mode"] == AutoresetMode(mode)
    assert one.observation_space == many.observation_space
    assert_alike(one, many)
    one.close()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_several_worlds_are_equal_to_single_environments(mode: str, plane: World) -> None:
    worlds, task = [plane, "simple"], "navigation"
    options = {"observe": ["scan", "scans", "goal"], "time_limit": 1.0, "robot": "jackal"}
    one = RobotVectorEnv(N, task, autoreset_mode=mode, threads=2, world=worlds, **options)
    singles = [partial(RobotEnv, task, world=w, **options) for w in (plane, plane, "simple")]
    many = SyncVectorEnv(singles, autoreset_mode=mode)  # environment i is in world i * 2 // 3
    assert_alike(one, many)
    assert [world.name for world in one.get_attr("world")] == [plane.name, plane.name, "simple"]
    one.close()


@pytest.mark.parametrize("name", IDS)
def test_disabled_autoreset_resets_those_in_the_mask(name: str) -> None:
    options = options_of(name)
    one = RobotVectorEnv(N, **gym.spec(name).kwargs, autoreset_mode="Disabled", threads=2, **options)
    many = SyncVectorEnv([lambda: gym.make(name, **options) for _ in range(N)], autoreset_mode="Disabled")
    one.reset(seed=0)
    many.reset(seed=0)
    for row in actions(5):
        stepped = one.step(row)
        assert_same(stepped[0], many.step(row)[0])
    assert stepped[3].all()
    with pytest.raises(SimulationError, match=r"the episode has ended \(timeout\)"):
        one.step(row)
    mask = np.array((True, False, True))
    for a, b in zip(
        one.reset(seed=[7, None, 9], options={"reset_mask": mask}),
        many.reset(seed=[7, None, 9], options={"reset_mask": mask.copy()}),
        strict=True,
    ):
        assert_same(a, b)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_a_forked_process_goes_on_and_ends() -> None:
    """A child of a process with threads steps, copies and closes like its parent."""
    env, told = RobotVectorEnv(9, "navigation", world="simple", threads=3), np.full((9, 2), 0.5)
    env.reset(seed=0)
    env.step(told)
    receiving, sending = multiprocessing.Pipe(duplex=False)

    def go_on(env: Any) -> None:
        scans = [one.step(told)[0]["scan"].tobytes() for one in (copy.deepcopy(env), env)]
        env.close()
        env.close()
        scans.append(env.step(told)[0]["scan"].tobytes())
        sending.send(scans)

    child = multiprocessing.get_context("fork").Process(target=go_on, args=(env,))
    child.start()
    try:
        assert receiving.poll(60), "the child hangs"
        first, again, second = receiving.recv()
        child.join(60)
        assert child.exitcode == 0
    finally:
        child.kill()
    expected = [env.step(told)[0]["scan"].tobytes() for _ in range(2)]
    assert [first, again, second] == [expected[0], *expected]


def test_call_get_attr_set_attr() -> None:
    env = RobotVectorEnv(N, "traverse", kind="steps", difficulty=0.2, threads=1)
    env.reset(seed=0)
    assert env.get_attr("difficulty") == (0.2,) * N
    env.set_attr("difficulty", [0.0, 0.5, 1.0])
    _, infos = env.reset()
    assert infos["difficulty"].tolist() == [0.0, 0.5, 1.0]
    assert infos["kind"].tolist() == ["steps"] * N
    env.set_attr("difficulty", 0.3)
    assert env.get_attr("difficulty") == (0.3,) * N
    readings = env.call("reading")
    assert len({repr(r.imu) for r in readings}) == N
    assert all(isinstance(T, Pose3) for T in env.get_attr("T_world_base"))
    with pytest.raises(AttributeError):
        env.set_attr("color", 1)
    with pytest.raises(ConfigError, match="set_attr needs 3 values"):
        env.set_attr("difficulty", [0.1])


def test_one_that_diverges_is_reset_alone(plane: World) -> None:
    env = RobotVectorEnv(N, "mapping", world=plane, threads=2)
    env.reset(seed=0)
    part, k = env.episodes.places[1]
    part.simulation.states[k].qvel[0] = np.nan
    observation, _, terminated, _, infos = env.step(np.zeros((N, 2)))
    assert terminated.tolist() == [False, True, False]
    assert infos["_error"].tolist() == [False, True, False]
    assert infos["error"][1].startswith("the simulation diverged")
    assert env.observation_space.contains(observation)
    *_, terminated, _, infos = env.step(np.zeros((N, 2)))
    assert not terminated.any()
    assert "error" not in infos


def test_what_cannot_be(plane: World) -> None:
    with pytest.raises(ConfigError, match="num_envs must be a whole number at least 1"):
        RobotVectorEnv(0, "mapping", world=plane)
    env = RobotVectorEnv(2, "mapping", world=plane, threads=1)
    with pytest.raises(SimulationError, match="must be reset before"):
        env.step(np.zeros((2, 2)))
    with pytest.raises(ConfigError, match="2 environments need as many seeds, got 3"):
        env.reset(seed=[1, 2, 3])
    with pytest.raises(ConfigError, match="reset_mask must be a bool array"):
        env.reset(options={"reset_mask": np.zeros(2, np.bool_)})


def test_vector_wrappers() -> None:
    """Wrappers of vectors, one on the other: returns of episodes, flat and normalized readings."""
    envs: Any = gym.make_vec(
        "LIRS/Navigation-v1",
        num_envs=3,
        vectorization_mode="vector_entry_point",
        world="simple",
        time_limit=0.5,
    )
    envs = wrappers.RecordEpisodeStatistics(envs)
    envs = wrappers.NormalizeObservation(wrappers.FlattenObservation(envs))
    observation, _ = envs.reset(seed=0)
    total = np.zeros(3)
    for _ in range(5):
        observation, rewards, terminated, truncated, infos = envs.step(np.full((3, 2), 0.3, np.float32))
        total += rewards
    assert observation.shape == envs.observation_space.shape
    assert np.isfinite(observation).all()
    assert (terminated | truncated).all()
    assert infos["episode"]["r"] == pytest.approx(total)
    assert infos["episode"]["l"].tolist() == [5, 5, 5]
