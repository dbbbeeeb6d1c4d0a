"""Cases of a search (docs/howto/falsify.md) and their drives: scored, concurrent, kept in a file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from lirs_validation.bench.episode import EpisodeLog, episode_metrics, run_episode
from lirs_validation.bench.policies import PolicyChoice
from lirs_validation.bench.task_worlds import WorldSpec
from lirs_validation.bench.tasks import BenchTask, TaskSet, set_entry
from lirs_validation.config import RunConfig
from lirs_validation.experiment.run import run_unwritten
from lirs_validation.falsify import FalsifyOptions
from lirs_validation.falsify.cases import SearchLimits, arena_options, write_case
from lirs_validation.metrics.verdict import LIMITS, VerdictFigures, classify
from lirs_validation.search import Case, TrialArchive, trial_key
from lirs_validation.sweep.experiment import SlamExperiment
from lirs_wct.errors import ConfigError, MapperError, SimulationError

GOAL = (11.0, 0.0)
"""Goal of a policy, x and y in the arena, meters."""
WORST = 100.0
"""Ratio of a mapper that raised, and the largest ratio of any drive."""


@dataclass(frozen=True)
class DriveScore:
    """Score of one drive.

    Attributes:
        ratio: path error over the limit; of a policy, above the search's factor if it failed, the more of
            the way is left the higher, else below 1.
        counted: whether the case is plausible: the robot could drive, and its lidar saw walls.
        error: path error, meters; None of a policy and of a drive without one.
        limit: limit of `loses its way`, or that of a reference, meters; None without one.
        returns: median share of beams with a return; None of a policy or a mapper of point clouds.
        reason: why the drive ended early or does not count; empty if neither.
    """

    ratio: float
    counted: bool = True
    error: float | None = None
    limit: float | None = None
    returns: float | None = None
    reason: str = ""


def check_methods(options: FalsifyOptions) -> None:
    """Check that robot and methods exist.

    Raises:
        WctError: one does not, or cannot run.
    """
    if options.policy is not None:
        policy_task(options, SearchLimits().easiest, options.seed)  # checks the robot
    for method in filter(None, (options.method, options.compared_with)):
        if options.policy is not None:
            PolicyChoice(method).check(options.task)
        else:
            SlamExperiment(RunConfig(source="simple", robot=options.robot, mapper=method)).check()


def measure(options: FalsifyOptions, method: str, case: Case, seed: int, returns: float) -> DriveScore:
    """Drive a method through a case and return its score.

    Args:
        options: of the search.
        method: mapper or policy.
        case: values of the parameters.
        seed: of the drive and its sensors.
        returns: smallest median share of beams with a return.
    """
    if options.policy is not None:
        return _measure_policy(options, method, case, seed)
    with TemporaryDirectory(prefix="lirs-wct-case-") as folder:
        config = write_case(Path(folder) / "case", case, options, method=method, seed=seed)
        try:
            return _measure_mapper(config, returns)
        except MapperError as error:
            return DriveScore(WORST, reason=str(error).replace(f"{folder}/", ""))
        except (SimulationError, ConfigError) as error:  # no place for the robot, or nothing was driven
            return DriveScore(0.0, counted=False, reason=str(error).replace(f"{folder}/", ""))


def _measure_mapper(config: RunConfig, least: float) -> DriveScore:
    """Return the score of a mapper's drive.

    Raises:
        ConfigError: the robot fits nowhere.
        MapperError: the mapper failed.
        SimulationError: nothing was driven.
    """
    entry = run_unwritten(config)
    trajectory, scans, reason = entry["trajectory"], entry["scans"], entry["reason"]
    error, odometry = trajectory.get("ate_rmse"), trajectory.get("odometry_ate_rmse")
    figures = VerdictFigures(
        status=entry["status"],
        has_reference=True,
        robot_lengths=trajectory["robot_lengths"],
        error=error,
        odometry_error=odometry,
        distance=trajectory["length"],
    )
    kind, _ = classify(figures)
    if kind == "not evaluated" or error is None or odometry is None:
        return DriveScore(0.0, counted=False, reason=reason or "too short a drive")
    share = scans["returns_median"] / scans["beams"] if scans else None  # of point clouds
    limit = LIMITS.times_odometry * odometry + LIMITS.over_odometry
    seen = share is None or share >= least
    reason = reason if seen else f"only {100 * (share or 0):.0f} % of the beams have a return"
    return DriveScore(min(error / limit, WORST), seen, error, limit, share, reason)


def policy_task(options: FalsifyOptions, case: Case, seed: int, name: str = "case") -> BenchTask:
    """Return the task of a policy in a case."""
    world = WorldSpec(name=name, maker="arena", options=tuple(arena_options(case, options.seed).items()))
    return BenchTask(
        name=f"{name}-s{seed}",
        task=options.task,
        split="test",
        robot=options.robot,
        seed=seed,
        time_limit=options.seconds,
        world=world,
        start=(0.0, 0.0, 0.0),
        goal=GOAL,
    )


def policy_suite(tasks: Sequence[BenchTask]) -> dict[str, Any]:
    """Return the JSON value of a set of tasks for `lirs-wct bench --set`."""
    return set_entry(TaskSet(name="cases", version=1, tasks=tuple(tasks)))


def policy_episode(method: str, task: BenchTask) -> EpisodeLog:
    """Run a policy on a case's task."""
    return run_episode(task, PolicyChoice(method))


