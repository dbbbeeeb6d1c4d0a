"""World construction beside its peers: time, peak memory, triangles, bytes.

    python benchmarks/world.py [--quick] [--json FILE]

Octaves of seeded noise, 16 bit, on a square of 50 m with 6 m relief; errors are shares of the relief. Each
row runs in a process of its own, so that its peak memory is its own, with kernels compiled before the
clock starts. Peers: pydelatin (the same triangulation in C++, left out where it is not installed) and
trimesh (full grid to .dae).
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from lirs_wct.heightfield import HeightField

Row = dict[str, float | int | str]
RELIEF = 6.0


def picture(samples: int, seed: int = 0) -> np.ndarray:
    """(samples, samples) uint16: eight octaves, each finer by half and lower by 0.45."""
    rng = np.random.default_rng(seed)
    z = np.zeros((samples, samples), np.float32)
    for octave in range(1, 9):
        lattice = rng.standard_normal((2**octave + 3,) * 2).astype(np.float32)
        z += 0.45**octave * cv2.resize(lattice, (samples, samples), interpolation=cv2.INTER_CUBIC)
    z -= z.min()
    return np.rint(z / z.max() * 65535).astype(np.uint16)


def surface_of(path: Path, **options: object) -> HeightField:
    from lirs_wct.image import read_height_field
    from lirs_wct.options import BuildOptions

    return read_height_field(path, BuildOptions(**options))  # type: ignore[arg-type]


def warm(folder: Path) -> None:
    """Compile or load every kernel on a tiny picture."""
    cv2.imwrite(str(folder / "tiny.png"), picture(33))
    for job in (full_grid, simplified, full_stl):
        job(folder / "tiny.png", folder, 0.1)


def full_grid(path: Path, out: Path, _: float) -> Row:
    from lirs_wct.formats.collada import write_collada
    from lirs_wct.solid import solid_mesh

    mesh = solid_mesh(surface_of(path))
    # The tiny picture goes through the streamed writer too, to compile it.
    write_collada(out / "full.dae", mesh, "../materials/textures/a.png", stream_above=1000)
    return {"triangles": len(mesh.faces), "bytes": (out / "full.dae").stat().st_size}


def simplified(path: Path, out: Path, share: float) -> Row:
    from lirs_wct.formats.collada import write_collada
    from lirs_wct.formats.sdf import model_config, model_sdf, world_sdf
    from lirs_wct.simplify import simplified_solid

    mesh = simplified_solid(surface_of(path), max_error=share * RELIEF)
    write_collada(out / "a.dae", mesh, "../materials/textures/a.png")
    for name, text in (("model.config", model_config), ("model.sdf", model_sdf), ("a.world", world_sdf)):
        (out / name).write_text(text("a"))
    return {"triangles": len(mesh.faces), "bytes": (out / "a.dae").stat().st_size}


def full_stl(path: Path, out: Path, _: float) -> Row:
    from lirs_wct.formats.stl import write_triangles
    from lirs_wct.solid import solid_triangles

    count, chunks = solid_triangles(surface_of(path))
    write_triangles(out / "a.stl", count, chunks)
    return {"triangles": count, "bytes": (out / "a.stl").stat().st_size}


def triangulation(path: Path, _: Path, share: float) -> Row:
    from lirs_wct.simplify import triangulate

    surface = surface_of(path)
    start = time.perf_counter()
    faces = triangulate(surface, max_error=share * RELIEF)[1]
    return {"triangles": len(faces), "seconds": time.perf_counter() - start}


def pydelatin_triangulation(path: Path, _: Path, share: float) -> Row:
    from pydelatin import Delatin

    z = surface_of(path).z
    start = time.perf_counter()
    faces = Delatin(z, max_error=share * RELIEF).triangles
    return {"triangles": len(faces), "seconds": time.perf_counter() - start}


def cut_to_8_bits(path: Path, _: Path, share: float, *, deterrace: bool = False) -> Row:
    from lirs_wct.simplify import triangulate

    cut = path.with_name("cut.png")
    cv2.imwrite(str(cut), (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) / 257).round().astype(np.uint8))
    faces = triangulate(surface_of(cut, deterrace=deterrace), max_error=share * RELIEF)[1]
    return {"triangles": len(faces)}


def deterraced(path: Path, out: Path, share: float) -> Row:
    return cut_to_8_bits(path, out, share, deterrace=True)


def trimesh_dae(path: Path, out: Path, _: float) -> Row:
    import trimesh

    from lirs_wct.solid import solid_mesh

    mesh = solid_mesh(surface_of(path))
    start = time.perf_counter()
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(out / "peer.dae")
    size = (out / "peer.dae").stat().st_size
    return {"triangles": len(mesh.faces), "bytes": size, "seconds": time.perf_counter() - start}


JOBS: dict[str, Callable[[Path, Path, float], Row]] = {
    "within error .dae": simplified,
    "full .dae": full_grid,
    "full .stl": full_stl,
    "triangles": triangulation,
    "pydelatin": pydelatin_triangulation,
    "cut to 8 bit": cut_to_8_bits,
    "and deterraced": deterraced,
    "trimesh .dae": trimesh_dae,
}
PLAN = (
    ("within error .dae", 4097, 2e-3),
    ("within error .dae", 4097, 1.2e-4),
    ("full .dae", 1025, 0.0),
    ("full .dae", 2049, 0.0),
    ("full .stl", 4097, 0.0),
    *((name, n, e) for n, e in ((1025, 5e-4), (4097, 2e-3), (4097, 5e-4))
      for name in ("triangles", "pydelatin")),
    ("cut to 8 bit", 1025, 5e-4),
    ("and deterraced", 1025, 5e-4),
    ("trimesh .dae", 513, 0.0),
)  # fmt: skip
QUICK = tuple(dict.fromkeys((name, min(n, 513), e and max(e, 5e-4)) for name, n, e in PLAN))


def run_one(name: str, samples: int, share: float) -> None:
    """Run one row in this process and print it as JSON."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "noise.png"
        cv2.imwrite(str(path), picture(samples))
        warm(Path(folder))
        peak = Path("/proc/self/clear_refs")
        if peak.exists():
            peak.write_text("5")
        start = time.perf_counter()
        row = JOBS[name](path, Path(folder), share)
        row.setdefault("seconds", time.perf_counter() - start)
    row["peak_mb"] = peak_mb()
    print(json.dumps({"job": name, "samples": samples, "error": share, **row}))


