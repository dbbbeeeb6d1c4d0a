"""Policies that look at nothing: the least that any other must beat."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lirs_envs.policies.policy import PolicyContext
from lirs_wct.arrays import Float32Array

HOLD = 1.0
"""Seconds for which a random action is held: drawn anew each step it would go nowhere."""


class StraightAhead:
    """Full speed ahead."""

    def __init__(self, context: PolicyContext) -> None:
        self._action = np.zeros(context.action_size, np.float32)
        self._action[0] = 1.0

    def reset(self, info: Mapping[str, Any]) -> None:
        """Begin an episode."""

    def act(self, observation: Mapping[str, Any]) -> Float32Array:
        """Return the one action."""
        return self._action.copy()


class RandomActions:
    """Actions drawn evenly, each held for a second."""

    def __init__(self, context: PolicyContext) -> None:
        self._rng = np.random.default_rng(context.seed)
        self._size, self._hold = context.action_size, max(1, round(HOLD / context.period))
        self._left, self._action = 0, np.zeros(self._size, np.float32)

    def reset(self, info: Mapping[str, Any]) -> None:
        """Begin an episode."""
        self._left = 0

    def act(self, observation: Mapping[str, Any]) -> Float32Array:
        """Return the action that is held, or another."""
        if self._left == 0:
            self._action = self._rng.uniform(-1, 1, self._size).astype(np.float32)
            self._left = self._hold
        self._left -= 1
        return self._action.copy()
