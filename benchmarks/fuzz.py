"""Damaged files against the command line and against the readers.

    python benchmarks/fuzz.py inputs [--count 1000] [--seed 1] [--names KIND,...]
    python benchmarks/fuzz.py readers [--seconds 60] [--names READER,...]

`inputs`: a valid file is mutated, and the command that reads it runs in a forked process. Demanded are exit
code 0, 2 or 3; for 2 one line, which starts with the path of a file; no output of libraries; limits of time
and memory; nothing half-written. `readers`: coverage-guided bytes; each reader returns a value or raises a
WctError. Needs the package atheris. READER.log has a crash's traceback, READER-crash-* its bytes.
"""

from __future__ import annotations

import contextlib
import gzip
import json
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import cv2
import numpy as np
import rasterio
import trimesh
from numpy.typing import NDArray
from PIL import Image
from rasterio.transform import from_origin

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

LIMIT_S, HANG_S, LIMIT_GB, ADDRESS_GB = 10.0, 60, 1.0, 6.0
"""Processor seconds, wall seconds, resident memory and address space of one input."""
ODD_NUMBERS = ("nan", "inf", "-inf", "1e300", "-1e300", "-1", "0", "1e-300", "99999999999999999999", "", "x")
EXTREME_WORDS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
HEADER_BYTES = 256
"""Bytes at the start of a binary file that count as its header."""
NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
NOT_OURS = re.compile(
    r"Traceback|libpng|libjpeg|TIFFRead|TIFFFetch|TIFFOpen|CPLE_|RuntimeWarning|UserWarning|"
    r"DeprecationWarning|\[ WARN|\[ERROR|site-packages|^Corrupt JPEG|terminate called|Segmentation|"
    r"\b[A-Z]\w*(?:Error|Exception)\b|validation errors? for|See previous exception",
    re.MULTILINE,
)
"""Output of libraries and names of exceptions."""
NOTE = re.compile(r".*, .*%\s*$|.*: its map is |\s*$")
"""Lines that tell of progress or of a log that was mapped, and empty ones."""
FINISHED_RUN = Path(__file__).resolve().parents[1] / "tests" / "data" / "run.zip"
PICTURES = (
    *("gray8.png", "gray16.png", "palette.png", "rgba.png", "gray8.jpg", "float.tif", "gray8.pgm"),
    *("ascii.pgm", "gray8.webp", "gray8.bmp", "gray8.gif"),
)
MESHES = ("binary.stl", "ascii.stl", "hill.obj", "binary.ply", "ascii.ply", "hill.dae", "hill.glb")
TEXTS = (
    *("ascii.pgm", "ascii.stl", "hill.obj", "ascii.ply", "hill.dae", "dem.asc", "dem.xyz", "points.ply"),
    *("ascii.pcd", "log.clf", "log.clf.gz", "imu.csv.gz", "run/scans.clf.gz"),
)
"""Files that are mutated as text, in addition to those with the suffixes below."""
TEXT_SUFFIXES = (".yaml", ".json", ".tum", ".csv", ".relations")
CLOUDS = ("a.las", "a.laz", "ascii.pcd", "binary.pcd")
INFO, BUILD, CONVERT = "info {}", "build {} -o out", "convert {} out.stl"
MAP, HECTOR = "map {} --mapper hector -o out", "map in/log.clf --mapper hector -o out"
REPORT, EXPORT = "report in/run -o r.html", "export in/run -o out"
SCORE = "score in/run -o s.json"
SMALL = "validate in/dune.png --size 20 --height 1 --seconds 0.5 -o out --driver"


@dataclass(frozen=True)
class Kind:
    """A kind of input: the file that is mutated, and the commands that read it as `{}`."""

    file: str
    commands: tuple[str, ...]
    wrong_suffixes: tuple[str, ...] = ()

    @property
    def text(self) -> bool:
        """Whether it is mutated as text."""
        return self.file in TEXTS or self.file.endswith(TEXT_SUFFIXES)


def suffixes(names: Sequence[str]) -> tuple[str, ...]:
    """Return the suffixes of files, each once."""
    return tuple(dict.fromkeys(Path(name).suffix for name in names))


