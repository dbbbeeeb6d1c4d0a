"""What `benchmarks/world.py` measures: each job builds something, and returns its own figures.

Octaves of seeded noise, 16 bit, on a square of 50 m with 6 m relief; errors are shares of the relief.
"""

from __future__ import annotations

import importlib.util
import itertools
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from lirs_wct.export.package import write_package
from lirs_wct.geometry.heightfield import HeightField
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
    return next(out.rglob(f"*.{ending}")).stat().st_size / 1e6


def within_error(path: Path, out: Path, share: float) -> Figures:
    world = package(path, out, ("dae", "sdf", "mjcf"), max_error=share * RELIEF)
    return {"triangles": len(world.mesh.faces), "file_mb": size_mb(out, "dae")}


def heights_of(path: Path, options: BuildOptions) -> HeightField:
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
