"""Workers that do many jobs, and jobs that fail."""

import os
from dataclasses import dataclass
from pathlib import Path

import pytest

from lirs_extensions.search.case_search import TrialArchive
from lirs_validation.sweep.workers import WorkerPool
from lirs_wct.errors import ConfigError, WctError
from lirs_wct.progress import Progress


@dataclass(frozen=True)
class Halve:
    """A job that returns half a number and its process, and raises for odd ones."""

    number: int

    def __call__(self, progress: Progress) -> tuple[int, int]:
        if self.number % 2:
            raise ConfigError(f"{self.number}: is odd")
        return self.number // 2, os.getpid()


@dataclass(frozen=True)
class Loss:
    """A score of a search."""

    loss: float


def measure(number: int) -> Loss:
    return Loss(number / 4)


def die(number: int) -> Loss:
    os._exit(3)


@pytest.mark.slow
def test_a_worker_does_many_jobs_and_an_error_is_raised() -> None:
    with WorkerPool(1) as pool:
        ended = dict(pool.run([Halve(4), Halve(8)]))
        assert [half for half, _ in ended.values()] == [2, 4]  # type: ignore[misc]
        with pytest.raises(ConfigError, match=r"^3: is odd\n") as raised:
            list(pool.run([Halve(3), Halve(6)]))
        assert "test_workers.py" in raised.value.__notes__[0]
        assert len({pid for _, pid in (*ended.values(), *dict(pool.run([Halve(2)])).values())}) == 1  # type: ignore[misc]


@pytest.mark.slow
def test_a_search_keeps_the_order_of_its_trials_in_processes(tmp_path: Path) -> None:
    trials = [(f"{k}", (k,)) for k in range(8)]
    alone = TrialArchive(tmp_path / "alone.jsonl", Loss)
    with WorkerPool(2) as pool:
        shared = TrialArchive(tmp_path / "shared.jsonl", Loss, pool)
        assert shared.scores(measure, trials, "hector") == alone.scores(measure, trials, "hector")
        with pytest.raises(WctError, match="a process that drove hector died; the same command continues"):
            shared.scores(die, [("9", (9,))], "hector")
    assert (tmp_path / "shared.jsonl").read_bytes() == (tmp_path / "alone.jsonl").read_bytes()