KINDS = {
    **{name.replace(".", "_"): Kind(name, (INFO, BUILD), suffixes(PICTURES)) for name in PICTURES},
    **{f"mesh_{name.replace('.', '_')}": Kind(name, (INFO, CONVERT), suffixes(MESHES)) for name in MESHES},
    **{f"cloud_{name.replace('.', '_')}": Kind(name, (INFO,)) for name in CLOUDS},
    "cloud_ply": Kind("points.ply", (INFO,)),
    "geotiff": Kind("dem.tif", (INFO,)),
    "hgt": Kind("N47E008.hgt", ("info {} --window 0,0,5000",)),
    "asc": Kind("dem.asc", (INFO,), (".tif", ".hgt", ".xyz", ".txt")),
    "xyz": Kind("dem.xyz", (INFO,)),
    "map_yaml": Kind("map.yaml", (INFO, BUILD)),
    "map_image": Kind("map.pgm", ("info in/map.yaml", "build in/map.yaml -o out")),
    "texture": Kind("ground.png", ("build in/dune.png --texture {} -o out",)),
    "carmen": Kind("log.clf", (MAP, INFO)),
    "carmen_gz": Kind("log.clf.gz", (MAP,)),
    **{f"bag_{name}": Kind(f"a.{suffix}", (MAP,)) for name, suffix in
       (("mcap", "mcap"), ("db3", "db3"), ("ros1", "bag"))},
    "world_json": Kind("world/world.json", ("info in/world", "build in/world -o out")),
    "world_arrays": Kind("world/world.npz", ("info in/world",)),
    "tum": Kind("truth.tum", (f"{SCORE} --trajectory {{}}", f"{HECTOR} --reference {{}}")),
    "relations": Kind("log.relations", (f"{HECTOR} --relations {{}}",)),
    "imu": Kind("imu.csv.gz", (f"{HECTOR} --imu {{}}",)),
    "waypoints_csv": Kind("way.csv", (f"{SMALL} waypoints:{{}}",)),
    "waypoints_yaml": Kind("way.yaml", (f"{SMALL} waypoints:{{}}",)),
    "commands": Kind("run/commands.csv", (f"{SMALL} replay:in/run --robot jackal",)),
    "record": Kind("run/record.json", (REPORT, "compare in/run in/other", EXPORT)),
    "run_scans": Kind("run/scans.clf.gz", (f"{EXPORT} --to csv",)),
    "run_estimate": Kind("run/estimate.tum", (REPORT, f"{EXPORT} --to csv")),
    "run_truth": Kind("run/truth.tum", (f"{SCORE} --trajectory in/other/estimate.tum",)),
    "run_map": Kind("run/map.yaml", (REPORT, EXPORT)),
    "run_map_pgm": Kind("run/map.pgm", (REPORT, EXPORT)),
    "score_map": Kind("other/map.yaml", (f"{SCORE} --map {{}} --frame world",)),
    "task_set": Kind("tasks.json", ("bench straight --set {} -o out",)),
}  # fmt: skip
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
    """Write a valid file of every kind."""
    folder.mkdir(parents=True)
    for name, text in SMALL_TEXTS.items():
        (folder / name).write_text(text, encoding="utf-8")
    y, x = np.mgrid[0:41, 0:41] / 41
    heights = 0.5 + 0.3 * np.sin(5 * x) * np.cos(4 * y)
    _write_pictures(folder, heights)
    _write_elevation(folder, (20 * heights).astype(np.float32))
    _write_meshes(folder)
    _write_clouds(folder)
    _write_run(folder)
    entry = set_entry(task_set("lirs"))
    entry["tasks"] = [t for t in entry["tasks"] if t["task"] == "navigation" and t["split"] == "test"][:1]
    (folder / "tasks.json").write_text(json.dumps(entry, indent=1))


