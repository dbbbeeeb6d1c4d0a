"""The adapter to Stable-Baselines3: against its interface, and against itself where it is installed."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.classic_control import CartPoleEnv
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics

from lirs_envs.env import RobotEnv
from lirs_envs.robots.robot import ROBOTS
from lirs_envs.sb3 import _RobotVecEnv, as_vec_env
from lirs_envs.vector_env import RobotVectorEnv
from lirs_envs.wrappers import Curriculum
from lirs_wct.errors import ConfigError
from lirs_wct.world import World

REASON = "Stable-Baselines3 is not installed (extra [rl])"
EVERYTHING = [
    "scan",
    "scans",
    "sectors",
    "body",
    "odometry",
    "attitude",
    "goal",
    "goal_direction",
    "seen_map",
    "height_map",
]


class VecEnvInterface:
    """What the adapter uses of Stable-Baselines3's `VecEnv`, version 2."""

    def __init__(self, num_envs: int, observation_space: Any, action_space: Any) -> None:
        self.num_envs, self.observation_space, self.action_space = num_envs, observation_space, action_space
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(num_envs)]
        self._seeds: list[int | None] = [None] * num_envs
        self._options: list[dict[str, Any]] = [{} for _ in range(num_envs)]
        self.render_mode = self.get_attr("render_mode")[0]  # type: ignore[attr-defined]

    def _get_indices(self, indices: Any) -> Any:
        return range(self.num_envs) if indices is None else [indices] if isinstance(indices, int) else indices

    def seed(self, seed: int) -> list[int | None]:
        self._seeds = [seed + i for i in range(self.num_envs)]
        return self._seeds

    def _reset_seeds(self) -> None:
        self._seeds = [None] * self.num_envs

    def _reset_options(self) -> None:
        self._options = [{} for _ in range(self.num_envs)]

    def step(self, actions: Any) -> Any:
        self.step_async(actions)  # type: ignore[attr-defined]
        return self.step_wait()  # type: ignore[attr-defined]


class Adapted(_RobotVecEnv, VecEnvInterface):
    """The adapter on the interface."""


def vector(count: int = 3, **options: Any) -> RobotVectorEnv:
    given = {"world": "simple", "time_limit": 0.5, "autoreset_mode": "SameStep"} | options
    return RobotVectorEnv(count, "navigation", threads=1, **given)


def same(one: Any, two: Any) -> bool:
    """Whether two observations or infos hold the same, bit for bit."""
    if isinstance(one, dict):
        return one.keys() == two.keys() and all(same(value, two[name]) for name, value in one.items())
    return np.asarray(one).tolist() == np.asarray(two).tolist()


def test_steps_are_those_of_the_vector() -> None:
    adapted, plain = Adapted([vector()]), vector()
    adapted.seed(5)
    first, (second, infos) = adapted.reset(), plain.reset(seed=5)
    assert first["scan"].tobytes() == second["scan"].tobytes()
    assert adapted.reset_infos[1]["goal"].tolist() == infos["goal"][1].tolist()
    rng, earned = np.random.default_rng(0), np.zeros(3)
    for step in range(1, 12):
        actions = rng.uniform(-1, 1, (3, 2)).astype(np.float32)
        observation, rewards, done, rows = adapted.step(actions)
        expected = plain.step(actions)
        assert observation["scan"].tobytes() == expected[0]["scan"].tobytes()
        assert rewards == pytest.approx(expected[1])
        assert rewards.dtype == np.float32
        assert done.tolist() == (expected[2] | expected[3]).tolist()
        for i in range(3):
            if not done[i]:
                assert "terminal_observation" not in rows[i]
                continue
            assert step % 5 == 0
            assert rows[i]["TimeLimit.truncated"] is True
            assert rows[i]["reason"] == "timeout"
            assert rows[i]["is_success"] is rows[i]["success"]
            assert rows[i]["time"] == pytest.approx(0.5)
            final = rows[i]["terminal_observation"]
            assert final["scan"].tobytes() == expected[4]["final_obs"][i]["scan"].tobytes()
            assert final["scan"].tobytes() != observation["scan"][i].tobytes()
            assert adapted.reset_infos[i]["time"] == 0.0
        earned += expected[1]
        if done.all():
            told = [row["episode"] for row in rows]
            assert [one["r"] for one in told] == pytest.approx(earned.tolist())
            assert [(one["l"], one["t"]) for one in told] == [(5, pytest.approx(0.5))] * 3
            earned[:] = 0
        else:
            assert not done.any()
            assert all("episode" not in row for row in rows)


