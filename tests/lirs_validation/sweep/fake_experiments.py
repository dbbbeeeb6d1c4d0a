"""Experiments that take no time, and experiments that behave badly in every way that a mapper can."""

import errno
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.sweep.sweep import Outcome, SweepTask
from lirs_wct.files import atomic_folder
from lirs_wct.progress import Progress

Manner = Literal["good", "raises", "hangs", "dies", "dies once", "no room once", "no room", "interrupts"]


@dataclass(frozen=True)
class FakeExperiment:
    """An experiment that notes in `notes` that it was run, by whom, and then behaves as it is told to."""

    name: str
    notes: str
    manner: Manner = "good"
    seconds: float = 0.0

    @property
    def world_config(self) -> RunConfig:
        return RunConfig(source="simple")

    @property
    def runs(self) -> list[int]:
        """Processes that ran it, one a line."""
        path = Path(self.notes) / self.name
        return [int(line) for line in path.read_text().split()] if path.exists() else []

    def check(self) -> None:
        return

    attempt = SweepTask.attempt  # type: ignore[assignment]

    def run(self, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool) -> Outcome:
        first = not self.runs
        with (Path(self.notes) / self.name).open("a") as file:
            file.write(f"{os.getpid()}\n")
        progress("drive", 0.5)
        time.sleep(self.seconds)
        with atomic_folder(out / self.name) as folder:
            (folder / "result").write_text(f"{self.name} {concurrent}")
            self._behave(first)
        return Outcome(task=self.name, status="ok", written=True)

    def _behave(self, first: bool) -> None:
        match self.manner:
            case "raises":
                raise IndexError("list index\nout of range")
            case "hangs":
                time.sleep(1000)
            case "interrupts":
                raise KeyboardInterrupt
        if self.manner == "dies" or (self.manner == "dies once" and first):
            os.kill(os.getpid(), signal.SIGKILL)
        if self.manner == "no room" or (self.manner == "no room once" and first):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def write_failure(self, out: Path, outcome: Outcome) -> None:
        with atomic_folder(out / self.name) as folder:
            (folder / "failed").write_text(f"{outcome.status}\n{outcome.reason}\n{outcome.trace}")

    def find_outcome(self, out: Path) -> Outcome | None:
        folder = out / self.name
        if (folder / "result").exists():
            return Outcome(task=self.name, status="ok", written=True)
        if (folder / "failed").exists():
            status, reason = (folder / "failed").read_text().splitlines()[:2]
            return Outcome(task=self.name, status=status, reason=reason, written=True)  # type: ignore[arg-type]
        return None

    def describe(self) -> dict[str, Any]:
        return {"name": self.name}
