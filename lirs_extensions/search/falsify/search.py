"""Search for failures (docs/howto/falsify.md): cases, their drives and scores, confirmation, shrinking."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

from lirs_envs.generators.arena import ArenaConfig, arena
from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.robots.robot import make_robot
from lirs_envs.sensing.sensors import SensorFaults, SensorNoise, write_noise
from lirs_extensions.bench.episode import episode_metrics, run_episode
from lirs_extensions.bench.policies import PolicyChoice
from lirs_extensions.bench.tasks import BenchTask, WorldSpec
from lirs_extensions.search.case_search import (
    Case,
    SearchParameter,
    SearchSpace,
    TrialArchive,
    make_proposer,
    shrink,
    trial_key,
)
from lirs_extensions.search.options import FAILURE_FACTOR, POLICY_TASK, FalsifyOptions
from lirs_validation.config import RunConfig
from lirs_validation.experiment.run import run_unwritten
from lirs_validation.record.verdict import LIMITS, classify, run_figures
from lirs_validation.sweep.engines import WorkerPool
from lirs_validation.sweep.tasks import CASE, RunTask, case_options, read_yaml_fields
from lirs_wct.errors import ConfigError, MapperError, SimulationError, unknown_name
from lirs_wct.files import atomic_write

LEAST_RETURNS = 0.3
"""Smallest median share of beams with a return: without walls in sight no planar method can work."""


PARAMETERS: tuple[SearchParameter, ...] = (
    SearchParameter("relief", "ground", 0.0, 0.0, 2.0, "m"),
    SearchParameter("slope", "ground", 0.0, 0.0, 14.0, "deg"),
    SearchParameter("slope_direction", "ground", 90.0, 0.0, 90.0, "deg"),
    SearchParameter("roughness", "ground", 0.0, 0.0, 0.015, "m"),
    SearchParameter("obstacles", "obstacles", 20, 6, 60, whole=True),
    SearchParameter("obstacle_height", "obstacles", 2.0, 0.3, 2.0, "m"),
    SearchParameter("round_obstacles", "obstacles", 0.0, 0.0, 1.0),
    SearchParameter("symmetry", "obstacles", 0.0, 0.0, 1.0),
    SearchParameter("corridor", "obstacles", 0.0, 0.0, 26.0, "m"),
    SearchParameter("corridor_width", "obstacles", 3.0, 2.4, 6.0, "m"),
    SearchParameter("boundary", "obstacles", 1.0, 0.3, 1.0),
    SearchParameter("actors", "obstacles", 0, 0, 12, whole=True),
    SearchParameter("speed", "drive", 1.0, 0.4, 1.25),
    SearchParameter("turn_rate", "drive", 1.0, 0.5, 1.6),
    SearchParameter("reversing", "drive", 0.0, 0.0, 0.5),
    SearchParameter("stand", "drive", 0.0, 0.0, 10.0, "s"),
    SearchParameter("sigma", "sensors", 0.0, 0.0, 0.03, "m"),
    SearchParameter("dropout", "sensors", 0.0, 0.0, 0.3),
    SearchParameter("lag", "sensors", 0.0, 0.0, 0.12, "s"),
    SearchParameter("field_of_view", "sensors", 360.0, 120.0, 360.0, "deg"),
    SearchParameter("dust", "sensors", 0.0, 0.0, 0.1),
    SearchParameter("slip", "sensors", 0.0, 0.0, 0.3),
)
"""All parameters with their defaults and limits."""
OF_A_POLICY = ("ground", "obstacles")
"""Groups that matter to a policy; the environments have no faults of sensors."""


@dataclass(frozen=True)
class SearchLimits(SearchSpace):
    """Parameters to search, and the plausibility of a case.

    Attributes:
        returns: Smallest median share of beams with a return.
    """

    parameters: tuple[SearchParameter, ...] = PARAMETERS
    returns: float = LEAST_RETURNS


def search_limits(options: FalsifyOptions) -> SearchLimits:
    """Return the limits of a search."""
    limits = SearchLimits() if options.limits is None else read_search_limits(Path(options.limits))
    if options.policy is None:
        return limits
    other = [p.name for p in limits.parameters if p.group not in OF_A_POLICY or p.name == "actors"]
    return replace(limits.held(other), returns=0.0)


def read_search_limits(path: Path) -> SearchLimits:
    """Read limits from a YAML file: `name: [low, high]`, `name: value`, and `returns`.

    Parameters that are left out keep their limits.
    """
    entry = read_yaml_fields(path)
    names = {p.name: p for p in PARAMETERS}
    limits = SearchLimits()
    for name, given in entry.items():
        if name != "returns" and name not in names:
            raise ConfigError(f"{path}: {unknown_name('parameter', str(name), [*names, 'returns'])}")
        known = SearchParameter("returns", "sensors", 0.0, 0.0, 1.0) if name == "returns" else names[name]
        found = known.read_within(path, given, LEGAL.get(name, (0.0, 1.0)))
        limits = replace(limits, returns=found.low) if name == "returns" else limits.with_parameter(found)
    return limits


LEGAL: Mapping[str, tuple[float, float]] = {
    "relief": (0, 10), "slope": (0, 40), "slope_direction": (-360, 360), "roughness": (0, 0.3),
    "obstacles": (0, 300), "obstacle_height": (0, 10), "corridor": (0, 30), "corridor_width": (1, 20),
    "actors": (0, 50), "speed": (0.1, 2), "turn_rate": (0.1, 2), "stand": (0, 60), "sigma": (0, 1),
    "lag": (0, 1), "field_of_view": (10, 360),
}  # fmt: skip
"""Values that a limits file may give; of a share, 0 to 1."""


NOISE = "noise.yaml"
OF_RUN = ("actors", "speed", "turn_rate", "reversing", "stand")
"""Parameters that are options of a run."""
OF_FAULTS = ("lag", "field_of_view", "dust", "slip")
OF_ARENA = tuple(p.name for p in PARAMETERS if p.group in ("ground", "obstacles") and p.name not in OF_RUN)


def arena_options(case: Case, seed: int) -> dict[str, Any]:
    """Return the parameters of a case's arena as options of `ArenaConfig`."""
    found: dict[str, Any] = {name: case.values[name] for name in OF_ARENA}
    return found | {"obstacles": int(found["obstacles"]), "seed": seed}


