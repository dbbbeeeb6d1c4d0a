"""Props, rays and illegal arguments of environments."""

import json
import pickle
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import lirs_envs  # noqa: F401  registers
from lirs_envs.env import RobotEnv
from lirs_envs.vector_env import RobotVectorEnv
from lirs_wct.errors import ConfigError
from lirs_wct.world import World
from tests.kit import refused


def test_props_and_rays_are_options_of_plain_json(plane: World) -> None:
    """A wall of props ahead is seen, by either rays, in a vector as alone."""
    wall = {"shape": "box", "size": [0.1, 2.0, 1.0], "place": [2.0, 0.0, 0.0]}
    options = {"world": plane} | json.loads(json.dumps({"props": [wall], "noise": "none"}))
    start = {"start": (0.0, 0.0, 0.0)}
    ranges = []
    for rays in ("builtin", "mujoco"):
        env = gym.make("LIRS/Mapping-v2", rays=rays, **options)
        ranges.append(env.reset(seed=1, options=start)[0]["scan"])
        copy = pickle.loads(pickle.dumps(env.spec))
        assert gym.make(copy).reset(seed=1, options=start)[0]["scan"].tobytes() == ranges[-1].tobytes()
    middle = len(ranges[0]) // 2
    assert 1.0 < ranges[0][middle] < 1.9
    assert ranges[0][middle] == pytest.approx(ranges[1][middle], abs=0.01)
    vector = gym.make_vec("LIRS/Mapping-v2", num_envs=2, vectorization_mode="vector_entry_point", **options)
    assert vector.reset(seed=1, options=start)[0]["scan"][0].tobytes() == ranges[0].tobytes()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"robot": "nobody"}, "unknown robot 'nobody'"),
        ({"observe": ["smell"]}, "unknown group of observations 'smell'; legal: attitude"),
        ({"observe": "scan"}, "observe must be a list"),
        ({"observe": []}, "observe must be a list"),
        ({"control_hz": 2}, r"control_hz of the environment must be within \[5, 50\] Hz, got 2"),
        ({"randomize": ["weather"]}, "unknown name to randomize 'weather'"),
        ({"randomize": {"mass": [2, 1]}}, "needs lowest <= highest"),
        ({"randomize": {"start": [1, 2]}}, "takes no factors"),
        ({"randomize": ["terrain"]}, "is for the task to cross generated terrain"),
        ({"time_limit": 0}, "time_limit of the environment must be above 0 s"),
        ({"colour": 1}, "unexpected keyword argument 'colour'; legal: actors, (autoreset_mode, )?control_hz"),
        ({"robots": 1}, "an unexpected keyword argument 'robots'; legal: .* world; did you mean robot"),
        ({"render_mode": "ascii"}, "unknown render mode 'ascii'"),
        ({"task": "swim"}, "unknown task 'swim'; legal: mapping, navigation, traverse"),
        ({"observe": ["goal"]}, "the mapping task has no goal to observe"),
        ({"observe": ["goal_direction"]}, "the mapping task has no goal to observe"),
        ({"randomize": {"pushes": [-0.1, 1]}}, r"'pushes' needs values from 0 to 2, got \[-0.1, 1\]"),
        ({"randomize": {"pushes": 0.5}}, r"'pushes' needs \(lowest, highest\), got 0.5"),
        ({"randomize": {"latency": [0, 1.5]}}, "'latency' needs values from 0 to 1"),
        ({"randomize": {"latency": [0.2, 0.1]}}, "'latency' needs lowest <= highest"),
        ({"randomize": {"slip": [0, float("nan")]}}, "'slip' needs lowest <= highest, finite"),
        ({"randomize": {"mass": [0, 1]}}, "'mass' needs factors above 0"),
        ({"rays": "x"}, "rays"),
        ({"props": [{"shape": "box"}]}, "a prop must be a mapping of shape, size, place"),
        ({"props": [{"shape": "cone", "size": [1], "place": [0, 0, 0]}]}, "shape of a prop"),
        ({"autoreset_mode": "x"}, "unknown autoreset_mode 'x'; legal: Disabled, NextStep, SameStep"),
        ({"autoreset_mode": 5}, "unknown autoreset_mode '5'; legal"),
        ({"threads": -1}, "threads must be a whole number at least 1, got -1"),
        ({"threads": True}, "threads must be a whole number at least 1, got True"),
        ({"max_episode_steps": 0}, "max_episode_steps must be a whole number at least 1, got 0"),
        ({"difficulty": True}, "difficulty of the environment must be within \\[0, 1\\], got True"),
        ({"difficulty": "hard"}, "difficulty of the environment must be within \\[0, 1\\], got 'hard'"),
        ({"kind": "waves"}, "kind is for the traverse task alone, the task is mapping, got kind 'waves'"),
    ],
)
def test_options(plane: World, options: dict[str, Any], sentence: str) -> None:
    options = {"task": "mapping", "world": plane} | options
    makers: list[Any] = [RobotEnv, partial(RobotVectorEnv, 2)]
    for make in makers[bool(options.keys() & {"autoreset_mode", "threads", "max_episode_steps"}) :]:
        with refused(words=sentence, kind=ConfigError):
            make(**options)


def test_options_of_reset_and_actions(plane: World) -> None:
    one = RobotEnv("navigation", world=plane)
    two = RobotVectorEnv(2, "navigation", world=plane, threads=1)
    for env in (one, two):
        with pytest.raises(ConfigError, match="options of reset must be a mapping or None, got 5"):
            env.reset(seed=0, options=5)  # type: ignore[arg-type]
        with pytest.raises(ConfigError, match=r"a difficulty must be within \[0, 1\], got True"):
            env.reset(seed=0, options={"difficulty": True})
        env.reset(seed=0)
    wrong: list[tuple[Any, str]] = [
        ([[0.1, 0.2], [0.3]], "got rows of different lengths"),
        ([["0.1", "0.2"], ["0.3", "0.4"]], "got"),
        (np.ones((2, 2), np.bool_), "got"),
        ([0.1, 0.2], "got shape"),
        (None, "got shape"),
    ]
    for actions, got in wrong:
        with pytest.raises(ConfigError, match=r"actions must be numbers of shape \(2, 2\), " + got):
            two.step(actions)
    for action in (["0.1", "0.2"], [0.1, [0.2]], [0.1], "ahead", None):
        with pytest.raises(ConfigError, match=r"actions must be numbers of shape \(1, 2\)"):
            one.step(action)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="an action must be finite"):
        one.step(np.array((np.nan, 0.0), np.float32))
