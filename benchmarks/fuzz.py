"""Coverage-guided bytes for the readers of files: each returns a value or raises a WctError.

    python benchmarks/fuzz.py [READER ...] [--seconds 60]

Needs the package atheris. READER.log has a crash's traceback, READER-crash-* its bytes. GDAL, laspy and
pypcd4 read in a process of their own, which coverage does not reach.
"""

from __future__ import annotations

import contextlib
import gzip
import json
import os
import re
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from benchmarks.steps import arguments
from lirs_envs.sensing.sensors import read_noise
from lirs_extensions.bench.tasks import set_entry, task_set
from lirs_extensions.search.falsify.search import read_search_limits
from lirs_validation.logs.read_log import read_constraints, read_trajectory
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

FINISHED_RUN = Path(__file__).resolve().parents[1] / "tests" / "data" / "run.zip"
SMALL_TEXTS = {
    "noise.yaml": "lidar:\n  sigma: 0.01\nfaults:\n  dust: 0.1\n",
    "limits.yaml": "drift: 0.05\naccept: []\n",
    "search.yaml": "slope: [0, 10]\nspeed: [0.2, 1]\n",
    "suite.yaml": "worlds: [simple]\nseconds: 5\n",
    "a.tum": "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n",
    "a.relations": "0 1 0.1 0 0 0 0 0\n",
    "way.csv": "x,y,yaw\n0,0,0\n1,0.5,0\n2,1,0\n",
    "way.yaml": "waypoints:\n- [0, 0]\n- {x: 1, y: 0.5}\n- [2, 1, 0.3]\n",
    "map.yaml": "image: map.pgm\nresolution: 0.1\norigin: [-1.0, -1.0, 0.0]\nnegate: 0\n"
    "occupied_thresh: 0.65\nfree_thresh: 0.196\nmode: trinary\n",
}
"""Valid files of a few lines."""


def write_seeds(folder: Path) -> None:
    """Write a valid file for every reader, and for readers in a process of their own."""
    folder.mkdir(parents=True)
    for name, text in SMALL_TEXTS.items():
        (folder / name).write_text(text, encoding="utf-8")
    y, x = np.mgrid[0:41, 0:41] / 41
    heights = (0.5 + 0.3 * np.sin(5 * x) * np.cos(4 * y)).astype(np.float32)
    gray = (255 * heights).astype(np.uint8)
    for name in ("dune.png", "gray8.jpg", "gray8.gif"):
        Image.fromarray(gray).save(folder / name)
    Image.fromarray(heights).save(folder / "float.tif")
    Image.fromarray(np.full((40, 60), 254, np.uint8)).save(folder / "map.pgm")
    rows = "\n".join(" ".join(map(str, row)) for row in gray.tolist())
    (folder / "ascii.pgm").write_text(f"P2\n41 41\n255\n{rows}\n")
    (folder / "dem.asc").write_text(
        f"ncols 41\nnrows 41\nxllcorner 500000\nyllcorner 5200000\ncellsize 1\nNODATA_value -9999\n{rows}\n"
    )
    lines = (f"{500_000 + i} {5_200_000 - j} {v:.2f}\n" for (j, i), v in np.ndenumerate(20 * heights))
    (folder / "dem.xyz").write_text("".join(lines))
    points = "\n".join(f"{i} {j} {5 * v:.2f}" for (j, i), v in np.ndenumerate(heights))
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    header = f"ply\nformat ascii 1.0\nelement vertex {heights.size}\n{properties}end_header\n"
    (folder / "points.ply").write_text(f"{header}{points}\n")
    entry = set_entry(task_set("lirs"))
    entry["tasks"] = [t for t in entry["tasks"] if t["task"] == "navigation" and t["split"] == "test"][:1]
    (folder / "tasks.json").write_text(json.dumps(entry, indent=1))
    _write_meshes(folder)
    _write_run(folder)


def _write_meshes(folder: Path) -> None:
    """Build a world of the picture, and copy its meshes."""
    _call(f"build {folder}/dune.png --size 20 --height 1 --name world --to stl,obj,dae,glb -o {folder}")
    for file in (folder / "world" / "meshes").iterdir():
        shutil.copy(file, folder / f"hill{file.suffix}")
    mesh = trimesh.load_mesh(folder / "hill.stl")
    mesh.export(folder / "binary.ply")
    mesh.export(folder / "ascii.stl", file_type="stl_ascii")