def case_noise(case: Case, robot: str) -> SensorNoise:
    """Return the sensor noise of a case: the lidar's simulated noise and the case's degradation."""
    usual, v = SensorNoise().of_lidar(make_lidar_preset(make_robot(robot).lidar)), case.values
    lidar = replace(usual, sigma=usual.sigma + v["sigma"], dropout=v["dropout"])
    return SensorNoise(lidar=lidar, faults=SensorFaults(**{name: v[name] for name in OF_FAULTS}))


def write_case(
    folder: Path, case: Case, options: FalsifyOptions, *, method: str, seed: int, comment: str = ""
) -> RunConfig:
    """Write a case into a folder; return the run that `lirs-wct validate` reads there."""
    run: dict[str, Any] = {"robot": options.robot, "mapper": method, "seed": seed}
    run |= {"seconds": float(options.seconds)}
    changed = SearchLimits().difference(case)
    values = {p.name: case.values[p.name] for p in changed if p.name in OF_RUN}
    run |= {p.name: int(values[p.name]) if p.whole else values[p.name] for p in changed if p.name in values}
    arena(folder.name, ArenaConfig(**arena_options(case, options.seed))).save(folder)
    if any(p.group == "sensors" for p in changed):
        write_noise(folder / NOISE, case_noise(case, options.robot), "Sensor noise of this case.")
        run["noise"] = NOISE
    text = yaml.safe_dump({"run": run, "parameters": dict(case.values)}, sort_keys=False)
    with atomic_write(folder / CASE) as path:
        path.write_text((f"# {comment}\n" if comment else "") + text, encoding="utf-8")
    return RunConfig(source=str(folder), **case_options(folder))


GOAL = (11.0, 0.0)
"""Goal of a policy, x and y in the arena, meters."""
WORST = 100.0
"""Ratio of a mapper that raised, and the largest ratio of any drive."""


@dataclass(frozen=True)
class DriveScore:
    """Score of one drive.

    Attributes:
        ratio: Path error over the limit; of a policy, above the search's factor if it failed, the more of
            the way is left the higher, else below 1.
        counted: Whether the case is plausible: the robot could drive, and its lidar saw walls.
        error: Path error, meters; None of a policy and of a drive without one.
        limit: Limit of `loses its way`, or that of a reference, meters; None without one.
        returns: Median share of beams with a return; None of a policy or a mapper of point clouds.
        reason: Cause why the drive ended early or does not count; empty if neither.
    """

    ratio: float
    counted: bool = True
    error: float | None = None
    limit: float | None = None
    returns: float | None = None
    reason: str = ""


