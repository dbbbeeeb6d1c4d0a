"""Tasks of other packages: the program of the how-to, and what is refused."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from lirs_envs.episodes.episodes import TASKS, register_task
from lirs_envs.tasks.mapping import MappingTask
from lirs_envs.tasks.navigation import NavigationTask
from lirs_wct.errors import ConfigError
from lirs_wct.world import World

PAGE = Path(__file__).parents[3] / "docs" / "howto" / "policy.md"


@pytest.fixture
def wander() -> Iterator[str]:
    """Run the how-to's program, which registers a task and an environment."""
    section = PAGE.read_text().partition("## A task of your own")[2]
    program = re.findall(r"```python\n(.*?)```", section, re.DOTALL)[0]
    exec(program, {})
    yield "Mine/Wander-v0"
    del TASKS["wander"], gym.registry["Mine/Wander-v0"]


def test_the_task_of_the_how_to(wander: str, plane: World) -> None:
    env = gym.make(wander, world=plane, time_limit=2.0)
    vector = gym.make_vec(
        wander, num_envs=2, vectorization_mode="vector_entry_point", world=plane, time_limit=2.0
    )
    _, first = env.reset(seed=4)
    vector.reset(seed=4)
    ahead, truncated, earned = np.array((1.0, 0.0), np.float32), False, 0.0
    while not truncated:
        _, reward, terminated, truncated, info = env.step(ahead)
        _, rewards, *_ = vector.step(np.tile(ahead, (2, 1)))
        assert rewards[0] == reward
        assert not terminated
        earned += float(reward) + 0.1 * 0.1 / 2
    driven: Any = np.hypot(*(info["T_world_base"] - first["T_world_base"])[:2])
    assert earned == pytest.approx(driven, rel=1e-3)
    assert info["reason"] == "timeout"


def test_a_task_keeps_its_name() -> None:
    before = dict(TASKS)
    register_task("mapping", MappingTask)
    for name, task, message in (
        ("mapping", NavigationTask, "belongs to another task, MappingTask"),
        ("other", dict, "subclass of lirs_envs.tasks.task.Task"),
        ("other", "Task", "subclass of lirs_envs.tasks.task.Task"),
    ):
        with pytest.raises(ConfigError, match=message):
            register_task(name, task)  # type: ignore[arg-type]
    assert before == TASKS
