"""World construction against its limits and beside its peers: time, peak memory, triangles, bytes.

    python benchmarks/world.py [--quick] [--only WORD] [--data DIR]

Each row is a process of its own, so that its peak memory, libraries included, is its own; kernels are
compiled before the clock starts. The peer in the same run is pydelatin, where installed. A limit stands
behind its figure; a broken one makes the exit code 1. "agreement" is the share of a world's area where the
mesh that `build` makes unasked and the height field differ by more than the budget (0.1 % of the relief; DIR
holds `height/*`).
"""

from __future__ import annotations

import importlib.util
import itertools
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from rich.progress import track

from benchmarks.steps import DATA, arguments, print_rows
from lirs_wct.errors import WctError
from lirs_wct.export.package import write_package
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.mesh import rasterize_heights
from lirs_wct.meshing.simplify import triangulate
from lirs_wct.meshing.solid import solid_mesh
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


QUICK = 1025
"""Pixels along the side of the largest picture of a quick run."""
FORMS = {
    "seconds": "{:.2f}",
    "cpu": "{:.2f}",
    "peak_mb": "{:.0f}",
    "triangles": "{:,}",
    "file_mb": "{:.1f}",
    "over_1": "{:.3f}",
    "over_3": "{:.3f}",
    "time_ratio": "{:.2f}",
    "triangle_ratio": "{:.3f}",
}
"""Formats of the figures; over_N is the share of the area with more than N times the budget, percent."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One measurement of a job.

    Attributes:
        samples: Pixels along a side of the noise; 0 = the source is a file.
        budget: The job's number: largest error as a share of the relief, or samples.
        limits: Largest value of a figure.
    """

    job: str
    samples: int = 0
    source: str = ""
    budget: float = 0.0
    limits: dict[str, float] = field(default_factory=dict)


def plan(quick: bool, data: Path) -> list[Row]:
    """Return every row that world construction is held to."""
    ratios = {"time_ratio": 1.6, "triangle_ratio": 1.45}
    sizes = itertools.product((513, 1025, 2049, 4097), (5e-4, 2e-3))
    large = (("terrain", 8193), ("terrain", 16385), ("map", 10_000))
    rows = [
        Row(job="world within error", samples=4097, budget=2e-3, limits={"seconds": 5, "peak_mb": 550}),
        *(Row(job="triangulation", samples=n, budget=error, limits=ratios) for n, error in sizes),
        *(Row(job=f"large {kind}", samples=n, budget=n) for kind, n in large),
    ]
    rows = [row for row in rows if row.samples <= QUICK or not quick]
    return rows + [Row(job="agreement", source=source, limits={"over_3": 0.1}) for source in terrains(data)]


def terrains(data: Path) -> list[str]:
    """Return the bundled terrains and the pictures and elevation models that are terrain with relief."""
    sources = list(BUNDLED)
    for path in sorted(data.glob("height/*")):
        with suppress(WctError):
            if build_world(path, BuildOptions(grayscale=True)).surface.relief:
                sources.append(str(path))
    return sources


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
        lines = Path("/proc/self/status").read_text().splitlines()
        peak = next(line for line in lines if line.startswith("VmHWM"))
        figures["peak_mb"] = int(peak.split()[1]) * 1024 / 1e6
    return figures


def warm_alone(row: Row) -> None:
    """Compile the kernels of a job, which leaves a hundred megabytes behind."""
    with tempfile.TemporaryDirectory() as folder:
        warm(row.job, Path(folder) / "warm", row.budget)


def main() -> None:
    """Measure each row in a process of its own, and print."""
    given = arguments(__doc__, quick=False, only="", data=DATA)
    rows = [row for row in plan(given.quick, given.data) if given.only in row.job]
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=1, mp_context=fresh, max_tasks_per_child=1) as one_by_one:
        list(one_by_one.map(warm_alone, {row.job: row for row in rows}.values()))
        figures = list(track(one_by_one.map(run_one, rows), "worlds", len(rows), transient=True))
    shown, over, missing = [], 0, 0
    for row, measured in zip(rows, figures, strict=True):
        source = f"{row.samples}^2" if row.samples else "/".join(Path(row.source).with_suffix("").parts[-2:])
        cells = {"job": row.job, "source": source, "budget": row.budget}
        for key, form in FORMS.items():
            text, limit = form.format(measured[key]) if key in measured else "", row.limits.get(key)
            if limit is not None and key in measured:
                broken = float(measured[key]) > limit
                text += f"{' > ' if broken else ' <= '}{limit:g}"
                over += broken
            missing += limit is not None and key not in measured
            cells[key] = text
        shown.append(cells | {"beside": measured.get("note", "")})
    print_rows(shown, width=None if sys.stdout.isatty() else 190)
    print(f"{over} figures over their limits; {missing} limits without a figure: pydelatin is not installed")
    sys.exit(over > 0)


if __name__ == "__main__":
    main()