def check_methods(options: FalsifyOptions) -> None:
    """Check that robot and methods exist."""
    if options.policy is not None:
        policy_task(options, SearchLimits().easiest, options.seed)  # checks the robot
    for method in filter(None, (options.method, options.compared_with)):
        if options.policy is not None:
            PolicyChoice(method).check(POLICY_TASK)
        else:
            RunTask(RunConfig(source="simple", robot=options.robot, mapper=method)).check()


def measure(options: FalsifyOptions, method: str, case: Case, seed: int, returns: float) -> DriveScore:
    """Drive a method through a case with a seed; return its score."""
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
    """Return the score of a mapper's drive."""
    record = run_unwritten(config)
    figures, scans, reason = run_figures(asdict(record)), record.scans, record.reason
    error, odometry, (kind, _) = figures.error, figures.odometry_error, classify(figures)
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
        task=POLICY_TASK,
        split="test",
        robot=options.robot,
        seed=seed,
        time_limit=options.seconds,
        world=world,
        start=(0.0, 0.0, 0.0),
        goal=GOAL,
    )


def _measure_policy(options: FalsifyOptions, method: str, case: Case, seed: int) -> DriveScore:
    """Return the score of a policy's episode."""
    task = policy_task(options, case, seed)
    try:
        log = run_episode(task, PolicyChoice(method))
    except (SimulationError, ConfigError) as error:  # start or goal are blocked
        return DriveScore(0.0, counted=False, reason=str(error))
    metrics = episode_metrics(task, log)
    if metrics["success"]:
        return DriveScore(1.0 - metrics["score"], reason=log.reason)
    x, y = log.poses[-1][:2].tolist()
    left = math.hypot(GOAL[0] - x, GOAL[1] - y) / math.hypot(*GOAL)
    return DriveScore(min(FAILURE_FACTOR * (1.0 + left), WORST), reason=log.reason)


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
        history: Every score of the method under test, in order, with its stage, case and seed.
        stage: Present part of the search.
    """

    def __init__(
        self, options: FalsifyOptions, limits: SearchLimits, out: Path, pool: WorkerPool | None = None
    ) -> None:
        self.options, self.limits = options, limits
        self.history: list[tuple[str, Case, int, DriveScore]] = []
        self.stage = "search"
        self._archive = TrialArchive(out / ARCHIVE, DriveScore, pool)

    @property
    def count(self) -> int:
        """Number of drives so far, repetitions of earlier ones in the file included."""
        return self._archive.count

    def fails(self, score: DriveScore) -> bool:
        """Return whether a drive is a failure that counts."""
        return score.counted and score.ratio > FAILURE_FACTOR

    def run(self, trials: Sequence[Trial]) -> list[DriveScore]:
        """Return the scores of trials, in their order; with a reference, as `against` compares them."""
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
        options, returns = self.options, self.limits.returns
        entry = {name: getattr(options, name) for name in ("policy", "robot", "seconds", "seed")}
        entry |= {"method": method, "returns": returns}
        keys = [trial_key(entry | {"drive": seed, "values": dict(case.values)}) for case, seed in trials]
        arguments = [(options, method, case, seed, returns) for case, seed in trials]
        return self._archive.scores(measure, list(zip(keys, arguments, strict=True)), method)


MIN_RATIO = 0.01
"""Ratios below count as this one."""
UNCOUNTED = 1.0
"""Loss of a case that does not count, added to the largest loss of one that does."""


def loss(score: DriveScore) -> float:
    """Return the value to minimize: minus the logarithm of the ratio.

    A case that does not count is worse than any that does.
    """
    if not score.counted:
        return UNCOUNTED - math.log(MIN_RATIO)
    return -math.log(min(max(score.ratio, MIN_RATIO), WORST))


NEW_SEEDS, NEEDED = 5, 4
"""New seeds of a confirmation, and the failures among them that confirm a case."""
CONFIRM, RECHECK, SHRINK = 1000, 2000, 100
"""Offsets of the seeds of a confirmation, of a shrunk case's, and of shrinking."""
STREAM = 41
"""Random stream of the search."""


