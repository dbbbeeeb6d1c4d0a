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

import importlib.util
import itertools
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.steps import arguments
from lirs_wct.errors import WctError
from lirs_wct.export.package import write_package
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.mesh import rasterize_heights
from lirs_wct.meshing.solid import solid_mesh, triangulate
from lirs_wct.sources.build import build_world
from lirs_wct.sources.picture import read_terrain
from lirs_wct.sources.source import BuildOptions, find_source
from lirs_wct.world import World

BUNDLED = ("simple", "medium", "advanced")
Figures = dict[str, float | int | str]
RELIEF = 6.0
MAP_FORMATS = ("dae", "stl", "sdf", "mjcf")


def picture(samples: int, seed: int = 0) -> np.ndarray:
    """(samples, samples) uint16: eight octaves, each finer by half and lower by 0.45."""
    rng = np.random.default_rng(seed)
    z = np.zeros((samples, samples), np.float32)
    for octave in range(1, 9):
        lattice = rng.standard_normal((2**octave + 3,) * 2).astype(np.float32)
        z += 0.45**octave * cv2.resize(lattice, (samples, samples), interpolation=cv2.INTER_CUBIC)
    z -= z.min()
    heights: np.ndarray = np.rint(z / z.max() * 65535).astype(np.uint16)
    return heights


def package(source: Path, out: Path, formats: tuple[str, ...], **options: float | int | None) -> World:
    """Build a world and write its folder, as `lirs-wct build` does."""
    world = build_world(source, BuildOptions(**options))  # type: ignore[arg-type]
    write_package(world, out, formats=formats)
    return world


def size_mb(out: Path, ending: str) -> float:
    """Return the size of a written file, MB."""
    return next(out.rglob(f"*.{ending}")).stat().st_size / 1e6


def within_error(path: Path, out: Path, share: float) -> Figures:
    """Build a world whose mesh keeps an error."""
    world = package(path, out, ("dae", "sdf", "mjcf"), max_error=share * RELIEF)
    return {"triangles": len(world.mesh.faces), "file_mb": size_mb(out, "dae")}


def heights_of(path: Path, options: BuildOptions) -> HeightField:
    """Return the heights of a picture."""
    return read_terrain(find_source(path, options), options)[0].surface


def triangulation(path: Path, _: Path, share: float) -> Figures:
    """Both triangulations by turns, CPU seconds, the best of each: little of what else runs shows."""
    surface = heights_of(path, BuildOptions())
    jobs: dict[str, Callable[[], int]] = {
        "ours": lambda: len(triangulate(surface, max_error=share * RELIEF)[1])
    }
    if importlib.util.find_spec("pydelatin") is not None:
        peer = importlib.import_module("pydelatin").Delatin
        jobs["peer"] = lambda: len(peer(surface.z, max_error=share * RELIEF).triangles)
    seconds, triangles = dict.fromkeys(jobs, np.inf), dict.fromkeys(jobs, 0)
    for _turn in range(5 if surface.shape[0] < 2000 else 2):
        for name, job in jobs.items():
            start = time.process_time()
            triangles[name] = job()
            seconds[name] = min(seconds[name], time.process_time() - start)
    figures: Figures = {"seconds": seconds["ours"], "triangles": triangles["ours"]}
    if "peer" in jobs:
        figures |= {
            "time_ratio": seconds["ours"] / seconds["peer"],
            "triangle_ratio": triangles["ours"] / triangles["peer"],
            "note": f"pydelatin {seconds['peer']:.3f} s, {triangles['peer']:,}",
        }
    return figures


def agreement(path: Path, _: Path, __: float) -> Figures:
    """Compare the mesh of the default budget with the height field, at 16 places of every cell."""
    options = BuildOptions() if path.name in BUNDLED else BuildOptions(grayscale=True)
    world = build_world(path.name if path.name in BUNDLED else path, options)
    surface, budget = world.surface, world.file_options.max_error
    assert budget is not None
    (x, y), (dx, dy), (rows, cols) = surface.origin, surface.cell, surface.shape
    errors = []
    for u, v in itertools.product((0.125, 0.375, 0.625, 0.875), repeat=2):
        top = rasterize_heights(world.file_mesh, (x + u * dx, y + v * dy, dx, dy), (rows - 1, cols - 1))
        px, py = x + (np.arange(cols - 1) + u) * dx, y + (np.arange(rows - 1) + v) * dy
        errors.append(np.abs(top - surface.height_at(*np.meshgrid(px, py))) / budget)
    over = {f"over_{n}": 100 * float(np.mean([e > n for e in errors])) for n in (1, 3)}
    full = len(solid_mesh(surface).faces)
    triangles = len(world.file_mesh.faces)
    return {"triangles": triangles, **over, "note": f"all pixels {full:,}, largest {np.max(errors):.3f}"}