def _write_pictures(folder: Path, heights: NDArray[Any]) -> None:
    gray = (255 * heights).astype(np.uint8)
    for name in ("gray8.png", "gray8.jpg", "gray8.pgm", "gray8.webp", "gray8.bmp", "gray8.gif", "dune.png"):
        Image.fromarray(gray).save(folder / name)
    cv2.imwrite(str(folder / "ground.png"), np.dstack((gray, gray // 2, gray // 3)))
    cv2.imwrite(str(folder / "gray16.png"), (65535 * heights).astype(np.uint16))
    cv2.imwrite(str(folder / "rgba.png"), np.dstack((gray, gray, gray, np.full_like(gray, 255))))
    Image.fromarray(gray).convert("P").save(folder / "palette.png")
    Image.fromarray(heights.astype(np.float32)).save(folder / "float.tif")
    Image.fromarray(np.full((40, 60), 254, np.uint8)).save(folder / "map.pgm")
    rows = "\n".join(" ".join(map(str, row)) for row in gray.tolist())
    (folder / "ascii.pgm").write_text(f"P2\n41 41\n255\n{rows}\n")


def _write_elevation(folder: Path, heights: NDArray[Any]) -> None:
    profile = {"driver": "GTiff", "width": 41, "height": 41, "count": 1, "dtype": "float32"}
    profile |= {"crs": "EPSG:32632", "transform": from_origin(500000, 5200000, 1, 1), "nodata": -9999.0}
    with rasterio.open(folder / "dem.tif", "w", **profile) as dataset:
        dataset.write(heights, 1)
    rows = "\n".join(" ".join(f"{v:.2f}" for v in row) for row in heights.tolist())
    (folder / "dem.asc").write_text(
        f"ncols 41\nnrows 41\nxllcorner 500000\nyllcorner 5200000\ncellsize 1\nNODATA_value -9999\n{rows}\n"
    )
    (folder / "dem.xyz").write_text(
        "".join(f"{500_000 + i} {5_200_000 - j} {v:.2f}\n" for (j, i), v in np.ndenumerate(heights))
    )
    y, x = np.mgrid[0:1201, 0:1201]
    (300 + 50 * np.sin(x / 90) * np.cos(y / 70)).astype(">i2").tofile(folder / "N47E008.hgt")


def _write_meshes(folder: Path) -> None:
    """Build a world of the picture, and copy its meshes."""
    call(f"build {folder}/dune.png --size 20 --height 1 --name world --to stl,obj,dae,glb -o {folder}")
    for mesh in (folder / "world" / "meshes").iterdir():
        shutil.copy(mesh, folder / f"hill{mesh.suffix}")
    mesh = trimesh.load_mesh(folder / "hill.stl")
    for name in ("binary.stl", "binary.ply"):
        mesh.export(folder / name)
    mesh.export(folder / "ascii.stl", file_type="stl_ascii")
    mesh.export(folder / "ascii.ply", encoding="ascii")


def _write_clouds(folder: Path) -> None:
    import laspy

    xy = np.random.default_rng(1).uniform(0, 20, (3000, 2))
    xyz = np.column_stack((xy, np.sin(xy[:, 0] / 3)))
    for suffix in ("las", "laz"):
        las = laspy.create(point_format=3, file_version="1.2")
        las.header.scales = [0.001] * 3
        las.x, las.y, las.z = xyz.T
        las.write(str(folder / f"a.{suffix}"))
    rows = "\n".join(" ".join(f"{v:.3f}" for v in row) for row in xyz.tolist())
    head = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    head += "WIDTH 3000\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3000\nDATA "
    (folder / "ascii.pcd").write_text(f"{head}ascii\n{rows}\n")
    (folder / "binary.pcd").write_bytes(f"{head}binary\n".encode() + xyz.astype("<f4").tobytes())
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    (folder / "points.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex 3000\n{properties}end_header\n{rows}\n"
    )


def _write_run(folder: Path) -> None:
    """Write two finished runs, and the log, bags and trajectories of the first."""
    from rosbags.convert import convert
    from rosbags.typesys import Stores, get_typestore

    run = folder / "run"
    with tempfile.TemporaryDirectory() as scratch:
        zipfile.ZipFile(FINISHED_RUN).extractall(scratch)
        for copy in (run, folder / "other"):
            shutil.copytree(next(Path(scratch).glob("*/record.json")).parent, copy)
        for storage, suffix in (("mcap", "mcap"), ("sqlite3", "db3")):
            call(f"export {run} --to bag --storage {storage} -o {scratch}/{storage}")
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
    for source, name in (
        ("scans.clf.gz", "log.clf.gz"),
        ("truth.tum", "truth.tum"),
        ("imu.csv.gz", "imu.csv.gz"),
    ):
        shutil.copy(run / source, folder / name)
    (folder / "log.clf").write_bytes(gzip.decompress((folder / "log.clf.gz").read_bytes()))
    stamps = np.loadtxt(run / "truth.tum")[::4, 0].tolist()
    lines = [f"{a:.6f} {b:.6f} 0.1 0 0 0 0 0\n" for a, b in pairwise(stamps)]
    (folder / "log.relations").write_text("".join(lines))


def call(command: str, *, valid: bool = True) -> int:
    """Run the command line in this process; return its exit code, which is 0 of a valid input."""
    from lirs_validation.cli.app import main as lirs_wct

    sys.argv = ["lirs-wct", *command.split()]
    code = 0
    try:
        lirs_wct()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    if valid and code:
        raise SystemExit(f"{command} ended with {code}")
    return code


def mutate(data: bytes, rng: np.random.Generator, *, text: bool) -> tuple[str, bytes]:
    """Return the name of a random mutation and the mutated bytes."""
    special = [*["number"] * 3, "drop line", "long"] if text else ["extreme", "extreme", "zero"]
    name = str(rng.choice(["truncate", "flip", "noise", "empty", "double", *special]))
    out, place = bytearray(data), int(rng.integers(max(len(data), 1)))
    match name:
        case "truncate":
            return name, data[:place]
        case "flip":
            for k in rng.integers(len(out), size=int(rng.integers(1, 20))).tolist():
                out[k] ^= int(rng.integers(1, 256))
        case "noise":
            return name, rng.bytes(int(rng.integers(1, 4096)))
        case "empty":
            return name, b""
        case "double":
            return name, data + data
        case "long":
            out[place:place] = b"9" * 100_000
        case "zero":
            length = min(int(rng.integers(1, 64)), len(out) - place)
            out[place : place + length] = bytes(length)
        case "extreme":  # a number of 1, 2, 4 or 8 bytes in the header
            width = int(rng.choice((1, 2, 4, 8)))
            place = int(rng.integers(max(min(HEADER_BYTES, len(out)) - width, 1)))
            word = EXTREME_WORDS[int(rng.integers(len(EXTREME_WORDS)))] & (256**width - 1)
            out[place : place + width] = word.to_bytes(width, "little" if rng.random() < 0.5 else "big")
        case "drop line":
            lines = data.splitlines(keepends=True)
            del lines[int(rng.integers(len(lines)))]
            return name, b"".join(lines)
        case _:  # half of the time one of the first numbers, which head most formats
            numbers = list(NUMBER.finditer(data))[: 12 if rng.random() < 0.5 else None]
            if numbers:
                hit = numbers[int(rng.integers(len(numbers)))]
                out[hit.start() : hit.end()] = str(rng.choice(ODD_NUMBERS)).encode()
    return name, bytes(out)


def run_input(kind: Kind, seeds: Path, rng: np.random.Generator) -> tuple[int, str]:
    """Mutate a file in a copy of the valid files, and run a command on it.

    Return its exit code and the demands that it breaks.
    """
    with tempfile.TemporaryDirectory(prefix="fuzz-", ignore_cleanup_errors=True) as folder:
        work = Path(folder)
        shutil.copytree(seeds, work / "in")
        target = work / "in" / kind.file
        data = target.read_bytes()
        if kind.wrong_suffixes and rng.random() < 0.1:
            mutation = "suffix"
            target = target.rename(target.with_suffix(str(rng.choice(kind.wrong_suffixes))))
        elif kind.file.endswith(".gz") and rng.random() < 0.5:  # else the compressed bytes
            mutation, inside = mutate(gzip.decompress(data), rng, text=kind.text)
            target.write_bytes(gzip.compress(inside, 1))
        else:
            mutation, data = mutate(data, rng, text=kind.text and not kind.file.endswith(".gz"))
            target.write_bytes(data)
        command = kind.commands[int(rng.integers(len(kind.commands)))]
        command = command.replace("{}", str(target.relative_to(work)))
        before = _listing(work)
        if not (child := os.fork()):
            _run_in_child(command, work)
        _, status, usage = os.wait4(child, 0)
        seconds, gigabytes = usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20
        said = (work / "stderr").read_text(encoding="utf-8", errors="replace")
        code = os.waitstatus_to_exitcode(status)  # negative = signal
        problems = list(_problems(code, said, before, _listing(work) - before - {"stderr", "stdout"}))
        problems += [f"{seconds:.1f} s"] if seconds > LIMIT_S else []
        problems += [f"{gigabytes:.2f} GB"] if gigabytes > LIMIT_GB else []
    return code, f"{mutation}, {command}: {'; '.join(problems)}\n{said[-1500:]}" if problems else ""


def _run_in_child(command: str, work: Path) -> None:
    """Run the command line in this forked process; never returns."""
    try:
        os.chdir(work)
        for name, number in (("stdout", 1), ("stderr", 2)):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT), number)
        resource.setrlimit(resource.RLIMIT_AS, (int(ADDRESS_GB * 2**30),) * 2)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(HANG_S)
        try:
            code = call(command, valid=False)
        except BaseException:  # as the interpreter would print it
            traceback.print_exc()
            code = 1
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    finally:
        os._exit(99)


def _listing(folder: Path) -> set[str]:
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*")}


def _problems(code: int, said: str, inputs: set[str], left: set[str]) -> Iterator[str]:
    """Yield the demands that an outcome breaks, but those on its cost."""
    lines = [line for line in said.splitlines() if not NOTE.match(line)]
    if code not in (0, 2, 3):
        yield f"exit code {code}"
    if not all(line.startswith(("lirs-wct: ", "skipped ")) for line in lines):
        yield "output that is not ours"
    if match := NOT_OURS.search(said):
        yield f"library output or name of an exception ({match[0]})"
    if len(max(lines, key=len, default="")) > 1000:
        yield "a line of more than 1,000 characters"
    hidden = any("/." in f"/{name}" for name in left)
    if hidden or (code == 2 and any(not name.startswith("in/") and "." in name for name in left)):
        yield f"left behind: {', '.join(sorted(left)[:4])}"
    if code == 2:
        named = re.match(r"lirs-wct: (in/[^:,\s]*)", lines[0] if lines else "")
        if len(lines) != 1 or not named or named[1] not in inputs:
            yield f"no single line with the path first, but {len(lines)}"


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep the output of this process, also of its C libraries, off the terminal."""
    kept, nowhere = (os.dup(1), os.dup(2)), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, handle in enumerate(kept, 1):
            os.dup2(handle, number)


def fuzz_inputs(count: int, seed: int, names: Sequence[str]) -> bool:
    """Run mutated inputs of the kinds in turn; return whether a demand was broken."""
    cv2.setNumThreads(1)
    codes, broken = Counter[int](), 0
    with tempfile.TemporaryDirectory() as folder:
        seeds = Path(folder) / "in"
        with _quiet():
            write_seeds(seeds)
            for kind in (KINDS[name] for name in names):
                for command in kind.commands:  # forked processes inherit libraries and kernels
                    with tempfile.TemporaryDirectory() as work, contextlib.chdir(work):
                        Path("in").symlink_to(seeds)
                        call(command.replace("{}", f"in/{kind.file}"))
        for number in range(count):
            name = names[number % len(names)]
            code, problems = run_input(KINDS[name], seeds, np.random.default_rng((seed, number)))
            codes[code] += 1
            broken += bool(problems)
            if problems:
                print(f"{number} {name}: {problems}", flush=True)
    print(f"exit codes: {dict(codes)}\ninputs: {count}, broken demands: {broken}")
    return bool(broken)


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
    "picture_png": (read_picture, "gray8.png"),
    "ascii_grid": (read_raster, "dem.asc"),
    "stl": (read_mesh, "binary.stl"),
    "stl_text": (read_mesh, "ascii.stl"),
    "obj": (read_mesh, "hill.obj"),
    "ply": (read_mesh, "binary.ply"),
    "collada": (read_mesh, "hill.dae"),
    "glb": (read_mesh, "hill.glb"),
    "cloud_ply": (read_points, "points.ply"),
}
"""Readers and their files. GDAL, laspy and pypcd4 read in a process of their own: `inputs` covers them."""


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
    """Fuzz inputs or readers."""
    given = arguments(__doc__, "part", part="inputs", count=1000, seed=1, seconds=60, names="")
    names = [name for name in given.names.split(",") if name]
    if given.part == "inputs":
        sys.exit(fuzz_inputs(given.count, given.seed, names or list(KINDS)))
    crashed = fuzz_readers(given.seconds, names or list(READERS))
    sys.stdout.flush()
    os._exit(crashed)  # the usual end prints hundreds of errors of instrumented finalizers


if __name__ == "__main__":
    main()
