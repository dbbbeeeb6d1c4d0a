"""What a sweep costs beside its experiments: time each, and share of a real one's time.

    python benchmarks/sweep.py [--cells 1000] [--seconds 120] [--real 12] [--quick]

Experiments that only write a record of full size are put through everything that `validate` does; what is
left after their own time is the suite's. Then real experiments are run by one process and by two, in turns,
the processes' start included.
"""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

from rich.console import Console

from benchmarks.steps import arguments
from lirs_validation import RunConfig, RunRecord, validate
from lirs_validation.cli.progress import run_with_progress
from lirs_validation.experiment.run import Run
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.record.run_record import RECORD
from lirs_validation.sweep.engines import Processes
from lirs_validation.sweep.sweep import Outcome, Serial, Sweep
from lirs_validation.sweep.tasks import RunTask
from lirs_wct.files import MANIFEST, atomic_folder
from lirs_wct.progress import Progress, no_progress

LIMIT = 0.02
"""Share of the experiments' time that the suite may take."""
SPEEDUP, TURNS = 1.8, 2
"""Times as many experiments a minute that two processes are to do; how often each number takes its turn."""


@dataclass(frozen=True)
class QuickExperiment(RunTask):
    """An experiment that leaves the files of a real run, and notes the seconds that this took."""

    template: RunRecord | None = None
    left: str = ""
    spent: str = ""

    def run(self, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool) -> Outcome:
        """Link the files, and write the record."""
        assert self.template is not None
        for second in range(int(self.config.seconds)):
            progress("drive", second / self.config.seconds)
        begun = time.perf_counter()
        record = replace(self.template, config=self.config)
        with atomic_folder(out / self.name) as folder:
            for file in Path(self.left).iterdir():
                if file.name not in (RECORD, MANIFEST):
                    os.link(file, folder / file.name)
            record.save(folder)
        with Path(self.spent).open("a", encoding="utf-8") as times:
            times.write(f"{time.perf_counter() - begun}\n")
        return Outcome(task=self.name, status="ok", written=True)


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, cells=1000, seconds=120.0, real=12, quick=False)
    count, seconds = (100, 20.0) if given.quick else (given.cells, given.seconds)
    with tempfile.TemporaryDirectory() as folder:
        validate("simple", seconds=1.0)  # compiles
        begun = time.perf_counter()
        run = validate("simple", seconds=seconds, out=Path(folder) / "real")
        real = time.perf_counter() - begun
        overhead = suite_seconds(run, count, Path(folder) / "swept")
    print(
        f"{count} experiments, {1e3 * overhead:.1f} ms of the suite for each = "
        f"{overhead / real:.2%} of a real experiment of {real:.1f} s (limit {LIMIT:.0%})"
    )
    one, two = throughput(given.real, seconds)
    print(
        f"{given.real} real experiments of {seconds:g} s: {one:.1f} a minute by one process, "
        f"{two:.1f} by two = {two / one:.2f} x (limit {SPEEDUP:g})"
    )


def throughput(count: int, seconds: float) -> tuple[float, ...]:
    """Return real experiments a minute by one process and by two, the best of their turns."""
    experiments = [RunTask(RunConfig(source="medium", seconds=seconds, seed=seed)) for seed in range(count)]
    best = {1: 0.0, 2: 0.0}
    for jobs in TURNS * tuple(best):
        with tempfile.TemporaryDirectory() as folder:
            begun = time.perf_counter()
            outcomes = list(Processes(jobs=jobs).run(experiments, Path(folder), lambda name: no_progress))
            spent = time.perf_counter() - begun
        assert not {"error", "timeout"} & {outcome.status for outcome in outcomes}
        best[jobs] = max(best[jobs], 60.0 * count / spent)
    return tuple(best.values())


def suite_seconds(real: Run, count: int, out: Path) -> float:
    """Put experiments through a sweep; return the seconds of the suite for each."""
    out.mkdir()
    spent = out / "spent.txt"
    config = replace(real.record.config, seconds=120.0)
    experiments = [
        QuickExperiment(
            replace(config, seed=seed), template=real.record, left=str(real.folder), spent=str(spent)
        )
        for seed in range(count)
    ]
    begun = time.perf_counter()
    with (out / "screen.txt").open("w", encoding="utf-8") as screen:
        console = Console(file=screen, force_terminal=True)
        for _ in run_with_progress(Sweep(experiments, out / "out"), Serial(), console):
            pass
    whole = time.perf_counter() - begun
    own = sum(float(line) for line in spent.read_text(encoding="utf-8").split())
    return max(0.0, whole - own) / count


if __name__ == "__main__":
    import_module(Path(__file__).stem).main()  # workers import the experiments by the name of their module