def large_terrain(path: Path, out: Path, samples: float) -> Figures:
    """Build a terrain of so many samples along a side."""
    return large(path, out, int(samples) ** 2)


def large_map(_: Path, out: Path, cells: float) -> Figures:
    """A floor of `cells` x `cells` with a fifth as many blocks as cells along a side."""
    side = int(cells)
    floor, rng = np.full((side, side), 254, np.uint8), np.random.default_rng(0)
    floor[:10] = floor[-10:] = floor[:, :10] = floor[:, -10:] = 0
    for _block in range(side // 5):
        (row, col), (rows, cols) = rng.integers(0, side, 2), rng.integers(5, 100, 2)
        floor[row : row + rows, col : col + cols] = 0
    cv2.imwrite(str(out / "floor.png"), floor)
    return large(write_yaml(out / "floor.yaml", 0.05), out, side**2)


def large(path: Path, out: Path, pixels: int, **options: float | None) -> Figures:
    """Build with the default formats."""
    start = time.process_time()
    world = package(path, out, MAP_FORMATS, max_pixels=pixels, **options)
    return {"cpu": time.process_time() - start, "triangles": len(world.file_mesh.faces)}


JOBS: dict[str, Callable[[Path, Path, float], Figures]] = {
    "world within error": within_error,
    "triangulation": triangulation,
    "agreement": agreement,
    "large terrain": large_terrain,
    "large map": large_map,
}


def warm(job: str, folder: Path, budget: float) -> None:
    """Compile or load the kernels of a job by running it on a tiny input, so that no clock counts it."""
    folder.mkdir()
    source = folder / "tiny.png"
    cv2.imwrite(str(source), picture(129))
    JOBS[job](source, folder, 129 if job.startswith("large") else budget)


def write_yaml(path: Path, resolution: float) -> Path:
    """Write the YAML of a map whose picture is the PNG of the same name."""
    said = {"image": f"{path.stem}.png", "resolution": resolution, "origin": [0, 0, 0.1], "negate": 0}
    said |= {"occupied_thresh": 0.65, "free_thresh": 0.2}
    path.write_text("".join(f"{key}: {value}\n" for key, value in said.items()))
    return path


BESIDE = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Where real inputs may lie beside a checkout."""
QUICK = 1025
"""Pixels along the side of the largest picture of a quick run."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One measurement.

    Attributes:
        job: Name in `JOBS`.
        samples: pixels along a side of the noise; 0 = the source is a file.
        source: File; empty where samples are drawn.
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
    """Measure the rows, each in a process of its own."""
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
    """Return the figures of the rows."""
    table = Table("job", "source", "budget", *(title for title, _ in COLUMNS.values()), "beside")
    for row, found in zip(rows, figures, strict=True):
        source = f"{row.samples}^2" if row.samples else "/".join(Path(row.source).with_suffix("").parts[-2:])
        cells = [cell(row, found, key, form) for key, (_, form) in COLUMNS.items()]
        table.add_row(
            row.job, source, f"{row.budget:g}" if row.budget else "", *cells, str(found.get("note", ""))
        )
    return table


def cell(row: Row, found: Figures, key: str, form: str) -> str:
    """Return a figure with its limit, as text."""
    if key not in found:
        return ""
    text = form.format(found[key])
    if key not in row.limits:
        return text
    over = float(found[key]) > row.limits[key]
    return f"[{'red' if over else 'green'}]{text}{' > ' if over else ' <= '}{row.limits[key]:g}[/]"


def main() -> None:
    """Measure and print."""
    args = arguments(__doc__, quick=False, only="", data=BESIDE, one=str, compile=str)
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
