"""A difficulty that follows success."""

from __future__ import annotations

from collections import deque
from typing import Any

import gymnasium as gym

from lirs_wct.errors import ConfigError


class Curriculum(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Raises the difficulty of an environment where enough of its last episodes succeeded, else lowers it.

    After each `episodes` episodes at a difficulty: with at least `raise_at` of them successful it goes up by
    `step`, with at most `lower_at` down. `info["difficulty"]` of a reset tells the one of the episode.

    Args:
        env: with a `difficulty` and `info["success"]`.
        difficulty: of the first episode, 0 to 1.
        step: of the difficulty.
        episodes: that are looked at together.
        raise_at: share of successes.
        lower_at: share of successes.

    Raises:
        ConfigError: a value is not legal, or the environment has no difficulty.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        *,
        difficulty: float = 0.0,
        step: float = 0.05,
        episodes: int = 10,
        raise_at: float = 0.8,
        lower_at: float = 0.3,
    ) -> None:
        gym.utils.RecordConstructorArgs.__init__(
            self,
            difficulty=difficulty,
            step=step,
            episodes=episodes,
            raise_at=raise_at,
            lower_at=lower_at,
        )
        super().__init__(env)
        if not env.has_wrapper_attr("difficulty"):
            raise ConfigError("a curriculum needs an environment with a difficulty")
        if not (0 <= difficulty <= 1 and 0 < step <= 1 and episodes >= 1 and 0 <= lower_at < raise_at <= 1):
            raise ConfigError(
                "a curriculum needs 0 <= difficulty <= 1, 0 < step <= 1, episodes >= 1 and "
                f"0 <= lower_at < raise_at <= 1, got {difficulty}, {step}, {episodes}, {lower_at}, {raise_at}"
            )
        self.difficulty = difficulty
        self._step, self._limits = step, (lower_at, raise_at)
        self._outcomes: deque[bool] = deque(maxlen=episodes)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode at the present difficulty."""
        self.env.set_wrapper_attr("difficulty", self.difficulty)
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, info | {"difficulty": self.difficulty}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and look at the outcome of an episode that ends."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            self._outcomes.append(bool(info.get("success", False)))
            self._adapt()
        return observation, reward, terminated, truncated, info

    def _adapt(self) -> None:
        if len(self._outcomes) < (self._outcomes.maxlen or 0):
            return
        share, (low, high) = sum(self._outcomes) / len(self._outcomes), self._limits
        if share >= high:
            self.difficulty = min(1.0, self.difficulty + self._step)
        elif share <= low:
            self.difficulty = max(0.0, self.difficulty - self._step)
        else:
            return
        self._outcomes.clear()
