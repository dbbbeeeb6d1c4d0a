"""Log of an episode, and its score in each task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lirs_envs.tasks.task import COVERED
from lirs_extensions.bench.tasks import BenchTask
from lirs_wct import FloatArray


@dataclass
class EpisodeLog:
    """Log of an episode; each step adds one entry.

    Attributes:
        poses: true x, y, yaw, meters and radians, beginning with the start.
        first: info of the environment after the reset.
        last: latest info of the environment.
        coverage: share of the reachable ground seen, one per pose; empty except in mapping tasks.
        reason: reason for the end.
        trace: traceback of the policy's failure; empty without a failure.
    """

    poses: list[FloatArray] = field(default_factory=list)
    first: Mapping[str, Any] = field(default_factory=dict)
    last: Mapping[str, Any] = field(default_factory=dict)
    coverage: list[float] = field(default_factory=list)
    reason: str = ""
    trace: str = ""

    def add(self, info: Mapping[str, Any]) -> None:
        """Add the environment's info after the reset or a step."""
        self.first = self.first or info
        self.last = info
        self.poses.append(np.array(info["T_world_base"]))
        if "coverage" in info:
            self.coverage.append(float(info["coverage"]))

    @property
    def driven(self) -> FloatArray:
        """(n,) meters of path until each pose."""
        steps = np.diff(np.array(self.poses)[:, :2], axis=0)
        driven: FloatArray = np.concatenate(([0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))))
        return driven


def episode_metrics(task: BenchTask, log: EpisodeLog) -> dict[str, Any]:
    """Return score, success and their inputs; a failed policy scores 0."""
    driven, last = log.driven, log.last
    entry: dict[str, Any] = {
        "score": 0.0,
        "success": bool(last.get("success", last.get("reason") == "covered")),
        "collision": bool(last.get("collision", False)),
        "path_length": float(driven[-1]),
        "time": float(last["time"]),
    }
    if task.task == "navigation":
        shortest = float(log.first["shortest_path"])
        entry["shortest_path"] = shortest
        score = success_by_path_length(entry["success"], shortest, float(driven[-1]))
    elif task.task == "mapping":
        assert task.path_budget is not None, "checked with the task"
        entry |= {"first_coverage": log.coverage[0], "coverage": log.coverage[-1]}
        score = coverage_area(driven.tolist(), log.coverage, task.path_budget)
    else:
        whole = float(log.first["distance"])
        entry |= {"distance": whole, "progress": float(last["progress"])}
        score = 1.0 if entry["success"] else distance_share(entry["progress"], whole)
    return entry | ({} if log.trace else {"score": score})


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
