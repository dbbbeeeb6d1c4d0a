"""World construction against its limits and beside its peers: time, peak memory, triangles, bytes.

    python benchmarks/world.py [--quick] [--only WORD] [--data DIR]

Each row is a process of its own, so that its peak memory, libraries included, is its own; kernels are
compiled before the clock starts. Worlds are built and written as by `lirs-wct build`, textures, start poses
and `world.json` included. The peer in the same run is pydelatin, where installed. A limit stands behind its
figure; a broken one makes the exit code 1. Where the CPU's seconds are far below the clock's, the machine had
other work. "agreement" is the share of a world's area where the mesh that `build` makes unasked and the
height field differ by more than the budget (0.1 % of the relief; DIR holds `height/*`).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

import cv2
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.world_jobs import BUNDLED, JOBS, Figures, picture, warm
from lirs_wct.errors import WctError
from lirs_wct.sources.build import build_world
from lirs_wct.sources.source import BuildOptions

BESIDE = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Where real inputs may lie beside a checkout."""
QUICK = 1025
"""Pixels along the side of the largest picture of a quick run."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One measurement.

    Attributes:
        job: of `JOBS`.
        samples: pixels along a side of the noise; 0 = the source is a file.
        source: that file.
        budget: the job's number: largest error as a share of the relief, or triangles.
        limits: largest value of a figure.
    """

    job: str
    samples: int = 0
    source: str = ""
    budget: float = 0.0
    limits: dict[str, float] = field(default_factory=dict)


def plan(quick: bool, data: Path) -> list[Row]:
    """Every row that world construction is held to."""
    rows = [
        Row(job="world within error", samples=4097, budget=2e-3, limits={"seconds": 5, "peak_mb": 550}),
        *(
            Row(
                job="triangulation",
                samples=n,
                budget=error,
                limits={"time_ratio": 1.6, "triangle_ratio": 1.45},
            )
            for n in (513, 1025, 2049, 4097)
            for error in (5e-4, 2e-3)
        ),
        *(
            Row(job=f"large {kind}", samples=n, budget=n)
            for kind, n in (("terrain", 8193), ("terrain", 16385), ("map", 10_000))
        ),
    ]
    if quick:
        rows = [row for row in rows if row.samples <= QUICK]
    return rows + [Row(job="agreement", source=source, limits={"over_3": 0.1}) for source in terrains(data)]


def terrains(data: Path) -> list[str]:
    """Return the bundled terrains and the pictures and elevation models that are terrain with relief."""
    found = list(BUNDLED)
    for path in sorted(data.glob("height/*")):
        try:
            world = build_world(path, BuildOptions(grayscale=True))
        except WctError:
            continue
        if world.surface.relief:
            found.append(str(path))
    return found


def compiled(row: Row) -> None:
    """Compile the kernels of a job, which leaves a hundred megabytes behind, in this process."""
    with tempfile.TemporaryDirectory() as folder:
        warm(row.job, Path(folder) / "warm", row.budget)


def run_one(row: Row) -> Figures:
    """Run one row in this process."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = Path(row.source) if row.source else folder / "noise.png"
        if row.samples:
            cv2.imwrite(str(source), picture(row.samples))
        warm(row.job, folder / "warm", row.budget)
        out = folder / "out"
        out.mkdir()
        Path("/proc/self/clear_refs").write_text("5")
        start, cpu = time.perf_counter(), time.process_time()
        figures = JOBS[row.job](source, out, row.budget)
        figures.setdefault("seconds", time.perf_counter() - start)
        figures.setdefault("cpu", time.process_time() - cpu)
        figures["peak_mb"] = peak_mb()
    return figures


def peak_mb() -> float:
    """Largest resident memory since it was last cleared, MB; Linux alone says it."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024 / 1e6


def measured(rows: list[Row], console: Console) -> list[Figures]:
    out: list[Figures] = []
    known: set[str] = set()
    for row in track(rows, description="worlds", console=console, transient=True):
        if row.job not in known:
            alone("--compile", row)
        known.add(row.job)
        out.append(json.loads(alone("--one", row).splitlines()[-1]))
    return out


def alone(what: str, row: Row) -> str:
    """Do something with a row in a process of its own and return what that printed."""
    command = [sys.executable, __file__, what, json.dumps(asdict(row))]
    return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout


COLUMNS = {
    "seconds": ("seconds", "{:.2f}"),
    "cpu": ("CPU s", "{:.2f}"),
    "peak_mb": ("peak MB", "{:.0f}"),
    "triangles": ("triangles", "{:,}"),
    "file_mb": ("file MB", "{:.1f}"),
    "over_1": ("% over budget", "{:.3f}"),
    "over_3": ("% over 3 x", "{:.3f}"),
    "time_ratio": ("x its time", "{:.2f}"),
    "triangle_ratio": ("x its triangles", "{:.3f}"),
}


def table_of(rows: list[Row], figures: list[Figures]) -> Table:
    table = Table("job", "source", "budget", *(title for title, _ in COLUMNS.values()), "beside")
    for row, found in zip(rows, figures, strict=True):
        source = f"{row.samples}^2" if row.samples else "/".join(Path(row.source).with_suffix("").parts[-2:])
        cells = [cell(row, found, key, form) for key, (_, form) in COLUMNS.items()]
        table.add_row(
            row.job, source, f"{row.budget:g}" if row.budget else "", *cells, str(found.get("note", ""))
        )
    return table


def cell(row: Row, found: Figures, key: str, form: str) -> str:
    if key not in found:
        return ""
    text = form.format(found[key])
    if key not in row.limits:
        return text
    over = float(found[key]) > row.limits[key]
    return f"[{'red' if over else 'green'}]{text}{' > ' if over else ' <= '}{row.limits[key]:g}[/]"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="pictures of at most 1025^2")
    parser.add_argument("--only", default="", metavar="WORD", help="rows whose job holds the word")
    parser.add_argument("--data", type=Path, default=BESIDE, help="folder that holds height/*")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    parser.add_argument("--compile", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.compile:
        compiled(Row(**json.loads(args.compile)))
        return
    if args.one:
        print(json.dumps(run_one(Row(**json.loads(args.one)))))
        return
    console = Console() if sys.stdout.isatty() else Console(width=170)
    rows = [row for row in plan(args.quick, args.data) if args.only in row.job]
    figures = measured(rows, console)
    console.print(table_of(rows, figures))
    limits = [(f.get(k), v) for row, f in zip(rows, figures, strict=True) for k, v in row.limits.items()]
    over = sum(found is not None and float(found) > limit for found, limit in limits)
    console.print(f"{over} figures over their limits" if over else "every measured figure within its limit")
    if missing := sum(found is None for found, _ in limits):
        console.print(f"{missing} limits without a figure: their peer, pydelatin, is not installed")
    if over:
        sys.exit(1)


if __name__ == "__main__":
    main()
