"""Decision: does a method work on a terrain? Drive until a test decides; if it does not, try changes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from itertools import zip_longest
from operator import itemgetter
from pathlib import Path
from statistics import median_low
from typing import Literal, TypeVar

from scipy.special import betaincinv  # imports in a third of the time of scipy.stats

from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.robots.robot import make_robot
from lirs_extensions.decide.forecast import DriveSite, changes, forecast
from lirs_validation.cli.progress import note, run_with_progress
from lirs_validation.config import EngineOptions, RunConfig
from lirs_validation.driving.choice import make_driver
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.processes import interrupt_after
from lirs_validation.record.metric_catalog import value_at
from lirs_validation.record.run_record import read_record
from lirs_validation.record.verdict import VerdictClass, cause_of, extent_sentences
from lirs_validation.report.run_tables import path_result
from lirs_validation.sweep.sweep import Sweep
from lirs_validation.sweep.tasks import RunTask, make_executor
from lirs_wct import OccupancyGrid, OutputError, WctError
from slam_baselines.mapper import MAPPERS, short_name

P0, P1 = 0.65, 0.90
"""Shares of successes: the test rejects a method at P0 and accepts one at P1 ..."""
ERROR = 0.05
"""... with at most this share of errors each."""
CONFIDENCE = 0.95
FIRST_DRIVES = 10
"""Drives after which a terrain counts as impassable if most of them were not evaluated."""
CHANGE_DRIVES = 3
"""Drives of a change, fewer if one of them shows no effect."""
MIN_BLIND_SCANS = 0.9
"""Share of scans without a hit on a wall from which a planar method has nothing to map."""
FIRST_SECONDS = 3.0
"""Wall seconds of driving from which the cost of a drive is estimated."""
RESERVED_SHARE, RESERVED_SECONDS = 0.1, 10.0
"""Part of the budget that is left to the page: this share, at most so many seconds."""
_SUCCESS, _FAILURE = math.log(P1 / P0), math.log((1 - P1) / (1 - P0))
_BOUND = math.log((1 - ERROR) / ERROR)

Decision = Literal["works", "does not work", "cannot be driven", "undecided"]
CLASSES: tuple[VerdictClass, ...] = (
    *("not evaluated", "failed", "loses its way", "adds nothing", "path only", "works"),
)
"""Classes of drives from the worst to the best."""


@dataclass(frozen=True)
class SequentialTest:
    """State of Wald's sequential probability ratio test (Ann. Math. Stat. 16, 1945)."""

    successes: int = 0
    failures: int = 0

    @property
    def log_ratio(self) -> float:
        """Logarithm of the likelihood of P1 over that of P0."""
        return self.successes * _SUCCESS + self.failures * _FAILURE

    @property
    def outcome(self) -> Literal["accepted", "rejected"] | None:
        """Outcome of the test; None while more observations are needed."""
        if self.log_ratio >= _BOUND:
            return "accepted"
        return "rejected" if self.log_ratio <= -_BOUND else None

    @property
    def least_more(self) -> int:
        """Smallest number of observations that can decide."""
        if self.outcome is not None:
            return 0
        return min(self.successes_more, math.ceil((self.log_ratio + _BOUND) / -_FAILURE))

    @property
    def successes_more(self) -> int:
        """Number of successes that accept the method."""
        return max(0, math.ceil((_BOUND - self.log_ratio) / _SUCCESS))

    @property
    def total(self) -> int:
        """Number of observations."""
        return self.successes + self.failures

    @property
    def share(self) -> float | None:
        """Share of successes; None without an observation."""
        return self.successes / self.total if self.total else None

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson interval of the share, as for a fixed number of observations."""
        tail = (1 - CONFIDENCE) / 2
        low = betaincinv(self.successes, self.failures + 1, tail) if self.successes else 0.0
        high = betaincinv(self.successes + 1, self.failures, 1 - tail) if self.failures else 1.0
        return float(low), float(high)


@dataclass(frozen=True)
class TrialDrive:
    """Drive of a trial: class and sentence of its verdict, and its folder.

    `reason` is the cause of an early end or that scans see no walls, `extent` the evaluated part of the
    world; path error and driven distance are in meters, None of a drive without result.
    """

    seed: int
    kind: VerdictClass
    reason: str
    sentence: str
    extent: str
    folder: str
    error: float | None = None
    distance: float | None = None


@dataclass(frozen=True)
class Trial:
    """Drives of one config with consecutive seeds, none after the decision.

    The forecast is the probability that a drive works, from before the drives; the obstacle is the reason why
    none can, empty without one.
    """

    config: RunConfig
    drives: tuple[TrialDrive, ...] = ()
    forecast: float | None = None
    obstacle: str = ""

    @property
    def name(self) -> str:
        """Mapper and robot as a sentence names them."""
        attitude = " without attitude" if self.config.attitude == "none" else ""
        return f"{short_name(self.config.mapper)}{attitude} on {self.config.robot}"

    @property
    def test(self) -> SequentialTest:
        """State of the test; drives that were not evaluated do not count."""
        evaluated = [drive.kind == "works" for drive in self.drives if drive.kind != "not evaluated"]
        return SequentialTest(sum(evaluated), len(evaluated) - sum(evaluated))

    @property
    def unevaluated(self) -> int:
        """Number of drives that were not evaluated."""
        return len(self.drives) - self.test.total

    @property
    def decision(self) -> Decision:
        """Result of the drives so far."""
        if self.obstacle:
            return "does not work"
        outcome = self.test.outcome
        if outcome is not None:
            return "works" if outcome == "accepted" else "does not work"
        first = self.drives[:FIRST_DRIVES]
        unevaluated = sum(drive.kind == "not evaluated" for drive in first)
        if len(first) == FIRST_DRIVES and unevaluated > FIRST_DRIVES / 2:
            return "cannot be driven"
        return "undecided"

    @property
    def rank(self) -> int:
        """Place of the median class in CLASSES."""
        if self.obstacle:
            return CLASSES.index("adds nothing")
        return median_low(CLASSES.index(drive.kind) for drive in self.drives)

    @property
    def most_more(self) -> int:
        """Number of drives that decide if all of them work."""
        return self.test.successes_more if self.decision == "undecided" else 0

    def next_configs(self) -> list[RunConfig]:
        """Return configs of the drives that any decision needs next; empty once it is decided."""
        if self.decision != "undecided":
            return []
        count, done = self.test.least_more, len(self.drives)
        if done < FIRST_DRIVES:
            count = min(count, FIRST_DRIVES - done)
        return [replace(self.config, seed=self.config.seed + done + k) for k in range(count)]


@dataclass(frozen=True)
class Change(Trial):
    """Drives with a changed config, until one does no better than the rejected trial.

    Attributes:
        label: Difference in words.
        least: Largest rank of a drive that does no better.
    """

    label: str = ""
    least: int = 0

    @property
    def most_more(self) -> int:
        """Number of drives if all of them do better."""
        better = all(CLASSES.index(drive.kind) > self.least for drive in self.drives)
        return CHANGE_DRIVES - len(self.drives) if better else 0

    @property
    def works(self) -> bool:
        """Whether all of its drives work."""
        return self.test.successes == CHANGE_DRIVES

    def next_configs(self) -> list[RunConfig]:
        """Return the first config, then the others; none once a drive does no better."""
        count, first = self.most_more, self.config.seed + len(self.drives)
        count = count if self.drives else min(count, 1)
        return [replace(self.config, seed=seed) for seed in range(first, first + count)]


@dataclass(frozen=True)
class Answer:
    """Decision on one method in a world, with the changes that were tried.

    `continuation` names the command that goes on where the budget ended; empty if it did not.
    """

    world: str
    trial: Trial
    changes: tuple[Change, ...] = ()
    continuation: str = ""


@dataclass(frozen=True)
class Budget:
    """Wall seconds of the command, and their begin by `time.monotonic`."""

    seconds: float
    begun: float

    @property
    def deadline(self) -> float:
        """Time at which the last drive ends; the rest is left to the page."""
        return self.begun + self.seconds - min(RESERVED_SHARE * self.seconds, RESERVED_SECONDS)


class BudgetEnded(KeyboardInterrupt):
    """Interrupt of drives that would not end in time; engines pass it on like Ctrl-C."""


AnyTrial = TypeVar("AnyTrial", bound=Trial)


class TimedDrives:
    """Drives into a folder, of which those that would end after the deadline are stopped.

    Attributes:
        costs: Wall seconds of a drive by config with seed 0, without the compiler; estimated from its first
            seconds.
        trials: TrialArchive that may need more drives.
    """

    def __init__(self, out: Path, engine: EngineOptions, scenarios: ScenarioCache, budget: Budget) -> None:
        self.costs, self.trials = dict[RunConfig, float](), list[Trial]()
        self._out, self._engine, self._budget = out, engine, budget
        self._executor, self._finished = make_executor(engine, scenarios), dict[str, TrialDrive]()
        self._running, self._ends = dict[str, RunConfig](), dict[str, float]()
        self._driving, self._started = dict[str, tuple[float, float]](), 0.0

    @property
    def at_once(self) -> int:
        """Number of concurrent drives."""
        return self._engine.jobs or (1 if self._engine.address is None else FIRST_DRIVES)

    def fits(self, config: RunConfig) -> bool:
        """Whether a drive is expected to end in time."""
        return time.monotonic() + self.costs.get(key_of(config), 0.0) < self._budget.deadline

    def finish(self, trial: AnyTrial) -> AnyTrial:
        """Return a trial with its finished drives, also those of an earlier command."""
        while configs := trial.next_configs():
            drive = self._find(configs[0])
            if drive is None:
                break
            trial = replace(trial, drives=(*trial.drives, drive))
            test, decided = trial.test, "" if trial.decision == "undecided" else f": {trial.decision}"
            note(f"{drive.folder}: {drive.kind}; {test.successes} of {test.total} worked{decided}")
        return trial

    def _find(self, config: RunConfig) -> TrialDrive | None:
        """Return a finished drive."""
        task = RunTask(config, brief=True)
        if task.name not in self._finished:
            outcome = task.find_outcome(self._out)
            if outcome is None or (self._engine.retry_failed and not outcome.succeeded):
                return None
            self._read(task.name, config)
        return self._finished[task.name]

    def _read(self, name: str, config: RunConfig) -> None:
        """Read the record of a finished drive."""
        entry = read_record(self._out / name)
        sentence, kind = entry["verdict"]["sentence"], entry["verdict"]["class"]
        _, *figures = path_result(entry)
        texts = cause_of(kind, entry), sentence, extent_sentences(entry), name
        self._finished[name] = TrialDrive(config.seed, kind, *texts, *figures)
        self.costs.setdefault(key_of(config), value_at(entry, "rtf.wall_seconds") or 0.0)

    def run(self, configs: Sequence[RunConfig]) -> None:
        """Drive configs at the same time; a drive that is stopped leaves nothing."""
        tasks = [RunTask(config, brief=True) for config in configs]
        sweep = Sweep(tasks, self._out, listed=False, retry_failed=self._engine.retry_failed)
        self._running = {task.name: task.config for task in tasks}
        self._driving, self._ends = {}, dict.fromkeys(self._running, 0.0)
        self._started = time.monotonic()
        outcomes = run_with_progress(sweep, self._executor, watch=self._watch)
        try:
            with interrupt_after(self._budget.deadline - self._started), closing(outcomes):
                for outcome in outcomes:
                    config = self._running[outcome.task]
                    self.costs[key_of(config)] = time.monotonic() - self._started - outcome.compile_seconds
                    del self._ends[outcome.task]
                    self._read(outcome.task, config)
        except KeyboardInterrupt as error:
            if not isinstance(error, BudgetEnded) and time.monotonic() < self._budget.deadline:
                raise  # a person's
            note(f"stopped, as it would not end within the budget: {', '.join(self._ends)}")
        if sweep.unwritten:
            raise OutputError(next(iter(sweep.unwritten.values())))

    def _watch(self, name: str, step: str, share: float) -> None:
        """Predict the end of a drive; stop when no running drive would end in time."""
        now = time.monotonic()
        if step == "drive":
            begun, done = self._driving.setdefault(name, (now, share))
            if now - begun >= FIRST_SECONDS and share > done:
                self._ends[name] = now + (now - begun) * (1 - share) / (share - done)
                self._estimate(key_of(self._running[name]), self._ends[name] - begun)
        if step != "evaluate" and min(self._ends.values()) > self._budget.deadline:
            raise BudgetEnded

    def _estimate(self, key: RunConfig, seconds: float) -> None:
        """Keep the cost of a drive; say once if a decision exceeds the budget."""
        first, self.costs[key] = key not in self.costs, seconds
        for trial in self.trials if first else ():
            need = trial.most_more * seconds / self.at_once
            if key_of(trial.config) == key and self._started + need > self._budget.deadline:
                note(f"{trial.name}: {self.need_text(trial)}: --budget {self.budget_text(trial)}")

    def need_text(self, trial: Trial) -> str:
        """Return drives and time that a trial may still need."""
        count = trial.most_more
        seconds = count * self.costs[key_of(trial.config)] / self.at_once
        return f"{count} {'drive needs' if count == 1 else 'drives need'} {' '.join(duration(seconds))}"

    def budget_text(self, first: Trial) -> str | None:
        """Return the budget that all trials need, else twice this one; None without any."""
        if key_of(first.config) not in self.costs:
            return "".join(duration(2 * self._budget.seconds)) if self._budget.seconds else None
        left = sum(trial.most_more * self.costs.get(key_of(trial.config), 0.0) for trial in self.trials)
        return "".join(duration(time.monotonic() - self._budget.begun + left / self.at_once))


def key_of(config: RunConfig) -> RunConfig:
    """Return a config without its seed."""
    return replace(config, seed=0)


def duration(seconds: float) -> tuple[str, str]:
    """Return a duration, rounded up, and its unit."""
    if seconds <= 60:
        return str(10 * math.ceil(seconds / 10)), "s"
    return (str(math.ceil(seconds / 60)), "min") if seconds <= 5400 else (str(math.ceil(seconds / 3600)), "h")


@dataclass
class Question:
    """Question whether a method works at a site; `changes` is None before the decision."""

    site: DriveSite
    trial: Trial
    changes: list[Change] | None = None

    def advance(self, drives: TimedDrives) -> list[Trial]:
        """Take in finished drives; return the trials that go on."""
        self.trial = drives.finish(self.trial)
        if self.trial.decision == "undecided":
            return [self.trial]
        if self.changes is None:
            self.changes = self._candidates()
        self.changes = [drives.finish(change) for change in self.changes]
        done = any(change.works for change in self.changes)
        return [] if done else [change for change in self.changes if change.most_more]

    def _candidates(self) -> list[Change]:
        """Return the changes that can be driven; none for a method that works."""
        trial, candidates = self.trial, list[Change]()
        short = trial.decision == "cannot be driven"
        if trial.decision == "works" or (short and any(drive.reason for drive in trial.drives)):
            return []
        for label, config in changes(self.site, short=short).items():
            with suppress(WctError):
                check_drivable(config, self.site)
                candidates.append(Change(config, label=label, least=trial.rank))
        return candidates

    def seconds(self, drives: TimedDrives) -> float:
        """Return the wall seconds of its drives."""
        trials = [self.trial, *(self.changes or [])]
        return sum(len(trial.drives) * drives.costs.get(key_of(trial.config), 0.0) for trial in trials)

    def answer(self, drives: TimedDrives, again: Callable[[str | None], str]) -> Answer:
        """Return the answer; `again` gives the command with another budget."""
        left, tried = self.advance(drives), tuple(c for c in self.changes or () if c.drives)
        continuation = ""
        if left and not any(change.rank > change.least for change in tried):
            known = key_of(left[0].config) in drives.costs
            command = f"`{again(drives.budget_text(left[0]))}`"
            continuation = f"{drives.need_text(left[0])}: {command}" if known else f"{command} continues"
            if isinstance(left[0], Change):
                continuation = f"{left[0].label} was not decided: {continuation}"
        return Answer(self.site.world.name, self.trial, tried, continuation)


def decide(
    configs: Sequence[RunConfig],
    out: Path,
    engine: EngineOptions,
    budget: Budget,
    *,
    scenarios: ScenarioCache,
    again: Callable[[str | None], str] = lambda budget: "the same command",
) -> tuple[Answer, ...]:
    """Forecast; drive in turn until each method is decided, then its changes; conclude.

    There is one config per method and world, from whose seed on seeds count up. The one with the least time
    so far advances. `again` returns the command with another budget.
    """
    questions = [ask(config, scenarios) for config in configs]
    drives = TimedDrives(out, engine, scenarios, budget)
    while batch := next_drives(questions, drives):
        drives.run(batch)
    return tuple(question.answer(drives, again) for question in questions)


def ask(config: RunConfig, scenarios: ScenarioCache) -> Question:
    """Look at a site and forecast; refuse what cannot be driven there."""
    site = DriveSite(scenarios.scenario(config).world, config)
    check_drivable(config, site)
    trial = Trial(config, (), forecast(site.features(), config), _obstacle(site))
    if trial.obstacle:
        note(f"{trial.name} does not work: {trial.obstacle}")
    elif trial.forecast is None:
        note(f"forecast: none for {trial.name} (only for methods and sensors of the study)")
    else:
        note(f"forecast: {trial.name} works in {100 * trial.forecast:.0f} % of the drives")
    return Question(site, trial)


def check_drivable(config: RunConfig, site: DriveSite) -> None:
    """Refuse a config that cannot be driven: its names, files and start."""
    RunTask(config).check()
    make_driver(site.world, make_robot(config.robot), replace(config, seconds=1.0), _no_map)


def _no_map() -> OccupancyGrid:
    raise NotImplementedError("no mapper runs while starts are checked")


def _obstacle(site: DriveSite) -> str:
    """Return why a planar method has nothing to map; empty if it has."""
    config, blind = site.config, 1 - site.features().wall_scans
    if config.mapper not in MAPPERS or blind < MIN_BLIND_SCANS:
        return ""
    reach = make_lidar_preset(config.lidar or make_robot(config.robot).lidar).range_max
    return f"{100 * blind:.0f} % of the scans along its tours meet no wall within {reach:g} m"


def next_drives(questions: Sequence[Question], drives: TimedDrives) -> list[RunConfig]:
    """Return the next concurrent drives: those of the question with the least time first."""
    waiting = [(question.advance(drives), question.seconds(drives)) for question in questions]
    in_turn = [trials for trials, _ in sorted(waiting, key=itemgetter(1))]
    drives.trials = [trial for trials in in_turn for trial in trials]
    configs = [[config for trial in trials for config in trial.next_configs()] for trials in in_turn]
    mixed = dict.fromkeys(config for turn in zip_longest(*configs) for config in turn if config is not None)
    return list(filter(drives.fits, mixed))[: drives.at_once]
