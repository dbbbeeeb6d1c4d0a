"""Time of a laser scan: our ray traversal beside MuJoCo's rays on the same terrain, and every limit it keeps.

    python benchmarks/lidar.py [--quick]

720 beams over 270 degrees, 30 m, from 0.45 m above the ground and tilted by it, on one square of 50 m sampled
with 257^2 to 4097^2 heights. Every method goes through the same poses one after the other, so that none of
them keeps a pose's cells in the processor's cache: a robot moves on between two scans. Times are of the
processor, which other programs lengthen less than those of a clock. It exits 1 where a limit is not kept.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import mujoco
import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.steps import arguments, print_limits
from lirs_envs.lidar.presets import ring_directions
from lirs_envs.lidar.ray_casting import RayCaster, mujoco_hits
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.pose import Pose2

Array = NDArray[np.float64]
Rays = tuple[Array, Array]
Cast = Callable[[Array, Array], Array]
SIDE, RANGE, FOV = 50.0, 30.0, 1.5 * np.pi


def octaves(samples: int, seed: int = 0) -> HeightField:
    """Noise with equal slope in every octave from 25 to 0.1 m: relief 4 m, 95 % of slopes below 21 deg."""
    rng = np.random.default_rng(seed)
    z = np.zeros((samples, samples), np.float32)
    for octave in range(1, 10):
        knots = 2**octave
        lattice = rng.standard_normal((knots + 3, knots + 3)).astype(np.float32) * 2.0 ** (1 - octave)
        weights = _catmull_rom(samples, knots)
        z += (weights @ (weights @ lattice).T).T
    return HeightField.centered(z, (SIDE / (samples - 1),) * 2)


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


def fan(beams: int) -> Array:
    """(beams, 3) directions over 270 degrees around the front."""
    angles = np.linspace(-FOV / 2, FOV / 2, beams)
    return np.stack((np.cos(angles), np.sin(angles), 0 * angles), axis=1)


def scans(surface: HeightField, count: int, beams: Array, seed: int = 1) -> list[Rays]:
    """Origins and directions of scans of a laser that stands upright on a robot 0.6 m long and wide."""
    rng, half = np.random.default_rng(seed), 0.3
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
        vertices, faces = triangles(surface)
        shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.add_mesh(name="t", uservert=vertices.ravel(), userface=faces.ravel(), inertia=shell)
        geom = {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": "t", "group": 3}
        spec.worldbody.add_geom(**geom, contype=0, conaffinity=0)
    model = spec.compile()
    state = mujoco.MjData(model)
    mujoco.mj_forward(model, state)
    return lambda o, d: mujoco_hits(model, state, o, d, RANGE, groups=[3])[0]


def triangles(surface: HeightField) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return vertices and faces of a surface."""
    rows, cols = surface.shape
    west, south, east, north = surface.bounds
    x, y = np.meshgrid(np.linspace(west, east, cols), np.linspace(south, north, rows))
    k = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    sw, se, nw, ne = k[:-1, :-1], k[:-1, 1:], k[1:, :-1], k[1:, 1:]
    faces = np.stack((sw, se, ne, sw, ne, nw), axis=-1).reshape(-1, 3)
    return np.stack((x, y, surface.south_up), axis=-1).astype(np.float32), faces


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


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, quick=False)
    console = Console()
    figures, rows = measure(given.quick, console)
    names = ("ours_ms", "mesh_ms", "hfield_ms", "build_ms", "difference")
    table = Table(
        "samples", *(f"{name[:-3]} [ms]" if name.endswith("_ms") else f"{name} [m]" for name in names)
    )
    for row in rows:
        table.add_row(f"{row['samples']:.0f}^2", *(f"{row[n]:.3g}" if n in row else "" for n in names))
    console.print(table)
    sys.exit(not print_limits(figures, LIMITS))


if __name__ == "__main__":
    main()
