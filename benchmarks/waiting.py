"""What a user waits for: whole commands, of this checkout and of a peer's in turn.

    python benchmarks/waiting.py [--peer FOLDER] [--runs 5] [--only ROW,...]

The peer is another checkout with a .venv. Medians of whole processes on one core, on two for `map` and
`jobs`, in seconds; `demo` and `compile` with an empty cache of Numba's. `compile` and `verdict` are seconds
of the processor, for a second of simulation and for 60 s of its drives. `jobs` is runs a minute.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import time
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from benchmarks.steps import arguments, print_rows

ROOT = Path(__file__).resolve().parents[1]


DRIVE = "--mapper hector --seconds 120 -o OUT"
ROWS = {
    "help": "--help",
    "info": "info PICTURE",
    "build": "build PICTURE -o OUT",
    "validate": f"validate medium {DRIVE}",
    "map": "map examples/data/office.clf.gz -o OUT",
    "demo": f"validate simple medium advanced --robot husky --seed 1 {DRIVE}",
    "compile": "validate simple --seconds 1 -o OUT",
    "verdict": "verdict medium --mapper hector --seconds 60 --budget 60s -o OUT",
    "jobs": "validate medium --mapper hector --seconds 60 --seed 1-20 --jobs 2 -o OUT",
}
"""Commands; OUT stands for an empty folder, PICTURE for smooth hills of 1025 x 1025 pixels."""
TWO_CORES, EMPTY_CACHE = ("map", "jobs"), ("demo", "compile")


def measure(name: str, checkout: Path, folder: Path) -> float:
    """Run a command in a checkout once; return the figure of its row."""
    out, picture = folder / "out", folder / "hills.png"
    out.mkdir()
    write_picture(picture)
    words = ROWS[name].replace("OUT", str(out)).replace("PICTURE", str(picture)).split()
    env = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    env |= {"NUMBA_CACHE_DIR": f"{folder}/cache"} if name in EMPTY_CACHE else {}
    cores = sorted(os.sched_getaffinity(0))[: 2 if name in TWO_CORES else 1]
    command = ["taskset", "-c", ",".join(map(str, cores)), str(checkout / ".venv/bin/lirs-wct"), *words]
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, cwd=checkout, env=env, check=True, capture_output=True)
    seconds, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if name == "verdict":
        records = [json.loads(path.read_text(encoding="utf-8")) for path in out.glob("*/record.json")]
        return 60 * cpu / sum(float(record["rtf"]["simulated_seconds"]) for record in records)
    return {"compile": cpu, "jobs": 60 * 20 / seconds}.get(name, seconds)


def write_picture(path: Path) -> None:
    """Write smooth hills of 16 bits."""
    noise = np.random.default_rng(0).standard_normal((1025, 1025))
    hills = cv2.GaussianBlur(noise, (0, 0), 40)
    cv2.imwrite(str(path), (65535 * (hills - hills.min()) / np.ptp(hills)).astype(np.uint16))


def main() -> None:
    """Measure the rows, checkouts in turn, and print their medians."""
    given = arguments(__doc__, peer=Path, runs=5, only=",".join(ROWS))
    checkouts = {"here": ROOT} | ({"peer": given.peer.resolve()} if given.peer else {})
    rows = []
    for name in given.only.split(","):
        figures: dict[str, list[float]] = {where: [] for where in checkouts}
        for _ in range(given.runs):
            for where, checkout in checkouts.items():
                with TemporaryDirectory() as folder:
                    figures[where].append(measure(name, checkout, Path(folder)))
        rows.append({"row": name} | {where: median(values) for where, values in figures.items()})
        print(rows[-1], flush=True)
    print_rows(rows, width=100)


if __name__ == "__main__":
    main()