def _measure_policy(options: FalsifyOptions, method: str, case: Case, seed: int) -> DriveScore:
    """Return the score of a policy's episode."""
    task = policy_task(options, case, seed)
    try:
        log = policy_episode(method, task)
    except (SimulationError, ConfigError) as error:  # start or goal are blocked
        return DriveScore(0.0, counted=False, reason=str(error))
    metrics = episode_metrics(task, log)
    if metrics["success"]:
        return DriveScore(1.0 - metrics["score"], reason=log.reason)
    x, y = log.poses[-1][:2].tolist()
    left = math.hypot(GOAL[0] - x, GOAL[1] - y) / math.hypot(*GOAL)
    return DriveScore(min(options.factor * (1.0 + left), WORST), reason=log.reason)


PERFECT = DriveScore(0.0, error=0.0)
"""Score of a reference without error, which is compared where no reference needs to be driven."""


def against(score: DriveScore, other: DriveScore, reference: str) -> DriveScore:
    """Return a score in comparison with the reference's in the same drive.

    A mapper's limit is 1.1 x the ATE of the reference + 0.05 m in place of the odometry's. Nothing counts
    where the reference itself loses its way, or as a policy fails.
    """
    if not other.counted or other.ratio > 1.0:
        return replace(score, counted=False, reason=f"{reference} does not succeed there")
    if score.error is None or other.error is None:
        return score
    limit = LIMITS.times_odometry * other.error + LIMITS.over_odometry
    return replace(score, ratio=min(score.error / limit, WORST), limit=limit)


ARCHIVE = "drives.jsonl"
Trial = tuple[Case, int]
"""A case and the seed of its drive."""


class CaseDrives:
    """Runs drives, counts them and keeps their scores.

    Attributes:
        history: every score of the method under test, in order, with its stage, case and seed.
        stage: present part of the search.

    Args:
        options: of the search.
        limits: plausibility of a case.
        out: folder of the archive.
        pool: runs drives in other processes; None = in this one.
    """

    def __init__(
        self, options: FalsifyOptions, limits: SearchLimits, out: Path, pool: Executor | None = None
    ) -> None:
        self.options, self.limits = options, limits
        self.history: list[tuple[str, Case, int, DriveScore]] = []
        self.stage = "search"
        self._archive = TrialArchive(out / ARCHIVE, DriveScore, pool)

    @property
    def count(self) -> int:
        """Number of drives that the search has used, repetitions of earlier ones in the file included."""
        return self._archive.count

    def fails(self, score: DriveScore) -> bool:
        """Return whether a drive is a failure that counts."""
        return score.counted and score.ratio > self.options.factor

    def run(self, trials: Sequence[Trial]) -> list[DriveScore]:
        """Return the scores of trials, in their order; with a reference, as `against` compares them.

        Raises:
            WctError: a worker process died, or the archive cannot be written.
        """
        scores = self._scores(self.options.method, trials)
        reference = self.options.compared_with
        if reference is not None:
            doubtful = [k for k, s in enumerate(scores) if self.fails(against(s, PERFECT, reference))]
            compared = self._scores(reference, [trials[k] for k in doubtful])
            others = dict(zip(doubtful, compared, strict=True))
            scores = [against(s, others.get(k, PERFECT), reference) for k, s in enumerate(scores)]
        self.history += [(self.stage, *trial, score) for trial, score in zip(trials, scores, strict=True)]
        return scores

    def _scores(self, method: str, trials: Sequence[Trial]) -> list[DriveScore]:
        returns = self.limits.returns
        keyed = [(self._key(method, *t), (self.options, method, *t, returns)) for t in trials]
        return self._archive.scores(measure, keyed, method)

    def _key(self, method: str, case: Case, seed: int) -> str:
        """Return the digest of everything that decides a drive."""
        options = asdict(self.options)
        decisive = {name: options[name] for name in ("policy", "task", "robot", "seconds", "seed", "factor")}
        entry = decisive | {"method": method, "drive": seed, "returns": self.limits.returns}
        return trial_key(entry | {"values": dict(case.values)})
