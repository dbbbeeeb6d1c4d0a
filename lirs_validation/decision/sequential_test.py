"""Sequential probability ratio test of a share of successes, and its exact interval."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from scipy.stats import beta

P0, P1 = 0.65, 0.90
"""Shares of successes: the test rejects a method at P0 and accepts one at P1 ..."""
ERROR = 0.05
"""... with at most this share of errors each."""
CONFIDENCE = 0.95

Outcome = Literal["accepted", "rejected"]


@dataclass(frozen=True)
class SequentialTest:
    """State of Wald's sequential probability ratio test (Ann. Math. Stat. 16, 1945).

    Attributes:
        successes: so far.
        failures: so far.
    """

    successes: int = 0
    failures: int = 0

    @property
    def log_ratio(self) -> float:
        """Logarithm of the likelihood of P1 over that of P0."""
        return self.successes * _SUCCESS + self.failures * _FAILURE

    @property
    def outcome(self) -> Outcome | None:
        """Outcome of the test; None while more observations are needed."""
        if self.log_ratio >= _BOUND:
            return "accepted"
        return "rejected" if self.log_ratio <= -_BOUND else None

    @property
    def least_more(self) -> int:
        """Smallest number of observations that can decide."""
        if self.outcome is not None:
            return 0
        up = math.ceil((_BOUND - self.log_ratio) / _SUCCESS)
        return min(up, math.ceil((self.log_ratio + _BOUND) / -_FAILURE))

    def add(self, success: bool) -> SequentialTest:
        """Return the state after one more observation."""
        return SequentialTest(self.successes + success, self.failures + (not success))

    @property
    def share(self) -> float | None:
        """Share of successes; None without an observation."""
        total = self.successes + self.failures
        return self.successes / total if total else None

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson interval of the share, as for a fixed number of observations."""
        tail = (1 - CONFIDENCE) / 2
        low = beta.ppf(tail, self.successes, self.failures + 1) if self.successes else 0.0
        high = beta.ppf(1 - tail, self.successes + 1, self.failures) if self.failures else 1.0
        return float(low), float(high)


_SUCCESS, _FAILURE = math.log(P1 / P0), math.log((1 - P1) / (1 - P0))
_BOUND = math.log((1 - ERROR) / ERROR)