def peak_mb() -> float:
    """Largest resident memory since it was last cleared, MB."""
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines() if ":" in line)
        return int(lines["VmHWM"].split()[0]) * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def measured(plan: tuple[tuple[str, int, float], ...], console: Console) -> list[Row]:
    rows: list[Row] = []
    for name, samples, share in track(plan, description="worlds", console=console, transient=True):
        if "pydelatin" in name and importlib.util.find_spec("pydelatin") is None:
            continue
        command = [sys.executable, __file__, "--one", name, str(samples), str(share)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        rows.append(json.loads(done.stdout.splitlines()[-1]))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="pictures of at most 513^2")
    parser.add_argument("--json", type=Path, help="write the figures here")
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        run_one(args.one[0], int(args.one[1]), float(args.one[2]))
        return
    console = Console()
    rows = measured(QUICK if args.quick else PLAN, console)
    table = Table("job", "picture", "error", "seconds", "peak MB", "triangles", "MB")
    for row in rows:
        size, error = f"{float(row.get('bytes', 0)) / 1e6:.1f}", f"{row['error']:g}"
        time_, peak = f"{row['seconds']:.2f}", f"{row['peak_mb']:.0f}"
        table.add_row(
            str(row["job"]), f"{row['samples']}^2", error, time_, peak, f"{row['triangles']:,}", size
        )
    console.print(table)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
