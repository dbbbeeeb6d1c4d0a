"""Props and rays as options of environments."""

import json
import pickle
from typing import Any

import gymnasium as gym
import pytest

import lirs_envs  # noqa: F401  registers
from lirs_wct.errors import ConfigError


def test_props_and_rays_are_options_of_plain_json() -> None:
    """A wall of props ahead is seen, by either rays, in a vector as alone."""
    wall = {"shape": "box", "size": [0.1, 2.0, 1.0], "place": [2.0, 0.0, 0.0]}
    options = json.loads(json.dumps({"world": "simple", "props": [wall], "noise": "none"}))
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
    ("options", "message"),
    [
        ({"rays": "x"}, "rays"),
        ({"props": [{"shape": "box"}]}, "a prop must be a mapping of shape, size, place"),
        ({"props": [{"shape": "cone", "size": [1], "place": [0, 0, 0]}]}, "shape of a prop"),
    ],
)
def test_bad_props_and_rays_are_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        gym.make("LIRS/Mapping-v2", **options)
