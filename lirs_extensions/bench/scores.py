"""Scores of episodes, 0 to 1, and mean scores of policies with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # its modules load on first use

from lirs_envs.tasks.mapping import COVERED
from lirs_wct.arrays import FloatArray

CONFIDENCE = 0.95
RESAMPLES = 10_000
SEED = 1
"""Of the resamples: the same scores have the same interval."""


@dataclass(frozen=True, kw_only=True)
class PolicyScore:
    """A mean over tasks.

    Attributes:
        mean: of the tasks' scores.
        low: lower end of its 95 % interval, by the percentile bootstrap over tasks; None of one task.
        high: upper end.
        count: number of tasks.
    """

    mean: float
    low: float | None
    high: float | None
    count: int


def score_of(values: Sequence[float]) -> PolicyScore | None:
    """Return the mean of tasks' scores with its interval; None of no score."""
    if not values:
        return None
    scores, mean = np.array(values, dtype=np.float64), float(np.mean(values))
    if len(scores) == 1:
        return PolicyScore(mean=mean, low=None, high=None, count=1)
    if np.ptp(scores) == 0:
        return PolicyScore(mean=mean, low=mean, high=mean, count=len(scores))
    found = scipy.stats.bootstrap(
        (scores,),
        np.mean,
        confidence_level=CONFIDENCE,
        n_resamples=RESAMPLES,
        method="percentile",
        rng=np.random.default_rng(SEED),
    ).confidence_interval
    return PolicyScore(mean=mean, low=float(found.low), high=float(found.high), count=len(scores))


def success_by_path_length(success: bool, shortest: float, driven: float) -> float:
    """Return an episode's term of success weighted by path length (SPL).

    See Anderson et al., "On evaluation of embodied navigation agents" (2018).

    Args:
        success: whether the goal was reached.
        shortest: length of the shortest path from start to goal over drivable ground, meters.
        driven: length of the driven path, meters.
    """
    return shortest / max(shortest, driven) if success else 0.0


def coverage_area(driven: Sequence[float], coverage: Sequence[float], budget: float) -> float:
    """Return the area under newly covered ground over path length, 0 to 1.

    Ground in the first scan counts as 0, the share that completes the task as 1. After the episode's end the
    coverage stays constant.

    Args:
        driven: (n,) meters of path at each step, from 0 at the first scan.
        coverage: (n,) share of the reachable ground that was seen by then.
        budget: meters of path over which the area is taken.
    """
    first = coverage[0]
    if first >= COVERED:
        return 0.0
    gained: FloatArray = np.clip((np.array(coverage) - first) / (COVERED - first), 0.0, 1.0)
    at = np.minimum(np.append(np.array(driven, dtype=np.float64), budget), budget)
    return float(np.trapezoid(np.append(gained, gained[-1]), at) / budget)


def distance_share(gained: float, whole: float) -> float:
    """Return the gained share, 0 to 1, of the distance to the goal."""
    return float(np.clip(gained / whole, 0.0, 1.0))
