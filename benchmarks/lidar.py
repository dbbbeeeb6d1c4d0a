"""Time of a laser scan: our ray traversal beside MuJoCo's rays on the same terrain, and every limit it keeps.

    python benchmarks/lidar.py [--quick] [--json FILE]

720 beams over 270 degrees, 30 m, from 0.45 m above the ground and tilted by it, on one square of 50 m sampled
with 257^2 to 4097^2 heights. Every method goes through the same poses one after the other, so that none of
them keeps a pose's cells in the processor's cache: a robot moves on between two scans. Times are of the
processor, which other programs lengthen less than those of a clock. It exits 1 where a limit is not kept.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import sys
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.lidar_places import (
    RANGE,
    Array,
    Cast,
    Rays,
    fan,
    mujoco_cast,
    octaves,
    rooms,
    scans,
    triangles,
)
from lirs_envs.lidar.presets import ring_directions
from lirs_envs.lidar.ray_casting import MeshCaster, RayCaster
from lirs_envs.robots.robot import Twist, make_robot
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.sources.build import build_world
from lirs_wct.sources.bundled import RECIPES

SIZES = (257, 513, 1025, 2049, 4097)
SAMPLES, BEAMS, POSES = 1025, 720, 40
LIMITS = {
    "scan_541_ms": ("541 beams at 1025^2 [ms]", "<=", 0.12),
    "rings_16x900_ms": ("16 rings of 900 beams at 1025^2 [ms]", "<=", 2.5),
    "laser_map_2000": ("laser map of 2000^2 cells, in scans of 1025^2", "<=", 1.2),
    "growth_4097_257": ("4097^2, in scans of 257^2", "<=", 3.0),
    "ratio_mesh": ("times faster than MuJoCo's rays on a mesh", ">=", 14.0),
    "ratio_embree": ("times faster than Embree on that mesh", ">=", 1.4),
    "ratio_hfield": ("times faster than MuJoCo's rays on an hfield", ">=", 5000.0),
    "mesh_share": ("share of beams where Embree is MuJoCo's to 1e-4 m", ">=", 0.999),
    "sensors_ms": ("all sensors of a Husky, worst bundled world [ms a simulated s]", "<=", 5.0),
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
    """Return times of MuJoCo's rays and Embree's, and ratios taken pose by pose."""
    mesh, hfield = mujoco_cast(surface, "mesh"), mujoco_cast(surface, "hfield")
    few, rounds = (3 if quick else 8), (3 if quick else 8)
    times, mesh_times = milliseconds(ours, rays, rounds), milliseconds(mesh, rays, rounds)
    hfield_times = milliseconds(hfield, rays[:few], 1)
    row = {
        "mesh_ms": float(np.median(mesh_times)),
        "hfield_ms": float(np.median(hfield_times)),
        "difference": float(differences(ours, mesh, rays[:4]).max()),
        "ratio_mesh": float(np.median(mesh_times / times)),
        "ratio_hfield": float(np.median(hfield_times / times[:few])),
    }
    if importlib.util.find_spec("embreex") is None:
        return row
    vertices, faces = triangles(surface)
    embree = MeshCaster(TriangleMesh(vertices.reshape(-1, 3).astype(np.float64), faces))

    def true_mesh(o: Array, d: Array) -> Array:
        return embree.ranges(o, d, RANGE)

    embree_times = milliseconds(true_mesh, rays, rounds)
    row["embree_ms"] = float(np.median(embree_times))
    row["ratio_embree"] = float(np.median(embree_times / times))
    row["mesh_share"] = float((differences(true_mesh, mesh, rays[:8]) < 1e-4).mean())
    return row


def sensors_ms(seconds: int) -> float:
    """Return milliseconds a simulated second for all sensors of a Husky, in the worst bundled world."""
    worst = 0.0
    for name in RECIPES:
        sim = Simulation(build_world(name), SimulationConfig(robot=make_robot("husky")))
        sim.reset()
        for k in range(round((seconds + 1) / sim.period)):
            sim.advance(Twist(0.5, 0.3 * math.sin(k / 10)))
        # The first second compiles. The median, since other programs hold up single scans.
        settled = sim.timing.sensors[round(1 / sim.period) :]
        worst = max(worst, float(np.median(settled)) / sim.period * 1e3)
    return worst


def map_ms(rounds: int) -> float:
    """Return milliseconds a scan in a laser map of 2000^2 cells."""
    caster, rays = rooms(fan(BEAMS))
    return float(np.median(milliseconds(lambda o, d: caster.cast(o, d, RANGE), rays, rounds)))


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
            figures["laser_map_2000"] = map_ms(rounds) / row["ours_ms"]
            for name, beams in (("scan_541_ms", fan(541)), ("rings_16x900_ms", rings(16, 900, 0.26))):
                times = milliseconds(ours, scans(surface, POSES, beams), rounds // 3)
                figures[name] = float(np.median(times))
            figures |= {key: row[key] for key in LIMITS if key in row}
        rows.append(row)
    figures["growth_4097_257"] = rows[-1]["ours_ms"] / rows[0]["ours_ms"]
    figures["sensors_ms"] = sensors_ms(5 if quick else 20)
    return figures, rows


def holds(figures: dict[str, float], key: str) -> bool | None:
    """Whether a limit is kept; None = it was not measured."""
    _, sign, limit = LIMITS[key]
    if key not in figures:
        return None
    return figures[key] <= limit if sign == "<=" else figures[key] >= limit


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer poses and rounds, about half a minute")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()
    console = Console()
    figures, rows = measure(arguments.quick, console)
    names = ("ours_ms", "mesh_ms", "hfield_ms", "embree_ms", "build_ms", "difference")
    table = Table(
        "samples", *(f"{name[:-3]} [ms]" if name.endswith("_ms") else f"{name} [m]" for name in names)
    )
    for row in rows:
        table.add_row(f"{row['samples']:.0f}^2", *(f"{row[n]:.3g}" if n in row else "" for n in names))
    console.print(table)
    kept = Table("figure", "measured", "limit", "kept")
    for key, (words, sign, limit) in LIMITS.items():
        shown = f"{figures[key]:.4g}" if key in figures else "needs embreex"
        said = {True: "yes", False: "no", None: ""}[holds(figures, key)]
        kept.add_row(words, shown, f"{sign} {limit:g}", said)
    console.print(kept)
    if arguments.json:
        arguments.json.write_text(json.dumps({**figures, "rows": rows}, indent=2) + "\n")
    sys.exit(any(holds(figures, key) is False for key in LIMITS))


if __name__ == "__main__":
    main()
