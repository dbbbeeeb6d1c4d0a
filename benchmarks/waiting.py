"""What a user waits for: whole commands, of this checkout and of a peer's in turn.

    python benchmarks/waiting.py [--peer FOLDER] [--runs 5] [--only ROW,...]

The peer is another checkout with a .venv, such as an older version in a worktree. Medians of whole processes
on one core, on two for `map` and `jobs`. `help`, `info`, `build`, `validate` and `map` are seconds of a
clock. `demo` is that of the three runs of `make demo` with an empty cache of Numba's, and `compile` the
processor seconds of one simulated second of `hector` with such a cache. `verdict` is processor seconds for
60 s of its drives, start-up included. `jobs` is runs of 60 s a minute with `--jobs 2`. `info` and `build`
take smooth hills of 1025 x 1025 pixels.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.steps import arguments

ROOT = Path(__file__).resolve().parents[1]
BUDGET = "60s"


@dataclass(frozen=True)
class Checkout:
    """A checkout with its virtual environment."""

    folder: Path

    def run(self, words: str, *, cores: int = 1, cache: Path | None = None) -> tuple[float, float, str]:
        """Run `lirs-wct WORDS`; return clock and processor seconds, and what it printed."""
        env = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        env |= {} if cache is None else {"NUMBA_CACHE_DIR": str(cache)}
        command = [str(self.folder / ".venv/bin/lirs-wct"), *words.split()]
        chosen = sorted(os.sched_getaffinity(0))[:cores]
        before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        done = subprocess.run(
            command,
            cwd=self.folder,
            env=env,
            check=True,
            capture_output=True,
            text=True,
            preexec_fn=lambda: os.sched_setaffinity(0, chosen),
        )
        seconds, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return seconds, cpu, done.stdout


Row = Callable[[Checkout, Path], float]
"""Measures a checkout once, with an empty folder."""


def clock(words: str, cores: int = 1) -> Row:
    """Return the row of a command's seconds; OUT stands for the folder, PICTURE for one beside it."""

    def seconds(checkout: Checkout, out: Path) -> float:
        picture = out.with_name("hills.png")
        write_picture(picture)
        return checkout.run(words.replace("OUT", str(out)).replace("PICTURE", str(picture)), cores=cores)[0]

    return seconds


def demo(checkout: Checkout, out: Path) -> float:
    """Return the seconds of the runs of `make demo` with an empty cache."""
    words = f"validate simple medium advanced --robot husky --mapper hector --seconds 120 --seed 1 -o {out}"
    return checkout.run(words, cache=out / "cache")[0]


def compilation(checkout: Checkout, out: Path) -> float:
    """Return the processor seconds of a short run with an empty cache."""
    return checkout.run(f"validate simple --seconds 1 -o {out}", cache=out / "cache")[1]


def verdict(checkout: Checkout, out: Path) -> float:
    """Return the processor seconds of a decision for 60 s of its drives, some of which end early."""
    words = f"verdict medium --mapper hector --seconds 60 --budget {BUDGET} -o {out}"
    cpu = checkout.run(words)[1]
    records = [json.loads(path.read_text(encoding="utf-8")) for path in out.glob("*/record.json")]
    driven = sum(float(record["rtf"]["simulated_seconds"]) for record in records)
    return 60 * cpu / driven


def jobs(checkout: Checkout, out: Path) -> float:
    """Return the runs a minute of twenty in two processes."""
    words = f"validate medium --mapper hector --seconds 60 --seed 1-20 --jobs 2 -o {out}"
    return 60 * 20 / checkout.run(words, cores=2)[0]


ROWS: dict[str, Row] = {
    "help": clock("--help"),
    "info": clock("info PICTURE"),
    "build": clock("build PICTURE -o OUT"),
    "validate": clock("validate medium --seconds 120 --mapper hector -o OUT"),
    "map": clock("map examples/data/office.clf.gz -o OUT", cores=2),
    "demo": demo,
    "compile": compilation,
    "verdict": verdict,
    "jobs": jobs,
}


def write_picture(path: Path) -> None:
    """Write smooth hills of 16 bits."""
    noise = np.random.default_rng(0).standard_normal((1025, 1025))
    hills = cv2.GaussianBlur(noise, (0, 0), 40)
    cv2.imwrite(str(path), (65535 * (hills - hills.min()) / np.ptp(hills)).astype(np.uint16))


def main() -> None:
    """Measure the rows, checkouts in turn, and print their medians."""
    given = arguments(__doc__, peer=Path, runs=5, only=",".join(ROWS))
    checkouts = [Checkout(folder.resolve()) for folder in (ROOT, given.peer) if folder]
    found: dict[str, list[list[float]]] = {}
    for name in given.only.split(","):
        found[name] = [[] for _ in checkouts]
        for _ in range(given.runs):
            for checkout, values in zip(checkouts, found[name], strict=True):
                with TemporaryDirectory() as folder:
                    out = Path(folder, "out")
                    out.mkdir()
                    values.append(ROWS[name](checkout, out))
        print(name, *(f"{median(values):.2f}" for values in found[name]), flush=True)
    table = Table("row", *("here", "peer", "here / peer")[: 3 if given.peer else 1])
    for name, columns in found.items():
        medians = [median(column) for column in columns]
        ratio = [f"{medians[0] / medians[1]:.2f}"] if given.peer else []
        table.add_row(name, *(f"{m:.2f}" for m in medians), *ratio)
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