def _write_run(folder: Path) -> None:
    """Write a finished run, its log and its bags."""
    from rosbags.convert import convert
    from rosbags.typesys import Stores, get_typestore

    run = folder / "run"
    with tempfile.TemporaryDirectory() as scratch:
        zipfile.ZipFile(FINISHED_RUN).extractall(scratch)
        shutil.copytree(next(Path(scratch).glob("*/record.json")).parent, run)
        for storage, suffix in (("mcap", "mcap"), ("sqlite3", "db3")):
            _call(f"export {run} --to bag --storage {storage} -o {scratch}/{storage}")
            shutil.copy(next(Path(scratch, storage).rglob(f"*.{suffix}")), folder / f"a.{suffix}")
        convert(
            [Path(scratch, "sqlite3", "bag")],
            folder / "a.bag",
            dst_storage=None,
            dst_version=None,
            compress=None,
            compress_mode="message",
            default_typestore=get_typestore(Stores.ROS2_HUMBLE),
            typestore=get_typestore(Stores.ROS1_NOETIC),
            exclude_topics=("/tf_static",),
            include_topics=("/scan", "/odom"),
            exclude_msgtypes=(),
            include_msgtypes=(),
        )
    shutil.copy(run / "imu.csv.gz", folder)
    (folder / "log.clf").write_bytes(gzip.decompress((run / "scans.clf.gz").read_bytes()))


def _call(command: str) -> None:
    """Run a command line in this process."""
    from lirs_validation.cli.app import main as lirs_wct

    sys.argv = ["lirs-wct", *command.split()]
    with contextlib.suppress(SystemExit):
        lirs_wct()


def _bag(path: Path) -> Any:
    return read_bag(path, Topics())


READERS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "noise": (read_noise, "noise.yaml"),
    "limits": (read_limits, "limits.yaml"),
    "search_limits": (read_search_limits, "search.yaml"),
    "suite": (read_yaml_fields, "suite.yaml"),
    "trajectory": (read_trajectory, "a.tum"),
    "tum": (read_tum, "a.tum"),
    "relations": (read_constraints, "a.relations"),
    "task_set": (lambda path: task_set(str(path)), "tasks.json"),
    "commands": (read_commands, "run/commands.csv"),
    "imu": (read_imu, "imu.csv.gz"),
    "waypoints_csv": (read_waypoints, "way.csv"),
    "waypoints_yaml": (read_waypoints, "way.yaml"),
    "map_yaml": (read_map, "map.yaml"),
    "carmen": (read_carmen, "log.clf"),
    "bag_mcap": (_bag, "a.mcap"),
    "bag_db3": (_bag, "a.db3"),
    "bag_ros1": (_bag, "a.bag"),
    "ascii_pgm": (read_picture, "ascii.pgm"),
    "picture_png": (read_picture, "dune.png"),
    "ascii_grid": (read_raster, "dem.asc"),
    "stl": (read_mesh, "hill.stl"),
    "stl_text": (read_mesh, "ascii.stl"),
    "obj": (read_mesh, "hill.obj"),
    "ply": (read_mesh, "binary.ply"),
    "collada": (read_mesh, "hill.dae"),
    "glb": (read_mesh, "hill.glb"),
    "cloud_ply": (read_points, "points.ply"),
}
"""Readers and their files."""


def read_damaged(name: str, seeds: Path, data: bytes) -> None:
    """Read these bytes in a file beside the valid one of a reader; a WctError is an answer."""
    read, file = READERS[name]
    path = (seeds / file).with_name("damaged" + "".join(Path(file).suffixes))
    path.write_bytes(data)
    with contextlib.suppress(WctError):
        read(path)


def fuzz(name: str, seeds: Path, seconds: int) -> None:
    """Fuzz one reader for a time, then end this process: libFuzzer does not return."""
    import atheris

    with tempfile.TemporaryDirectory() as corpus:
        shutil.copy(seeds / READERS[name][1], corpus)
        limits = (f"-max_total_time={seconds}", "-timeout=30", "-rss_limit_mb=4096", "-print_final_stats=1")
        words = [sys.argv[0], *limits, f"-artifact_prefix={name}-", corpus]
        atheris.Setup(words, lambda data: read_damaged(name, seeds, data))
        atheris.Fuzz()


def fuzz_readers(seconds: int, names: Sequence[str]) -> bool:
    """Fuzz readers, each in a child process; return whether one crashed. Instrumentation takes minutes."""
    import atheris

    crashes = 0
    with tempfile.TemporaryDirectory() as folder:
        # Before instrumentation: numba cannot compile instrumented functions.
        write_seeds(seeds := Path(folder) / "seeds")
        atheris.instrument_all()
        print("| reader | inputs | crashes |\n|---|---|---|")
        for name in names:
            log = Path(f"{name}.log")
            if not (child := os.fork()):
                with log.open("w") as target:
                    os.dup2(target.fileno(), 1)
                    os.dup2(target.fileno(), 2)
                fuzz(name, seeds, seconds)
            crashed = os.waitpid(child, 0)[1] != 0
            inputs = re.search(r"number_of_executed_units: (\d+)", log.read_text(errors="replace"))
            print(f"| {name} | {inputs[1] if inputs else '?'} | {int(crashed)} |", flush=True)
            crashes += crashed
    return bool(crashes)


def main() -> None:
    """Fuzz readers."""
    given = arguments(__doc__, "readers", readers=list(READERS), seconds=60)
    crashed = fuzz_readers(given.seconds, given.readers)
    sys.stdout.flush()
    os._exit(crashed)  # the usual end prints hundreds of errors of instrumented finalizers


if __name__ == "__main__":
    main()
