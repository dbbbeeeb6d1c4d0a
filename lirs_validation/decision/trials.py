"""Drives of one method in one world until the sequential test decides."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from scipy.special import betaincinv  # imports in a third of the time of scipy.stats

from lirs_validation.config import RunConfig
from lirs_validation.metrics.verdict import VerdictClass
from lirs_validation.record.run_record import read_record
from lirs_validation.record.verdict import cause_of, extent_sentences, judge
from lirs_validation.sweep.experiment import Outcome, SlamExperiment
from lirs_validation.sweep.sweep import Sweep
from lirs_wct import OutputError

P0, P1 = 0.65, 0.90
"""Shares of successes: the test rejects a method at P0 and accepts one at P1 ..."""
ERROR = 0.05
"""... with at most this share of errors each."""
CONFIDENCE = 0.95


@dataclass(frozen=True)
class SequentialTest:
    """State of Wald's sequential probability ratio test (Ann. Math. Stat. 16, 1945).

    Attributes:
        successes: Number of successes so far.
        failures: Number of failures so far.
    """

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
    def share(self) -> float | None:
        """Share of successes; None without an observation."""
        total = self.successes + self.failures
        return self.successes / total if total else None

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson interval of the share, as for a fixed number of observations."""
        tail = (1 - CONFIDENCE) / 2
        low = betaincinv(self.successes, self.failures + 1, tail) if self.successes else 0.0
        high = betaincinv(self.successes + 1, self.failures, 1 - tail) if self.failures else 1.0
        return float(low), float(high)


_SUCCESS, _FAILURE = math.log(P1 / P0), math.log((1 - P1) / (1 - P0))
_BOUND = math.log((1 - ERROR) / ERROR)


FIRST = 10
"""Drives after which a terrain counts as impassable if most of them were not evaluated."""

Decision = Literal["works", "does not work", "cannot be driven", "undecided"]


@dataclass(frozen=True)
class TrialDrive:
    """One drive of a trial.

    Attributes:
        seed: of its start, its tour and its sensors.
        kind: class of its verdict.
        reason: why it ended early, or that its scans see no walls; empty if neither.
        sentence: of its verdict.
        extent: sentences on the evaluated part of the world; empty if it is the whole.
        folder: name of its folder.
    """

    seed: int
    kind: VerdictClass
    reason: str
    sentence: str
    extent: str
    folder: str


@dataclass(frozen=True)
class Trial:
    """Drives of one config, with seeds one after the other.

    Attributes:
        config: of the first drive.
        drives: in the order of their seeds, without those after the decision.
        forecast: probability that a drive works, from before the drives; None without one.
    """

    config: RunConfig
    drives: tuple[TrialDrive, ...] = ()
    forecast: float | None = None

    @property
    def test(self) -> SequentialTest:
        """State of the test; drives that were not evaluated do not count."""
        evaluated = [drive.kind == "works" for drive in self.drives if drive.kind != "not evaluated"]
        return SequentialTest(sum(evaluated), len(evaluated) - sum(evaluated))

    @property
    def unevaluated(self) -> int:
        """Number of drives that were not evaluated."""
        return sum(drive.kind == "not evaluated" for drive in self.drives)

    @property
    def extents(self) -> tuple[str, ...]:
        """Sentences on the evaluated part of the world, without repetitions."""
        return tuple(dict.fromkeys(drive.extent for drive in self.drives if drive.extent))

    @property
    def decision(self) -> Decision:
        """Result of the drives so far."""
        outcome = self.test.outcome
        if outcome is not None:
            return "works" if outcome == "accepted" else "does not work"
        first = self.drives[:FIRST]
        if len(first) == FIRST and sum(drive.kind == "not evaluated" for drive in first) > FIRST / 2:
            return "cannot be driven"
        return "undecided"

    def next_configs(self) -> list[RunConfig]:
        """Return configs of the drives that any decision needs next; empty once it is decided."""
        if self.decision != "undecided":
            return []
        count, done = self.test.least_more, len(self.drives)
        if done < FIRST:
            count = min(count, FIRST - done)
        return [replace(self.config, seed=self.config.seed + done + k) for k in range(count)]


Perform = Callable[[Sweep], Generator[Outcome]]
"""Function that runs a sweep and yields its outcomes."""


def run_trials(
    trials: Sequence[Trial],
    out: Path,
    perform: Perform,
    *,
    deadline: float,
    report: Callable[[Trial], None],
    retry_failed: bool = False,
) -> tuple[Trial, ...]:
    """Drive trials until each is decided or the time is over.

    Args:
        trials: their configs differ.
        out: folder of the drives' folders; drives that are there already are not repeated.
        perform: runs the drives.
        deadline: time of `time.monotonic` after which no drive begins.
        report: called with a trial after each of its drives.
        retry_failed: repeat drives that are there already and failed.

    Raises:
        WctError: a drive cannot be performed as its config asks, or not be written.
    """
    done = list(trials)
    while time.monotonic() < deadline:
        configs = [config for trial in done for config in trial.next_configs()]
        if not configs:
            break
        sweep = Sweep(
            [SlamExperiment(config, brief=True) for config in configs],
            out,
            listed=False,
            retry_failed=retry_failed,
        )
        done = [_with_results(trial, out, sweep, report) for trial in done]
        with closing(perform(sweep)) as outcomes:
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
        name = SlamExperiment(configs[0]).name
        if name not in sweep.outcomes:
            break
        entry = read_record(out / name)
        verdict = judge(entry)
        reason, extent = cause_of(verdict.kind, entry), extent_sentences(entry)
        drive = TrialDrive(configs[0].seed, verdict.kind, reason, str(verdict), extent, name)
        trial = replace(trial, drives=(*trial.drives, drive))
        report(trial)
    return trial
