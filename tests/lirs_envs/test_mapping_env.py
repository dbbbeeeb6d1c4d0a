"""LIRS/Mapping-v0 keeps Gymnasium's contract and says what it means."""

from __future__ import annotations

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

import lirs_envs  # noqa: F401  registers
from lirs_envs.coverage import CoverageGrid
from lirs_envs.episodes.config import EnvConfig
from lirs_envs.mapping_env import MappingEnv
from lirs_envs.sensing.ekf import EkfOdometry
from lirs_envs.simulation import Simulation
from lirs_wct.errors import ConfigError, SimulationError, SourceError
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import LaserScan
from lirs_wct.world import World


@pytest.mark.filterwarnings("ignore:.*observation space (minimum|maximum) value is")
def test_check_env() -> None:
    check_env(gym.make("LIRS/Mapping-v0").unwrapped, skip_render_check=True)


def test_spec_survives_pickle_and_json() -> None:
    env = gym.make("LIRS/Mapping-v0", world="simple", robot="husky")
    spec = env.spec
    assert spec is not None
    assert pickle.loads(pickle.dumps(spec)) == spec
    again = gym.make(EnvSpec.from_json(spec.to_json()))
    assert again.observation_space == env.observation_space
    assert again.spec is not None
    assert again.spec.max_episode_steps == 3000


def test_same_seed_same_episode(plane: World) -> None:
    runs = []
    for _ in range(2):
        env = MappingEnv(plane)
        observation, _ = env.reset(seed=5)
        bytes_ = [observation["scan"].tobytes()]
        for _ in range(10):
            observation, reward, *_ = env.step(np.array((0.7, 0.3), np.float32))
            bytes_ += [observation[k].tobytes() for k in ("scan", "odometry", "attitude")] + [repr(reward)]
        runs.append(bytes_)
    assert runs[0] == runs[1]


def test_the_husky_keeps_the_step_of_the_environments_version(plane: World) -> None:
    for config in (MappingEnv(plane).simulation.config, EnvConfig(world=plane).simulation):
        body = Simulation(plane, config).body
        assert body.timestep == 0.004
        assert (body.model.actuator_gainprm[:, 0] == 200).all()
        assert body.substeps == (2,) * 5


def test_action_is_a_share_of_the_limits(plane: World) -> None:
    env = MappingEnv(plane)
    env.reset(seed=0)
    for _ in range(50):
        env.step(np.array((0.5, 0.0), np.float32))
    assert np.hypot(*env.simulation.body.data.qvel[:2]) == pytest.approx(0.5, rel=0.05)


def test_scan_is_finite_where_nothing_is_in_range(plane: World) -> None:
    env = MappingEnv(plane)
    observation, _ = env.reset(seed=0)
    scan = observation["scan"]
    assert scan.dtype == np.float32
    assert env.observation_space.contains(observation)
    # A level scan over a plane meets nothing.
    assert (scan == np.float32(20.0)).all()


def test_step_before_reset(plane: World) -> None:
    with pytest.raises(SimulationError, match="must be reset before its first step"):
        MappingEnv(plane).step(np.zeros(2, np.float32))


def test_terminates_off_the_world(plane: World) -> None:
    env = MappingEnv(plane)
    env.reset(seed=0, options={"start": Pose2(9.3, 0.0, 0.0)})
    for _ in range(60):
        *_, terminated, truncated, info = env.step(np.array((1.0, 0.0), np.float32))
        if terminated:
            break
    assert terminated is True
    assert truncated is False
    assert info["reason"] == "left the world"


def test_reward_is_the_new_area(rough: World) -> None:
    env = MappingEnv(rough)
    _, first = env.reset(seed=1)
    total = 0.0
    for _ in range(100):
        _, reward, *_, info = env.step(np.array((0.8, 0.5), np.float32))
        assert reward >= 0
        total += reward
    assert total > 0
    assert info["seen_area"] == pytest.approx(first["seen_area"] + total)


def test_seen_area_of_a_known_scan() -> None:
    seen = CoverageGrid(HeightField.centered(np.zeros((2, 2), np.float32), (10.0, 10.0)), resolution=0.5)
    ranges = np.array((2.1, np.inf, -np.inf, np.nan), np.float32)
    scan = LaserScan(ranges, 0.0, np.pi / 2, 0.1, 3.1, 0.0)
    # East 2.1 m: cells at 0, .5, 1, 1.5, 2; north without return 3.1 m: seven, the first of them shared.
    area = seen.add(scan, Pose3(0.1, 0.1, 0.5))
    assert area == pytest.approx((5 + 7 - 1) * 0.25)
    assert seen.add(scan, Pose3(0.1, 0.1, 0.5)) == 0.0
    assert seen.area == area


def test_bad_arguments(plane: World) -> None:
    with pytest.raises(ConfigError, match="unknown robot 'nobody'; legal:"):
        gym.make("LIRS/Mapping-v0", robot="nobody")
    with pytest.raises(SourceError, match=r"nowhere\.png"):
        gym.make("LIRS/Mapping-v0", world="nowhere.png")
    with pytest.raises(ConfigError, match="unknown render mode 'ascii'"):
        MappingEnv(plane, render_mode="ascii")


def test_sensors_are_chosen_by_name(rough: World) -> None:
    """Also through a spec, which holds plain words only."""
    env = gym.make("LIRS/Mapping-v0", odometry="ekf", noise="none", sweep=True)
    assert env.spec is not None
    sim = gym.make(EnvSpec.from_json(env.spec.to_json())).unwrapped.simulation
    assert isinstance(sim._sensors._motion.odometry, EkfOdometry)
    assert sim.reset().scan.time_increment > 0
    first = [MappingEnv(rough, noise="none").reset(seed=s)[0]["scan"].tobytes() for s in (1, 2)]
    assert first[0] == first[1], "one start pose, no noise"
    for wrong, words in (
        ({"odometry": "magic"}, r"unknown odometry method 'magic'; legal: ekf, gyro"),
        ({"noise": "much"}, r"unknown lidar noise 'much'; legal: datasheet, none, simulated"),
        ({"rays": "x"}, r"unknown rays 'x'; legal: builtin, mujoco"),
    ):
        with pytest.raises(ConfigError, match=words):
            MappingEnv(rough, **wrong)


@pytest.mark.render
def test_picture_shows_the_robot(plane: World, in_ci: bool) -> None:
    env = MappingEnv(plane, render_mode="rgb_array")
    env.reset(seed=0)
    try:
        picture = env.render()
    except SimulationError as error:
        if in_ci:
            raise
        pytest.skip(str(error))
    assert picture is not None
    assert picture.shape == (480, 640, 3)
    yellow = (picture[..., 0] > 120) & (picture[..., 2] < 0.45 * picture[..., 0])
    assert 0.005 < yellow.mean() < 0.5
    env.close()
