"""Time of a laser scan: our ray traversal beside MuJoCo's rays on the same terrain.

    python benchmarks/lidar.py [--quick] [--json FILE]

720 beams over 270 degrees, 30 m, from 0.45 m above the ground and tilted by it, on one square of 50 m sampled
with 257^2 to 4097^2 heights. Every method goes through the same poses one after the other, so that none of
them keeps a pose's cells in the processor's cache: a robot moves on between two scans.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from lirs_envs.raycast import RayCaster, mujoco_ranges
from lirs_wct.heightfield import HeightField
from lirs_wct.pose import Pose2
from lirs_wct.walls import WallGrid

Array = NDArray[np.float64]
Cast = Callable[[Array, Array], Array]
SIZES = (257, 513, 1025, 2049, 4097)
SIDE, RANGE, BEAMS, FOV = 50.0, 30.0, 720, 1.5 * np.pi


def octaves(samples: int, seed: int = 0) -> HeightField:
    """Noise with equal slope in every octave from 25 to 0.1 m: relief 4 m, 95 % of slopes below 21 deg."""
    rng = np.random.default_rng(seed)
    z = np.zeros((samples, samples), np.float32)
    for octave in range(1, 10):
        knots = 2**octave
        lattice = rng.standard_normal((knots + 3, knots + 3)).astype(np.float32) * 2.0 ** (1 - octave)
        weights = _catmull_rom(samples, knots)
        z += (weights @ (weights @ lattice).T).T
    return HeightField.centred(z, (SIDE / (samples - 1),) * 2)


def _catmull_rom(samples: int, knots: int) -> sparse.csr_array:
    x = np.linspace(0, knots, samples)
    i = np.minimum(x.astype(int), knots - 1)
    f = x - i
    values = np.stack(
        (
            -0.5 * f + f**2 - 0.5 * f**3,
            1 - 2.5 * f**2 + 1.5 * f**3,
            0.5 * f + 2 * f**2 - 1.5 * f**3,
            -0.5 * f**2 + 0.5 * f**3,
        ),
        axis=1,
    ).astype(np.float32)
    rows, cols = np.repeat(np.arange(samples), 4), (i[:, None] + np.arange(4)).ravel()
    return sparse.csr_array((values.ravel(), (rows, cols)), shape=(samples, knots + 3))


def scans(surface: HeightField, count: int, seed: int = 1) -> list[tuple[Array, Array]]:
    """Origins and directions of scans of a laser that stands upright on a robot 0.6 m long and wide."""
    rng, half = np.random.default_rng(seed), 0.3
    angles = np.linspace(-FOV / 2, FOV / 2, BEAMS)
    beams = np.stack((np.cos(angles), np.sin(angles), 0 * angles), axis=1)
    result = []
    for x, y, yaw in rng.uniform((-20, -20, -np.pi), (20, 20, np.pi), (count, 3)):
        wheels = Pose2(x, y, yaw).apply(((half, 0), (-half, 0), (0, half), (0, -half)))
        z = surface.height_at(wheels[:, 0], wheels[:, 1])
        feet = np.column_stack((wheels, z))
        ahead = (feet[0] - feet[1]) / np.linalg.norm(feet[0] - feet[1])
        up = np.cross(ahead, feet[2] - feet[3])
        up /= np.linalg.norm(up)
        axes = np.stack((ahead, np.cross(up, ahead), up))
        result.append((feet.mean(axis=0) + 0.45 * up, beams @ axes))
    return result


def milliseconds(cast: Cast, rays: list[tuple[Array, Array]], rounds: int) -> Array:
    """Return for each pose the median time over the rounds; a first scan, which compiles, does not count."""
    times = np.zeros((rounds, len(rays)))
    cast(rays[0][0], rays[0][1][:1])
    for turn in range(rounds):
        for k, (origin, directions) in enumerate(rays):
            begin = time.perf_counter()
            cast(origin, directions)
            times[turn, k] = time.perf_counter() - begin
    median: Array = np.median(times, axis=0) * 1e3
    return median


def mujoco_cast(surface: HeightField, kind: str) -> Cast:
    """Rays of MuJoCo on the terrain as one hfield or one mesh (with its bounding volume hierarchy)."""
    spec = mujoco.MjSpec()
    low, relief = float(surface.z.min()), surface.relief
    if kind == "hfield":
        (rows, cols), (width, depth) = surface.shape, surface.size
        data = ((surface.south_up - low) / relief).ravel()
        spec.add_hfield(name="t", nrow=rows, ncol=cols, size=[width / 2, depth / 2, relief, 1], userdata=data)
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="t", pos=[0, 0, low], group=3)
    else:
        vertices, faces = _triangles(surface)
        shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.add_mesh(name="t", uservert=vertices.ravel(), userface=faces.ravel(), inertia=shell)
        geom = {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": "t", "group": 3}
        spec.worldbody.add_geom(**geom, contype=0, conaffinity=0)
    model = spec.compile()
    state = mujoco.MjData(model)
    mujoco.mj_forward(model, state)
    return lambda o, d: mujoco_ranges(model, state, o, d, RANGE, groups=[3])


def _triangles(surface: HeightField) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    rows, cols = surface.shape
    west, south, east, north = surface.bounds
    x, y = np.meshgrid(np.linspace(west, east, cols), np.linspace(south, north, rows))
    k = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    sw, se, nw, ne = k[:-1, :-1], k[:-1, 1:], k[1:, :-1], k[1:, 1:]
    faces = np.stack((sw, se, ne, sw, ne, nw), axis=-1).reshape(-1, 3)
    return np.stack((x, y, surface.south_up), axis=-1).astype(np.float32), faces


def laser_map_cast(cells: int = 2000) -> tuple[Cast, list[tuple[Array, Array]]]:
    """Walls of rooms and pillars on a map of 100 m at 0.05 m, with scans from its free cells."""
    rng = np.random.default_rng(2)
    solid = np.zeros((cells, cells), np.bool_)
    for row, col, length in rng.integers((0, 0, 40), (cells, cells, 240), (400, 3)):
        solid[row : row + 3, col : col + length] = True
        solid[col : col + length, row : row + 3] = True
    for row, col in rng.integers(0, cells - 8, (600, 2)):
        solid[row : row + 8, col : col + 8] = True
    walls = WallGrid(solid, 0.05, Pose2(), 2.5)
    floor = HeightField(np.zeros((2, 2), np.float32), (cells * 0.05,) * 2, (0.0, 0.0))
    angles = np.linspace(-FOV / 2, FOV / 2, BEAMS)
    free = np.argwhere(~solid)[rng.integers(0, (~solid).sum(), 40)]
    rays = []
    for (row, col), yaw in zip(free, rng.uniform(-np.pi, np.pi, 40), strict=True):
        d = np.stack((np.cos(angles + yaw), np.sin(angles + yaw), 0 * angles), axis=1)
        rays.append((np.array(((col + 0.5) * 0.05, (row + 0.5) * 0.05, 0.45)), d))
    caster = RayCaster(floor, walls)
    return lambda o, d: caster.cast(o, d, RANGE), rays


def difference(a: Cast, b: Cast, rays: list[tuple[Array, Array]]) -> float:
    """Largest difference of two methods in metres over all beams that both see."""
    pairs = [(a(o, d), b(o, d)) for o, d in rays]
    both = [np.isfinite(p) & np.isfinite(q) for p, q in pairs]
    return max(float(np.abs(p[k] - q[k]).max()) for (p, q), k in zip(pairs, both, strict=True))


def measure(quick: bool, console: Console) -> tuple[dict[str, float], list[dict[str, float]]]:
    """Return the figures and a row for each number of samples; ratios are taken pose by pose."""
    rounds, rows, figures = (10 if quick else 30), [], {}
    for samples in track(SIZES, "terrains", console=console, transient=True):
        surface = octaves(samples)
        rays = scans(surface, 40)
        begin = time.perf_counter()
        caster = RayCaster(surface)
        row = {"samples": samples, "build_ms": (time.perf_counter() - begin) * 1e3}

        def ours(o: Array, d: Array, caster: RayCaster = caster) -> Array:
            return caster.cast(o, d, RANGE)

        times = milliseconds(ours, rays, rounds)
        row["ours_ms"] = float(np.median(times))
        if samples == 1025 or (samples < 1025 and not quick):
            mesh, hfield = mujoco_cast(surface, "mesh"), mujoco_cast(surface, "hfield")
            mesh_times = milliseconds(mesh, rays, 3 if quick else 8)
            few = 3 if quick else 8
            hfield_times = milliseconds(hfield, rays[:few], 1)
            row["mesh_ms"], row["hfield_ms"] = float(np.median(mesh_times)), float(np.median(hfield_times))
            row["difference"] = difference(ours, mesh, rays[:4])
            figures["ratio_mesh"] = float(np.median(mesh_times / times))
            figures["ratio_hfield"] = float(np.median(hfield_times / times[:few]))
        rows.append(row)
    figures["growth_4097_257"] = rows[-1]["ours_ms"] / rows[0]["ours_ms"]
    map_ms = float(np.median(milliseconds(*laser_map_cast(), rounds)))
    figures["laser_map_2000"] = map_ms / next(row["ours_ms"] for row in rows if row["samples"] == 1025)
    return figures, rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer poses and rounds, under 30 s")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()
    console = Console()
    figures, rows = measure(arguments.quick, console)
    columns = ("ours_ms", "mesh_ms", "hfield_ms", "build_ms", "difference")
    table = Table("samples", "ours [ms]", "mesh [ms]", "hfield [ms]", "build [ms]", "difference [m]")
    for row in rows:
        cells = [f"{row[c]:.3g}" if c in row else "" for c in columns]
        table.add_row(f"{row['samples']:.0f}^2", *cells)
    console.print(table)
    console.print(
        f"at 1025^2: {figures['ratio_mesh']:.1f}x faster than MuJoCo's rays on a mesh (at least 20),"
    )
    console.print(f"           {figures['ratio_hfield']:.0f}x faster than on an hfield (at least 5000);")
    console.print(f"4097^2 takes {figures['growth_4097_257']:.2f}x as long as 257^2 (at most 3);")
    console.print(f"a laser map of 2000^2 cells {figures['laser_map_2000']:.2f}x the terrain (at most 1.2)")
    if arguments.json:
        arguments.json.write_text(json.dumps({**figures, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
