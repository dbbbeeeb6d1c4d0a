"""The environments' render modes: one, and N at once."""

import copy
import multiprocessing
import os
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import lirs_envs  # noqa: F401  registers
from lirs_envs.rendering import PATH
from lirs_wct.errors import ConfigError, SimulationError
from lirs_wct.world import World


def picture(env: Any, in_ci: bool) -> Any:
    try:
        return env.render()
    except SimulationError as error:
        if in_ci:
            raise
        pytest.skip(str(error))


@pytest.mark.render
@pytest.mark.parametrize(("mode", "shape"), [("rgb_array", (480, 640, 3)), ("depth_array", (480, 640))])
def test_cameras(plane: World, mode: str, shape: tuple[int, ...], in_ci: bool) -> None:
    env = gym.make("LIRS/Navigation-v1", world=plane, render_mode=mode)
    env.reset(seed=1)
    shown = picture(env, in_ci)
    assert shown.shape == shape
    for _ in range(5):
        env.step(np.array((1.0, 0.5), np.float32))
    assert not np.array_equal(env.render(), shown)
    env.close()


@pytest.mark.render
@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_a_forked_process_says_that_it_cannot_draw(plane: World, in_ci: bool) -> None:
    env: Any = gym.make("LIRS/Navigation-v1", world=plane, render_mode="rgb_array")
    env.reset(seed=1)
    picture(env, in_ci)
    receiving, sending = multiprocessing.Pipe(duplex=False)

    def draw() -> None:
        env.step(np.zeros(2, np.float32))
        try:
            env.render()
        except SimulationError as error:
            sending.send(str(error))

    child = multiprocessing.get_context("fork").Process(target=draw)
    child.start()
    try:
        assert receiving.poll(60), "the child hangs"
        assert "forked after one was drawn" in receiving.recv()
    finally:
        child.kill()
    assert env.render().shape == (480, 640, 3)


def test_a_map_shows_the_episode_s_path_and_copies_draw_the_same(plane: World) -> None:
    env: Any = gym.make("LIRS/Navigation-v1", world=plane, render_mode="map").unwrapped
    for _ in range(2):
        env.reset(seed=1)
        first = env.render()
        for _ in range(30):
            env.step(np.array((1.0, 0.0), np.float32))
        last = env.render()
        drawn = (np.abs(last.astype(int) - PATH) < 30).all(axis=-1).sum()
        assert drawn > 20 > (np.abs(first.astype(int) - PATH) < 30).all(axis=-1).sum()
    assert np.array_equal(copy.deepcopy(env).render(), env.render())
    env.close()


def test_a_vector_shows_each_environment(plane: World) -> None:
    envs: Any = gym.make_vec(
        "LIRS/Navigation-v1",
        num_envs=3,
        vectorization_mode="vector_entry_point",
        world=plane,
        render_mode="map",
    )
    envs.reset(seed=5)
    shown = envs.render()
    single: Any = gym.make("LIRS/Navigation-v1", world=plane, render_mode="map").unwrapped
    for i in range(3):
        single.reset(seed=5 + i)
        assert np.array_equal(single.render(), shown[i])
    assert not np.array_equal(shown[0], shown[1])
    envs.close()
    with pytest.raises(ConfigError, match="unknown render mode 'human'; legal: rgb_array, depth_array, map"):
        gym.make_vec(
            "LIRS/Mapping-v2",
            num_envs=2,
            vectorization_mode="vector_entry_point",
            world=plane,
            render_mode="human",
        )
