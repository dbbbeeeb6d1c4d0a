"""Coverage-guided damaged bytes against readers: each returns a value or raises a WctError.

    python benchmarks/fuzz_atheris.py --seconds 20          # all readers in turn
    python benchmarks/fuzz_atheris.py tum cloud_ply

Needs the package atheris, which is in no extra. Prints a table. READER.log in the working folder has a
crash's traceback, READER-crash-* its bytes.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.fuzz_seeds import KINDS, write_seeds
from lirs_envs.sensing.sensors import read_noise
from lirs_extensions.bench.tasks import task_set
from lirs_extensions.search.falsify.drives import read_search_limits
from lirs_validation.logs.map_log import read_trajectory
from lirs_validation.metrics.trajectory import read_constraints
from lirs_validation.record.verdict import read_limits
from lirs_validation.sweep.tasks import read_yaml_fields
from lirs_wct.errors import WctError
from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.formats.drive_files import read_commands, read_imu, read_tum, read_waypoints
from lirs_wct.formats.elevation import read_raster
from lirs_wct.formats.map_server import read_map
from lirs_wct.formats.meshes.reader import read_mesh
from lirs_wct.formats.picture import read_picture
from lirs_wct.formats.point_clouds import read_points
from lirs_wct.formats.rosbag.reader import read_bag
from lirs_wct.formats.rosbag.topics import Topics


@dataclass(frozen=True)
class Reader:
    """A reader of files.

    Attributes:
        read: takes a path.
        seed: kind of `fuzz_seeds` whose file it reads, or the file's name and text.
    """

    read: Callable[[Path], Any]
    seed: str | tuple[str, str]


def _bag(path: Path) -> Any:
    return read_bag(path, Topics())


def _task_set(path: Path) -> Any:
    return task_set(str(path))


READERS = {
    "noise": Reader(read_noise, ("noise.yaml", "lidar:\n  sigma: 0.01\nfaults:\n  dust: 0.1\n")),
    "limits": Reader(read_limits, ("limits.yaml", "drift: 0.05\naccept: []\n")),
    "search_limits": Reader(read_search_limits, ("search.yaml", "slope: [0, 10]\nspeed: [0.2, 1]\n")),
    "suite": Reader(read_yaml_fields, ("suite.yaml", "worlds: [simple]\nseconds: 5\n")),
    "trajectory": Reader(read_trajectory, ("a.tum", "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n")),
    "tum": Reader(read_tum, ("a.tum", "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n")),
    "relations": Reader(read_constraints, ("a.relations", "0 1 0.1 0 0 0 0 0\n")),
    "task_set": Reader(_task_set, "task_set"),
    "commands": Reader(read_commands, "commands"),
    "imu": Reader(read_imu, "imu"),
    "waypoints_csv": Reader(read_waypoints, "waypoints_csv"),
    "waypoints_yaml": Reader(read_waypoints, "waypoints_yaml"),
    "map_yaml": Reader(read_map, "map_yaml"),
    "carmen": Reader(read_carmen, "carmen"),
    "bag_mcap": Reader(_bag, "bag_mcap"),
    "bag_db3": Reader(_bag, "bag_db3"),
    "bag_ros1": Reader(_bag, "bag_ros1"),
    "ascii_pgm": Reader(read_picture, "ascii_pgm"),
    "picture_png": Reader(read_picture, "gray8_png"),
    "ascii_grid": Reader(read_raster, "asc"),
    "stl": Reader(read_mesh, "mesh_binary_stl"),
    "stl_text": Reader(read_mesh, "mesh_ascii_stl"),
    "obj": Reader(read_mesh, "mesh_hill_obj"),
    "ply": Reader(read_mesh, "mesh_binary_ply"),
    "collada": Reader(read_mesh, "mesh_hill_dae"),
    "glb": Reader(read_mesh, "mesh_hill_glb"),
    "cloud_ply": Reader(read_points, "cloud_ply"),
}
"""Readers by name. GDAL, laspy and pypcd4 read in a process of their own: `fuzz_inputs.py` covers them."""


def write_reader_seeds(folder: Path, names: tuple[str, ...] = tuple(READERS)) -> dict[str, Path]:
    """Write a valid file for each reader; return the paths by name."""
    named = {READERS[name].seed for name in names}
    kinds = [kind for kind in KINDS if kind.name in named]
    if kinds:
        write_seeds(folder, kinds)
    files = {kind.name: folder / kind.name / kind.file for kind in kinds}
    found = {}
    for name in names:
        seed = READERS[name].seed
        if isinstance(seed, str):
            found[name] = files[seed]
        else:
            found[name] = folder / name / seed[0]
            found[name].parent.mkdir(parents=True)
            found[name].write_text(seed[1], encoding="utf-8")
    return found


def read_bytes(name: str, path: Path, data: bytes) -> None:
    """Read a file of these bytes in place of a valid one; a WctError is an answer."""
    path.write_bytes(data)
    with contextlib.suppress(WctError):
        READERS[name].read(path)


def fuzz(name: str, path: Path, seconds: int) -> None:
    """Fuzz one reader for a time, then end this process: libFuzzer does not return."""
    import atheris

    with tempfile.TemporaryDirectory() as corpus:
        shutil.copy(path, corpus)
        limits = [
            f"-max_total_time={seconds}",
            "-timeout=30",
            "-rss_limit_mb=4096",
            "-print_final_stats=1",
            f"-artifact_prefix={name}-",
        ]
        atheris.Setup([sys.argv[0], *limits, corpus], lambda data: read_bytes(name, path, data))
        atheris.Fuzz()


def fuzz_in_child(name: str, path: Path, seconds: int) -> tuple[str, bool]:
    """Fuzz one reader in a child process; return the number of inputs and whether one crashed."""
    log = Path(f"{name}.log")
    if not (child := os.fork()):
        with log.open("w") as target:
            os.dup2(target.fileno(), 1)
            os.dup2(target.fileno(), 2)
        fuzz(name, path, seconds)
    status = os.waitpid(child, 0)[1]
    inputs = re.search(r"number_of_executed_units: (\d+)", log.read_text(errors="replace"))
    return inputs[1] if inputs else "?", status != 0


def main() -> None:
    """Fuzz readers in turn; the code is instrumented once, for that takes minutes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "readers", nargs="*", metavar="reader", help=f"all if not given: {', '.join(READERS)}"
    )
    parser.add_argument("--seconds", type=int, default=60, help="per reader")
    given = parser.parse_args()
    if unknown := set(given.readers) - set(READERS):
        parser.error(f"no such reader: {', '.join(sorted(unknown))}")
    import atheris

    crashes = 0
    with tempfile.TemporaryDirectory() as folder:
        # Before instrumentation: numba cannot compile instrumented functions, and seeds are files of a drive.
        paths = write_reader_seeds(Path(folder) / "seeds", tuple(given.readers or READERS))
        atheris.instrument_all()
        print("| reader | inputs | crashes |\n|---|---|---|")
        for name, path in paths.items():
            inputs, crashed = fuzz_in_child(name, path, given.seconds)
            print(f"| {name} | {inputs} | {int(crashed)} |", flush=True)
            crashes += crashed
    os._exit(bool(crashes))  # the usual end prints hundreds of errors of instrumented finalizers


if __name__ == "__main__":
    main()