def sync(count: int = 3, wrap: Any = lambda env: env) -> Any:
    return SyncVectorEnv(
        [lambda: wrap(RobotEnv("navigation", world="simple", time_limit=0.5))] * count,
        autoreset_mode=AutoresetMode.SAME_STEP,
    )


@pytest.mark.parametrize(
    "wrap", [RecordEpisodeStatistics, lambda env: Curriculum(DictInfoToList(env), difficulty=0.2)]
)
@pytest.mark.parametrize("make", [vector, sync])
def test_wrapped_vectors_and_those_of_single_environments(make: Any, wrap: Any) -> None:
    adapted, plain = Adapted([wrap(make())]), Adapted([vector()])
    for one in (adapted, plain):
        one.seed(5)
        one.set_attr("difficulty", 0.2)
    assert same(adapted.reset(), plain.reset())
    for _ in range(7):
        actions = np.full((3, 2), 0.4, np.float32)
        first, second = adapted.step(actions), plain.step(actions)
        for a, b in zip(first[:3], second[:3], strict=True):
            assert same(a, b)
        assert all(same(a, b) for a, b in zip(first[3], second[3], strict=True))
        assert all(same(a, b) for a, b in zip(adapted.reset_infos, plain.reset_infos, strict=True))
    assert adapted.get_attr("difficulty") == plain.get_attr("difficulty") == [0.2] * 3


def test_several_vectors_are_one(plane: World) -> None:
    both = Adapted([vector(2), vector(3, world=plane)])
    alone = vector(2), vector(3, world=plane)
    both.seed(5)
    seen, first, second = both.reset(), *(one.reset(seed=s)[0] for one, s in zip(alone, (5, 7), strict=True))
    rng = np.random.default_rng(0)
    for _ in range(7):
        assert same(seen, {name: np.concatenate((value, second[name])) for name, value in first.items()})
        actions = rng.uniform(-1, 1, (5, 2))
        seen, rewards, done, rows = both.step(actions)
        first, *ones, one_infos = alone[0].step(actions[:2])
        second, *twos, two_infos = alone[1].step(actions[2:])
        assert rewards == pytest.approx(np.concatenate((ones[0], twos[0])))
        assert done.tolist() == np.concatenate((ones[1] | ones[2], twos[1] | twos[2])).tolist()
        for i, infos, k in ((1, one_infos, 1), (2, two_infos, 0), (4, two_infos, 2)):
            infos = infos["final_info"] if done[i] else infos
            assert rows[i]["T_world_base"].tolist() == infos["T_world_base"][k].tolist()
            assert both.reset_infos[i]["time"] == 0.0
    assert done.shape == (5,)
    both.set_attr("difficulty", 0.9, indices=[1, 2])
    assert [view.difficulty for one in both.vectors for view in one.views] == [0.5, 0.9, 0.9, 0.5, 0.5]


