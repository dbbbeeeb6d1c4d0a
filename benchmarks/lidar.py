"""Time of a laser scan: our ray traversal beside MuJoCo's rays on the same terrain, and every limit it keeps.

    python benchmarks/lidar.py [--quick]

720 beams over 270 degrees, 30 m, from 0.45 m above the ground and tilted by it, on one square of 50 m sampled
with 257^2 to 4097^2 heights. Every method goes through the same poses one after the other, so that none of
them keeps a pose's cells in the processor's cache: a robot moves on between two scans. Times are of the
processor, which other programs lengthen less than those of a clock. It exits 1 where a limit is not kept.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.lidar_places import RANGE, Array, Cast, Rays, fan, mujoco_cast, octaves, scans
from lirs_envs.lidar.presets import ring_directions
from lirs_envs.lidar.ray_casting import RayCaster
from lirs_wct.geometry.heightfield import HeightField

SIZES = (257, 513, 1025, 2049, 4097)
SAMPLES, BEAMS, POSES = 1025, 720, 40
LIMITS = {
    "scan_541_ms": ("541 beams at 1025^2 [ms]", "<=", 0.12),
    "rings_16x900_ms": ("16 rings of 900 beams at 1025^2 [ms]", "<=", 2.5),
    "growth_4097_257": ("4097^2, in scans of 257^2", "<=", 3.0),
    "ratio_mesh": ("times faster than MuJoCo's rays on a mesh", ">=", 14.0),
    "ratio_hfield": ("times faster than MuJoCo's rays on an hfield", ">=", 5000.0),
}
"""What is asked: in words, at most or at least, and how much."""


def rings(count: int, beams: int, highest: float) -> Array:
    """Return (count * beams, 3) directions of rings, evenly below and above the horizon."""
    around = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    return np.concatenate([ring_directions(around, up) for up in np.linspace(-highest, highest, count)])


def milliseconds(cast: Cast, rays: list[Rays], rounds: int) -> Array:
    """Return for each pose the median time over the rounds; a first scan, which compiles, does not count."""
    times = np.zeros((rounds, len(rays)))
    cast(rays[0][0], rays[0][1][:1])
    for turn in range(rounds):
        for k, (origin, directions) in enumerate(rays):
            begin = time.thread_time()
            cast(origin, directions)
            times[turn, k] = time.thread_time() - begin
    median: Array = np.median(times, axis=0) * 1e3
    return median


def differences(a: Cast, b: Cast, rays: list[Rays]) -> Array:
    """Difference of two methods in meters over all beams that both see."""
    pairs = [(a(o, d), b(o, d)) for o, d in rays]
    both = [np.isfinite(p) & np.isfinite(q) for p, q in pairs]
    return np.concatenate([np.abs(p[k] - q[k]) for (p, q), k in zip(pairs, both, strict=True)])


def compared(surface: HeightField, ours: Cast, rays: list[Rays], quick: bool) -> dict[str, float]:
    """Return times of MuJoCo's rays, and ratios taken pose by pose."""
    mesh, hfield = mujoco_cast(surface, "mesh"), mujoco_cast(surface, "hfield")
    few, rounds = (3 if quick else 8), (3 if quick else 8)
    times, mesh_times = milliseconds(ours, rays, rounds), milliseconds(mesh, rays, rounds)
    hfield_times = milliseconds(hfield, rays[:few], 1)
    return {
        "mesh_ms": float(np.median(mesh_times)),
        "hfield_ms": float(np.median(hfield_times)),
        "difference": float(differences(ours, mesh, rays[:4]).max()),
        "ratio_mesh": float(np.median(mesh_times / times)),
        "ratio_hfield": float(np.median(hfield_times / times[:few])),
    }


def measure(quick: bool, console: Console) -> tuple[dict[str, float], list[dict[str, float]]]:
    """Return the figures and a row for each number of samples."""
    rounds, rows, figures = (10 if quick else 30), [], {}
    for samples in track(SIZES, "terrains", console=console, transient=True):
        surface = octaves(samples)
        rays = scans(surface, POSES, fan(BEAMS))
        begin = time.perf_counter()
        caster = RayCaster(surface)
        row = {"samples": samples, "build_ms": (time.perf_counter() - begin) * 1e3}

        def ours(o: Array, d: Array, caster: RayCaster = caster) -> Array:
            return caster.cast(o, d, RANGE)

        row["ours_ms"] = float(np.median(milliseconds(ours, rays, rounds)))
        if samples == SAMPLES or (samples < SAMPLES and not quick):
            row |= compared(surface, ours, rays, quick)
        if samples == SAMPLES:
            for name, beams in (("scan_541_ms", fan(541)), ("rings_16x900_ms", rings(16, 900, 0.26))):
                times = milliseconds(ours, scans(surface, POSES, beams), rounds // 3)
                figures[name] = float(np.median(times))
            figures |= {key: row[key] for key in LIMITS if key in row}
        rows.append(row)
    figures["growth_4097_257"] = rows[-1]["ours_ms"] / rows[0]["ours_ms"]
    return figures, rows


def holds(figures: dict[str, float], key: str) -> bool:
    """Whether a limit is kept."""
    _, sign, limit = LIMITS[key]
    return figures[key] <= limit if sign == "<=" else figures[key] >= limit


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer poses and rounds, about half a minute")
    arguments = parser.parse_args()
    console = Console()
    figures, rows = measure(arguments.quick, console)
    names = ("ours_ms", "mesh_ms", "hfield_ms", "build_ms", "difference")
    table = Table(
        "samples", *(f"{name[:-3]} [ms]" if name.endswith("_ms") else f"{name} [m]" for name in names)
    )
    for row in rows:
        table.add_row(f"{row['samples']:.0f}^2", *(f"{row[n]:.3g}" if n in row else "" for n in names))
    console.print(table)
    kept = Table("figure", "measured", "limit", "kept")
    for key, (words, sign, limit) in LIMITS.items():
        kept.add_row(
            words, f"{figures[key]:.4g}", f"{sign} {limit:g}", "yes" if holds(figures, key) else "no"
        )
    console.print(kept)
    sys.exit(not all(holds(figures, key) for key in LIMITS))


if __name__ == "__main__":
    main()
