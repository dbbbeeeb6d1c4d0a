"""The engine of many processes on one machine: one that is killed, hangs or leaks costs its own run only."""

from __future__ import annotations

import os
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import wait
from pathlib import Path

from lirs_validation.experiment.scenario import Scenario
from lirs_validation.sweep.engines.base import Limits, ProgressOf
from lirs_validation.sweep.engines.worker import Job, Worker
from lirs_validation.sweep.experiment import Experiment
from lirs_validation.sweep.outcome import Outcome
from lirs_wct.files import remove_leftovers

TRIES = 2
"""An experiment whose process dies is given another one; not a third."""
LONGEST_WAIT = 3600.0
"""Seconds; the system cannot wait for weeks."""


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True, kw_only=True)
class Processes:
    """Experiments in processes of their own, `jobs` at a time.

    Attributes:
        jobs: how many at a time; with one, its real-time factors count as those of `Serial` do.
        limits: of an experiment.
        scenario: a world that was built elsewhere.
        concurrent: whether others work beside this engine too.
    """

    jobs: int
    limits: Limits = field(default_factory=Limits)
    scenario: Scenario | None = None
    concurrent: bool = False

    def run(self, experiments: Sequence[Experiment], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run experiments into folders of `out`."""
        pool = _Pool(self, experiments, out, progress_of)
        try:
            yield from pool.outcomes()
        finally:
            pool.stop()


class _Pool:
    """The workers of one sweep and what each of them is at."""

    def __init__(
        self, engine: Processes, experiments: Sequence[Experiment], out: Path, progress_of: ProgressOf
    ) -> None:
        self._engine, self._out, self._progress_of = engine, out, progress_of
        self._waiting = deque(experiments)
        self._tries: Counter[str] = Counter()
        self._workers: list[Worker] = []

    def outcomes(self) -> Iterator[Outcome]:
        """Yield each experiment's outcome as it ends."""
        while self._waiting or self._busy:
            self._hand_out()
            for worker in self._talking():
                outcome = self._listen(worker)
                if outcome is not None:
                    yield outcome
            for worker in [w for w in self._busy if w.left() == 0.0]:
                yield self._give_up(worker)

    def stop(self) -> None:
        """End every process; they tidy up beside each other."""
        for worker in self._workers:
            worker.ask_to_end()
        while self._workers:
            self._dismiss(self._workers[-1])

    @property
    def _busy(self) -> list[Worker]:
        return [worker for worker in self._workers if worker.job is not None]

    def _hand_out(self) -> None:
        """Give every idle worker an experiment, and make workers while there are too few."""
        while self._waiting and len(self._busy) < self._engine.jobs:
            idle = [worker for worker in self._workers if worker.job is None]
            if not idle:
                idle.append(Worker(self._engine.limits))
                self._workers.append(idle[0])
            concurrent = self._engine.concurrent or self._engine.jobs > 1
            idle[0].begin(Job(self._waiting.popleft(), self._out, concurrent, self._engine.scenario))

    def _talking(self) -> list[Worker]:
        """Wait until a worker speaks or dies, or until one's time is over."""
        left = [seconds for w in self._busy if (seconds := w.left()) is not None]
        ready = wait([w.pipe for w in self._busy], min([*left, LONGEST_WAIT]))
        return [worker for worker in self._busy if worker.pipe in ready]

    def _listen(self, worker: Worker) -> Outcome | None:
        assert worker.job is not None
        name = worker.job.experiment.name
        try:
            message = worker.pipe.recv()
        except (EOFError, OSError):
            return self._handle_crash(worker)
        match message:
            case ("begun",):
                worker.began()
            case ("progress", step, share):
                self._progress_of(name)(step, share)
            case ("done", Outcome() as outcome):
                worker.job = None
                if outcome.status == "error":  # what it leaked goes with it
                    self._dismiss(worker)
                return outcome
        return None

    def _handle_crash(self, worker: Worker) -> Outcome | None:
        """Give the experiment of a dead worker to another one, or give it up."""
        assert worker.job is not None
        experiment, cause, trace = worker.job.experiment, worker.cause_of_death(), worker.where()
        self._dismiss(worker)
        self._tries[experiment.name] += 1
        if self._tries[experiment.name] < TRIES:
            self._waiting.appendleft(experiment)
            return None
        reason = f"the process that ran it died {TRIES} times ({cause})"
        return Outcome(experiment=experiment.name, status="error", reason=reason, trace=trace)

    def _give_up(self, worker: Worker) -> Outcome:
        assert worker.job is not None
        experiment, trace = worker.job.experiment, worker.where()
        self._dismiss(worker)
        reason = f"no end within the experiment's {self._engine.limits.seconds:g} s"
        return Outcome(experiment=experiment.name, status="timeout", reason=reason, trace=trace)

    def _dismiss(self, worker: Worker) -> None:
        self._workers.remove(worker)
        worker.stop()
        if worker.job is not None:
            remove_leftovers([self._out / worker.job.experiment.name])