@pytest.mark.parametrize(
    ("vectors", "words"),
    [
        ([], "needs at least one vector environment"),
        ([{"autoreset_mode": "NextStep"}], "autoreset_mode='SameStep', got AutoresetMode.NEXT_STEP"),
        ([{"render_mode": "depth_array"}], "shows render modes rgb_array and map, got 'depth_array'"),
        ([{}, {"robot": "turtlebot3_burger"}], "the same single_observation_space"),
        ([{}, {"render_mode": "map"}], "the same render_mode, got None and map"),
    ],
)
def test_vectors_that_do_not_fit(
    vectors: list[dict[str, Any]], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lirs_envs.sb3.import_module", lambda _: SimpleNamespace(VecEnv=VecEnvInterface))
    with pytest.raises(ConfigError, match=words):
        as_vec_env(*(vector(**options) for options in vectors))


@pytest.mark.parametrize(
    "make",
    [
        lambda: RobotEnv("mapping", world="simple"),
        object,
        lambda: SyncVectorEnv([CartPoleEnv]),
        lambda: SyncVectorEnv([lambda: RobotEnv("mapping", world="simple")], copy=False),
    ],
)
def test_other_environments_are_refused(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    foreign = make()
    monkeypatch.setattr("lirs_envs.sb3.import_module", lambda _: SimpleNamespace(VecEnv=VecEnvInterface))
    with pytest.raises(ConfigError, match=f"as_vec_env needs vectors .*, got {type(foreign).__name__}"):
        as_vec_env(foreign)


@pytest.mark.filterwarnings("ignore:Your observation height_map has an unconventional shape")
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("robot", sorted(name for name, robot in ROBOTS.items() if not robot.flies))
@pytest.mark.parametrize("name", ["LIRS/Mapping-v2", "LIRS/Navigation-v1", "LIRS/Traverse-v1"])
def test_its_checker_finds_nothing(name: str, robot: str) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason=REASON)
    checker.check_env(gym.make(name, robot=robot, world="simple").unwrapped)


def test_its_own_vector_says_the_same() -> None:
    """Single environments in Stable-Baselines3's `DummyVecEnv`: same readings, rewards, ends, infos."""
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env", reason=REASON)
    options: dict[str, Any] = {"world": "medium", "time_limit": 2.0, "observe": EVERYTHING}
    theirs = vec_env.DummyVecEnv([lambda: RobotEnv("navigation", **options) for _ in range(4)])
    ours = as_vec_env(vector(4, **options))
    for envs in (theirs, ours):
        envs.seed(3)
        envs.set_options({"difficulty": 0.1})
    assert same(theirs.reset(), ours.reset())
    assert same(theirs.reset_infos[2], ours.reset_infos[2])
    rng, ends = np.random.default_rng(1), set()
    for _ in range(50):
        actions = rng.uniform((0.3, -0.6), 1, (4, 2)).astype(np.float32)
        one, two = theirs.step(actions), ours.step(actions)
        assert same(one[0], two[0])
        assert same(one[1], two[1])
        assert same(one[2], two[2])
        for i in range(4):
            assert ("episode" in two[3][i]) == two[2][i]
            two[3][i].pop("episode", None)
            assert same(one[3][i], two[3][i]), i
            assert same(theirs.reset_infos[i], ours.reset_infos[i])
            ends |= {(row["reason"], row["TimeLimit.truncated"]) for row in [two[3][i]] if two[2][i]}
    assert ("timeout", True) in ends
    assert ours.get_attr("difficulty", indices=2) == [0.1]


def test_ppo_learns_through_the_adapter() -> None:
    """A few hundred steps on every group, with its monitor, its normalization and an evaluation."""
    sb3 = pytest.importorskip("stable_baselines3", reason=REASON)
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    made = vector(2, observe=EVERYTHING), vector(2, world="medium", observe=EVERYTHING)
    monitored = VecMonitor(as_vec_env(*made), info_keywords=("success",))
    envs = VecNormalize(monitored, norm_obs_keys=["goal", "attitude"])
    model = sb3.PPO("MultiInputPolicy", envs, n_steps=32, batch_size=64, n_epochs=1, seed=0, device="cpu")
    before = {name: value.clone() for name, value in model.policy.state_dict().items()}
    model.learn(384)
    assert model.num_timesteps == 384
    assert {episode["l"] for episode in model.ep_info_buffer} == {5}
    assert any((before[name] != value).any() for name, value in model.policy.state_dict().items())
    envs.training = False
    rewards, lengths = evaluate_policy(model, envs, n_eval_episodes=6, return_episode_rewards=True)
    assert lengths == [5] * 6
    assert np.isfinite(rewards).all()


@pytest.mark.slow
def test_the_program_of_the_how_to_learns() -> None:
    pytest.importorskip("stable_baselines3", reason=REASON)
    page = (Path(__file__).parents[2] / "docs" / "howto" / "rl_libraries.md").read_text(encoding="utf-8")
    (program,) = re.findall(r"```python\n((?:(?!```).)*stable_baselines3.*?)```", page, re.DOTALL)
    for given, less in (
        ("num_envs=16", "num_envs=2"),
        ("n_steps=256", "n_steps=32"),
        ("n_eval_episodes=32", "n_eval_episodes=2"),
        ("512", "32"),
        ("120_000", "64"),
    ):
        assert given in program
        program = program.replace(given, less)
    held: dict[str, Any] = {}
    exec(program, held)
    assert held["model"].num_timesteps == 64
    assert np.isfinite(held["mean"])
