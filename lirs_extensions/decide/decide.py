"""Decision: does a method work on a terrain? Drive until a sequential test decides, then try changes."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

from scipy.special import betaincinv  # imports in a third of the time of scipy.stats

from lirs_envs.lidar.presets import LIDARS, make_lidar_preset
from lirs_envs.robots.robot import make_robot
from lirs_extensions.decide.forecast import forecast
from lirs_validation.analysis.compare import ORIGINAL
from lirs_validation.cli.progress import run_with_progress
from lirs_validation.config import EngineOptions, RunConfig
from lirs_validation.driving.choice import make_driver
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.record.run_record import read_record
from lirs_validation.record.verdict import VerdictClass, cause_of, extent_sentences
from lirs_validation.sweep.sweep import Sweep
from lirs_validation.sweep.tasks import RunTask, make_executor
from lirs_wct import OccupancyGrid, OutputError
from slam_baselines.mapper import MAPPERS, short_name

P0, P1 = 0.65, 0.90
"""Shares of successes: the test rejects a method at P0 and accepts one at P1 ..."""
ERROR = 0.05
"""... with at most this share of errors each."""
CONFIDENCE = 0.95
PROMISED_SHARE = 0.8
"""Share of drives that a sentence promises if the whole interval lies above it."""
FIRST_DRIVES = 10
"""Drives after which a terrain counts as impassable if most of them were not evaluated."""
_SUCCESS, _FAILURE = math.log(P1 / P0), math.log((1 - P1) / (1 - P0))
_BOUND = math.log((1 - ERROR) / ERROR)

Decision = Literal["works", "does not work", "cannot be driven", "undecided"]


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
        up = math.ceil((_BOUND - self.log_ratio) / _SUCCESS)
        return min(up, math.ceil((self.log_ratio + _BOUND) / -_FAILURE))

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
    """One drive of a trial: class and sentence of its verdict, and the name of its folder.

    `reason` is the cause of an early end or that scans see no walls, `extent` the evaluated part of the
    world.
    """

    seed: int
    kind: VerdictClass
    reason: str
    sentence: str
    extent: str
    folder: str


@dataclass(frozen=True)
class Trial:
    """Drives of one config with consecutive seeds, none after the decision.

    The forecast is the probability that a drive works, from before the drives.
    """

    config: RunConfig
    drives: tuple[TrialDrive, ...] = ()
    forecast: float | None = None

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
        outcome = self.test.outcome
        if outcome is not None:
            return "works" if outcome == "accepted" else "does not work"
        first = self.drives[:FIRST_DRIVES]
        unevaluated = sum(drive.kind == "not evaluated" for drive in first)
        if len(first) == FIRST_DRIVES and unevaluated > FIRST_DRIVES / 2:
            return "cannot be driven"
        return "undecided"

    def next_configs(self) -> list[RunConfig]:
        """Return configs of the drives that any decision needs next; empty once it is decided."""
        if self.decision != "undecided":
            return []
        count, done = self.test.least_more, len(self.drives)
        if done < FIRST_DRIVES:
            count = min(count, FIRST_DRIVES - done)
        return [replace(self.config, seed=self.config.seed + done + k) for k in range(count)]

    def to_dict(self) -> dict[str, Any]:
        """Return the trial as JSON stores it."""
        return {
            "robot": self.config.robot,
            "mapper": self.config.mapper,
            "forecast": self.forecast,
            "decision": self.decision,
            "share": self.test.share,
            "interval": list(self.test.interval),
            "drives": [asdict(drive) for drive in self.drives],
        }


@dataclass(frozen=True)
class Answer:
    """Decision on one method in a world, with labels of changes and their drives."""

    world: str
    trial: Trial
    changed: tuple[tuple[str, Trial], ...] = ()

    @property
    def sentence(self) -> str:
        """Conclusion for the user, with share and interval."""
        trial, decision = self.trial, self.trial.decision
        if decision == "cannot be driven":
            return self._impassable_text()
        lead = "is undecided on" if decision == "undecided" else f"{decision} on"
        parts = [f"{trial.name} {lead} {self.world}: {_share_text(trial.test)}."]
        if decision == "works" and trial.test.interval[0] >= PROMISED_SHARE:
            parts.append(f"It works in at least {100 * PROMISED_SHARE:.0f} % of the drives.")
        if decision == "undecided":
            parts.append("The budget ended before a decision.")
            if trial.forecast is not None:
                expected = f"{100 * trial.forecast:.0f} %"
                parts.append(f"The forecast is that it works in {expected} of the drives.")
        parts += [
            _failures_text(trial),
            self._changes_text(),
            *dict.fromkeys(drive.extent for drive in trial.drives),
        ]
        return " ".join(part for part in parts if part)

    def to_dict(self) -> dict[str, Any]:
        """Return the answer as JSON stores it."""
        changes = [{"change": label} | trial.to_dict() for label, trial in self.changed]
        return {"world": self.world, "sentence": self.sentence, "changes": changes} | self.trial.to_dict()

    def _impassable_text(self) -> str:
        """Return why most drives were not evaluated: they ended early, or were too short."""
        trial, robot = self.trial, self.trial.config.robot
        count = f"{trial.unevaluated} of {len(trial.drives)} drives were not evaluated"
        ended = Counter(d.reason for d in trial.drives if d.kind == "not evaluated" and d.reason)
        if not ended:
            return f"{robot} drives too short a path on {self.world}: {count}; raise --seconds."
        reason, often = ended.most_common(1)[0]
        return f"{robot} cannot drive {self.world}: {count}; most often ({often}): {reason}."

    def _changes_text(self) -> str:
        """Return the changes that reverse the decision; empty without one."""
        reverse, verb = ("does not work", "fails") if self.trial.decision == "works" else ("works", "works")
        reversing = [
            f"{'' if label.startswith(('with ', 'without ')) else 'with '}{label} "
            f"({trial.test.successes} of {trial.test.total})"
            for label, trial in self.changed
            if trial.decision == reverse
        ]
        return f"It {verb} {', '.join(reversing)}." if reversing else ""


def decide(
    configs: Sequence[RunConfig],
    out: Path,
    engine: EngineOptions,
    *,
    budget: float,
    report: Callable[[Trial], None] = lambda trial: None,
) -> tuple[Answer, ...]:
    """Drive every config until its method is decided, then its changes (see `run_trials`).

    There is one config per method and world, from whose seed on seeds count up. The budget is wall seconds;
    `report` gets a method's trial before its drives, and any trial after each drive.
    """
    deadline, scenarios = time.monotonic() + budget, ScenarioCache()
    worlds, planned = list[str](), list[Trial]()
    for config in configs:
        world, robot = scenarios.scenario(config).world, make_robot(config.robot)
        make_driver(world, robot, replace(config, seconds=1.0), _no_map)  # finds a start, or refuses
        worlds.append(world.name)
        planned.append(Trial(config, forecast=forecast(world, robot, config)))
    for trial in planned:
        report(trial)
    trials = run_trials(planned, out, engine, deadline=deadline, report=report)
    variants = [
        (k, label, config)
        for k, trial in enumerate(trials)
        if trial.decision in ("works", "does not work")
        for label, config in changes(trial.config, works=trial.decision == "works").items()
    ]
    tried = run_trials(
        [Trial(config) for *_, config in variants], out, engine, deadline=deadline, report=report
    )
    changed: list[list[tuple[str, Trial]]] = [[] for _ in trials]
    for (k, label, _), trial in zip(variants, tried, strict=True):
        if trial.drives:
            changed[k].append((label, trial))
    return tuple(map(Answer, worlds, trials, map(tuple, changed)))


def _no_map() -> OccupancyGrid:
    raise NotImplementedError("no mapper runs while starts are checked")


def run_trials(
    trials: Sequence[Trial],
    out: Path,
    engine: EngineOptions,
    *,
    deadline: float,
    report: Callable[[Trial], None],
) -> tuple[Trial, ...]:
    """Drive trials with different configs until each is decided, or the deadline.

    Drives that are in the folder already are not repeated; `report` gets a trial after each of its drives.
    """
    done, executor = list(trials), make_executor(engine)
    while time.monotonic() < deadline:
        drives = [RunTask(c, brief=True) for trial in done for c in trial.next_configs()]
        if not drives:
            break
        sweep = Sweep(drives, out, listed=False, retry_failed=engine.retry_failed)
        done = [_with_results(trial, out, sweep, report) for trial in done]
        with closing(run_with_progress(sweep, executor)) as outcomes:
            for _ in outcomes:
                done = [_with_results(trial, out, sweep, report) for trial in done]
                if time.monotonic() > deadline:
                    break
        if sweep.unwritten:
            raise OutputError(next(iter(sweep.unwritten.values())))
    return tuple(done)


def _with_results(trial: Trial, out: Path, sweep: Sweep, report: Callable[[Trial], None]) -> Trial:
    """Return a trial with the drives that are finished, in the order of their seeds."""
    while configs := trial.next_configs():
        name = RunTask(configs[0]).name
        if name not in sweep.outcomes:
            break
        entry = read_record(out / name)
        verdict = entry["verdict"]
        kind, sentence = verdict["class"], verdict["sentence"]
        reason, extent = cause_of(kind, entry), extent_sentences(entry)
        drive = TrialDrive(configs[0].seed, kind, reason, sentence, extent, name)
        trial = replace(trial, drives=(*trial.drives, drive))
        report(trial)
    return trial


def _share_text(test: SequentialTest) -> str:
    """Return share and interval of the drives that worked."""
    if not test.total:
        return "no drive was evaluated"
    low, high = test.interval
    return (
        f"it worked in {test.successes} of {test.total} drives ({100 * test.successes / test.total:.0f} %, "
        f"{100 * CONFIDENCE:.0f} % interval {100 * low:.0f} to {100 * high:.0f} %)"
    )


def _failures_text(trial: Trial) -> str:
    """Return the most frequent failure with an example; empty without one."""
    failed = [drive for drive in trial.drives if drive.kind not in ("works", "not evaluated")]
    if not failed:
        return ""
    kind, count = Counter(drive.kind for drive in failed).most_common(1)[0]
    example = next(drive for drive in failed if drive.kind == kind)
    cause = f": {example.reason.rstrip('.')}" if example.reason else ""
    return f"Most frequent failure: {kind} ({count} of {len(failed)}), as with seed {example.seed}{cause}."


def changes(config: RunConfig, *, works: bool) -> dict[str, RunConfig]:
    """Return labels and configs of changes that may reverse whether a method works."""
    word, factor = ("twice", 2.0) if works else ("half", 0.5)
    odometry = replace(config, odometry_noise=config.odometry_noise * factor)
    return {
        **_attitude_change(config),
        **_lidar_change(config, works=works),
        f"{word} the odometry noise": odometry,
    }


def _attitude_change(config: RunConfig) -> dict[str, RunConfig]:
    """Return the run with the IMU's attitude, or without it.

    Methods as published do not use it: their terrain-aware version does. Mappers of clouds do not need it.
    """
    aware = config.mapper.removesuffix(ORIGINAL)
    if aware != config.mapper and aware in MAPPERS:
        return {f"terrain-aware {aware}": replace(config, mapper=aware, attitude="imu")}
    if config.mapper not in MAPPERS:
        return {}
    if config.attitude == "imu":
        return {"without IMU attitude": replace(config, attitude="none")}
    return {"with IMU attitude": replace(config, attitude="imu")}


def _lidar_change(config: RunConfig, *, works: bool) -> dict[str, RunConfig]:
    """Return the run with the next longer lidar, or shorter if it works."""
    own = make_lidar_preset(config.lidar or make_robot(config.robot).lidar)
    others = [preset for preset in map(make_lidar_preset, LIDARS) if preset.rings == own.rings]
    reach = attrgetter("range_max")
    if works:
        chosen = max((p for p in others if reach(p) < own.range_max), key=reach, default=None)
    else:
        chosen = min((p for p in others if reach(p) > own.range_max), key=reach, default=None)
    if chosen is None:
        return {}
    return {f"lidar {chosen.name} ({chosen.range_max:g} m)": replace(config, lidar=chosen.name)}