@dataclass(frozen=True)
class FoundCase:
    """A confirmed failure.

    Attributes:
        case: Simplest form of the case.
        found: Case as the search found it.
        drives: Number of drives of the search up to its confirmation.
        position: Number of the last of them in the history.
        seed: Seed of a drive that fails.
        scores: Scores of the simplest form with new seeds.
        shrinking: Number of drives that shrinking took.
    """

    case: Case
    found: Case
    drives: int
    position: int
    seed: int
    scores: tuple[DriveScore, ...]
    shrinking: int


Report = Callable[[str], None]


def falsify(drives: CaseDrives, report: Report = lambda line: None) -> tuple[FoundCase, ...]:
    """Search for failures until the drives are used or enough cases are found."""
    options, limits = drives.options, drives.limits
    found: list[FoundCase] = []
    shrinking = 0
    while drives.count - shrinking < options.drives and len(found) < options.cases:
        left = options.drives - drives.count + shrinking
        case = _search(drives, limits, len(found), left, report)
        if case is None:
            break
        used = drives.count - shrinking
        report(f"confirmed after {used} drives; shrinking")
        found.append(_simplest(drives, case, used))
        shrinking += found[-1].shrinking
        changed = [p.name for p in limits.difference(found[-1].case)]
        limits = limits.held(changed)
        if not changed or not limits.free:
            break
    return tuple(found)


def _search(
    drives: CaseDrives, limits: SearchLimits, restart: int, budget: int, report: Report
) -> Case | None:
    """Return a confirmed case within the limits; None if the drives end before."""
    options, end = drives.options, drives.count + budget
    proposer = make_proposer(options.search, limits, np.random.default_rng((options.seed, STREAM, restart)))
    proposed = [limits.easiest] if restart == 0 else proposer.propose()
    while drives.count < end:
        proposed = proposed[: end - drives.count]
        scores = drives.run([(case, options.seed) for case in proposed])
        best = max((s.ratio for s in scores if s.counted), default=0.0)
        report(f"{drives.count} drives; largest ratio of the last {len(scores)}: {best:.2f}")
        for k in _failures(drives, scores):
            if drives.count >= end:
                break
            again = confirmation(drives, proposed[k], CONFIRM)
            if len(_failures(drives, again)) >= NEEDED:
                return proposed[k]
            # The search follows failures of every seed, not of a lucky one.
            scores[k] = replace(scores[k], ratio=median(s.ratio for s in again))
        if proposed != [limits.easiest]:
            proposer.learn([loss(score) for score in scores])
        proposed = proposer.propose()
    return None


def _failures(drives: CaseDrives, scores: Sequence[DriveScore]) -> list[int]:
    """Return the indices of failures, the clearest first."""
    failed = [k for k, score in enumerate(scores) if drives.fails(score)]
    return sorted(failed, key=lambda k: -scores[k].ratio)


def confirmation(drives: CaseDrives, case: Case, offset: int) -> list[DriveScore]:
    """Return the scores of a case with new seeds; stop when too many pass."""
    before, drives.stage = drives.stage, "confirmation"
    trials = [(case, drives.options.seed + offset + k) for k in range(NEW_SEEDS)]
    scores: list[DriveScore] = []
    while len(scores) < NEW_SEEDS and len(scores) - len(_failures(drives, scores)) <= NEW_SEEDS - NEEDED:
        scores += drives.run(trials[len(scores) : len(scores) + 2])
    drives.stage = before
    return scores


def _simplest(drives: CaseDrives, case: Case, used: int) -> FoundCase:
    """Return the simplest form of a confirmed case that new seeds confirm, too."""
    begun, position, seed = drives.count, len(drives.history), drives.options.seed
    drives.stage = "shrinking"

    def fails(tried: Case) -> bool:
        scores = drives.run([(tried, seed), (tried, seed + SHRINK)])
        return len(_failures(drives, scores)) == len(scores)

    trail = shrink(case, drives.limits, fails)
    step = 1
    for back in range(1, len(trail) + 1):
        if back not in (step, len(trail)):
            continue
        step *= 2
        chosen, offset = trail[-back], RECHECK if back < len(trail) else CONFIRM
        scores = confirmation(drives, chosen, offset)
        failed = _failures(drives, scores)
        if len(failed) >= NEEDED:
            break
    first = seed + offset + min(failed)
    drives.stage = "search"
    return FoundCase(chosen, case, used, position, first, tuple(scores), drives.count - begun)
