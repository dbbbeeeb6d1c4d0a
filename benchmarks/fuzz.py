"""Damaged files against the command line and against the readers.

    python benchmarks/fuzz.py inputs [--count 1000] [--seed 1] [--names KIND,...] [--keep FOLDER]
    python benchmarks/fuzz.py readers [--seconds 60] [--names READER,...]

`inputs`: valid files of every kind are written, one is mutated per input, and the command that reads it runs
in a forked process. Demanded of every input: exit code 0, 2 or 3; only lines of ours on stderr; for 2 exactly
one line, which starts with the path of a file; no traceback, no bare name of an exception, no output of a C
library; below the limits of time and memory; nothing half-written.

`readers`: coverage-guided bytes; each reader returns a value or raises a WctError. Needs the package atheris,
which is in no extra. READER.log in the working folder has a crash's traceback, READER-crash-* its bytes.
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
from numpy.typing import NDArray
from PIL import Image
from rasterio.transform import from_origin

from benchmarks.steps import arguments
from lirs_envs.sensing.sensors import read_noise
from lirs_extensions.bench.tasks import task_set
from lirs_extensions.search.falsify.drives import read_search_limits
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
"""Processor seconds, wall seconds and resident memory of one input; address space, beyond which an
allocation fails. Processor time does not depend on the load of the machine."""
ODD_NUMBERS = ("nan", "inf", "-inf", "1e300", "-1e300", "-1", "0", "1e-300", "99999999999999999999", "", "x")
EXTREME_WORDS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
HEADER_BYTES = 256
"""Bytes at the start of a binary file that count as its header."""
NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
BARE_NAME = re.compile(r"\b[A-Z]\w*(?:Error|Exception)\b|validation errors? for|See previous exception")
LIBRARY = re.compile(
    r"Traceback|libpng|libjpeg|TIFFRead|TIFFFetch|TIFFOpen|CPLE_|RuntimeWarning|UserWarning|"
    r"DeprecationWarning|\[ WARN|\[ERROR|site-packages|^Corrupt JPEG|terminate called|Segmentation",
    re.MULTILINE,
)
NOTE = re.compile(r".*, .*%\s*$|.*: its map is |\s*$")
"""Lines that tell of progress or of a log that was mapped, and empty ones."""
PICTURES = (".png", ".jpg", ".tif", ".pgm", ".webp", ".bmp", ".gif")
MESHES = (".stl", ".obj", ".ply", ".dae", ".glb")
INFO = ("info {}", "build {} -o out")
RUN = "in/run"


@dataclass(frozen=True)
class Kind:
    """A kind of input.

    Attributes:
        name: Name of the kind, and of the folder that holds its valid files.
        file: Mutated file, within that folder.
        commands: Commands that read it; `{}` is the file.
        text: Whether it is text.
        wrong_suffixes: Suffixes of other formats.
    """

    name: str
    file: str
    commands: tuple[str, ...] = INFO
    text: bool = False
    wrong_suffixes: tuple[str, ...] = ()


def _pictures() -> list[Kind]:
    names = ["gray8.png", "gray16.png", "palette.png", "rgba.png", "gray8.jpg", "float.tif", "gray8.pgm"]
    names += ["ascii.pgm", "gray8.webp", "gray8.bmp", "gray8.gif"]
    return [
        Kind(name.replace(".", "_"), name, text=name == "ascii.pgm", wrong_suffixes=PICTURES)
        for name in names
    ]


def _run_file(name: str, file: str, *commands: str, text: bool = True) -> Kind:
    return Kind(name, f"run/{file}", commands, text)


KINDS = (
    *_pictures(),
    Kind("geotiff", "dem.tif", ("info {}",)),
    Kind("hgt", "N47E008.hgt", ("info {} --window 0,0,5000",)),
    Kind("asc", "dem.asc", ("info {}",), text=True, wrong_suffixes=(".tif", ".hgt", ".xyz", ".txt")),
    Kind("xyz", "dem.xyz", ("info {}",), text=True),
    Kind("map_yaml", "map.yaml", INFO, text=True),
    Kind("map_image", "map.pgm", ("info in/map.yaml", "build in/map.yaml -o out")),
    Kind("texture", "ground.png", ("build in/dune.png --texture {} -o out",)),
    *(
        Kind(f"mesh_{name.replace('.', '_')}", name, ("info {}", "convert {} out.stl"), text, MESHES)
        for name, text in (
            ("binary.stl", False),
            ("ascii.stl", True),
            ("hill.obj", True),
            ("binary.ply", False),
            ("ascii.ply", True),
            ("hill.dae", True),
            ("hill.glb", False),
        )
    ),
    *(
        Kind(f"cloud_{name.replace('.', '_')}", name, ("info {}",), text)
        for name, text in (("a.las", False), ("a.laz", False), ("ascii.pcd", True), ("binary.pcd", False))
    ),
    Kind("cloud_ply", "points.ply", ("info {}",), text=True),
    Kind("carmen", "log.clf", ("map {} --mapper hector -o out", "info {}"), text=True),
    Kind("carmen_gz", "log.clf.gz", ("map {} --mapper hector -o out",), text=True),
    Kind("bag_mcap", "a.mcap", ("map {} --mapper hector -o out",)),
    Kind("bag_db3", "a.db3", ("map {} --mapper hector -o out",)),
    Kind("bag_ros1", "a.bag", ("map {} --mapper hector -o out",)),
    Kind("world_json", "world/world.json", ("info in/world", "build in/world -o out"), text=True),
    Kind("world_arrays", "world/world.npz", ("info in/world",)),
    Kind(
        "tum",
        "truth.tum",
        (f"score {RUN} --trajectory {{}} -o s.json", "map in/log.clf --mapper hector --reference {} -o out"),
        text=True,
    ),
    Kind("relations", "log.relations", ("map in/log.clf --mapper hector --relations {} -o out",), text=True),
    Kind("imu", "imu.csv.gz", ("map in/log.clf --mapper hector --imu {} -o out",), text=True),
    *(
        Kind(
            f"waypoints_{suffix}",
            f"way.{suffix}",
            ("validate in/dune.png --size 20 --height 1 --seconds 0.5 --driver waypoints:{} -o out",),
            text=True,
        )
        for suffix in ("csv", "yaml")
    ),
    _run_file(
        "commands",
        "commands.csv",
        f"validate in/dune.png --size 20 --height 1 --option name=run --seconds 1 --driver replay:{RUN}",
    ),
    _run_file(
        "record", "record.json", f"report {RUN} -o r.html", f"compare {RUN} in/other", f"export {RUN} -o out"
    ),
    _run_file("run_scans", "scans.clf.gz", f"export {RUN} --to csv -o out"),
    _run_file("run_estimate", "estimate.tum", f"report {RUN} -o r.html", f"export {RUN} --to csv -o out"),
    _run_file("run_truth", "truth.tum", f"score {RUN} --trajectory in/est.tum -o s.json"),
    _run_file("run_map", "map.yaml", f"report {RUN} -o r.html", f"export {RUN} -o out"),
    _run_file("run_map_pgm", "map.pgm", f"report {RUN} -o r.html", text=False),
    Kind("score_map", "est.yaml", (f"score {RUN} --map {{}} --frame world -o s.json",), text=True),
    Kind("task_set", "tasks.json", ("bench straight --set {} -o out",), text=True),
)


def write_seeds(folder: Path, kinds: Sequence[Kind] = KINDS) -> None:
    """Write the valid files of each kind to a folder of its name."""
    shared = folder / "shared"
    shared.mkdir(parents=True)
    _write_pictures(shared)
    _write_elevation(shared)
    _write_meshes(shared)
    _write_clouds(shared)
    _write_tables(shared)
    if any(not (shared / Path(kind.file).parts[0]).exists() for kind in kinds):
        _write_run(shared)
    for kind in kinds:
        _link(kind, shared, folder / kind.name)


def _link(kind: Kind, shared: Path, folder: Path) -> None:
    """Copy the files that a kind's commands name."""
    named = {kind.file, *(word[3:] for c in kind.commands for word in c.split() if word.startswith("in/"))}
    named |= {"run", "other"} if any(RUN in c for c in kind.commands) else set()
    named |= {"map.pgm"} if {"map.yaml", "est.yaml"} & named else set()
    for top in {Path(name).parts[0] for name in named}:
        if (shared / top).is_dir():
            shutil.copytree(shared / top, folder / top)
        elif (shared / top).is_file():
            folder.mkdir(exist_ok=True)
            shutil.copy(shared / top, folder / top)


def _heights(n: int = 41) -> NDArray[Any]:
    y, x = np.mgrid[0:n, 0:n] / n
    heights: NDArray[Any] = 0.5 + 0.3 * np.sin(5 * x) * np.cos(4 * y)
    return heights


def _write_pictures(folder: Path) -> None:
    gray = (255 * _heights()).astype(np.uint8)
    for suffix in ("png", "jpg", "pgm", "webp", "bmp"):
        cv2.imwrite(str(folder / f"gray8.{suffix}"), gray)
    shutil.copy(folder / "gray8.png", folder / "dune.png")
    cv2.imwrite(str(folder / "ground.png"), np.dstack((gray, gray // 2, gray // 3)))
    cv2.imwrite(str(folder / "gray16.png"), (65535 * _heights()).astype(np.uint16))
    cv2.imwrite(str(folder / "rgba.png"), np.dstack((gray, gray, gray, np.full_like(gray, 255))))
    Image.fromarray(gray).convert("P").save(folder / "palette.png")
    Image.fromarray(gray).save(folder / "gray8.gif")
    Image.fromarray(_heights().astype(np.float32)).save(folder / "float.tif")
    rows = "\n".join(" ".join(map(str, row)) for row in gray.tolist())
    (folder / "ascii.pgm").write_text(f"P2\n41 41\n255\n{rows}\n")


def _write_elevation(folder: Path) -> None:
    heights = (20 * _heights()).astype(np.float32)
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
    import trimesh

    n = 21
    y, x = np.mgrid[0:n, 0:n]
    z = 3 * _heights(n)
    k = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate((np.stack((k, k + 1, k + n), 1), np.stack((k + 1, k + n + 1, k + n), 1)))
    mesh = trimesh.Trimesh(np.stack((x.ravel(), y.ravel(), z.ravel()), 1).astype(float), faces)
    mesh.export(folder / "binary.stl", file_type="stl")
    mesh.export(folder / "ascii.stl", file_type="stl_ascii")
    mesh.export(folder / "binary.ply", file_type="ply")
    mesh.export(folder / "ascii.ply", file_type="ply", encoding="ascii")
    mesh.export(folder / "hill.obj", file_type="obj")
    mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))  # y is up in these
    for suffix in ("dae", "glb"):
        mesh.export(folder / f"hill.{suffix}", file_type=suffix)


def _write_clouds(folder: Path) -> None:
    import laspy

    rng = np.random.default_rng(1)
    xy = rng.uniform(0, 20, (3000, 2))
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
    """Write two finished runs, and their logs, bags and trajectories."""
    drive = f"validate {folder}/dune.png --size 20 --height 1 --seconds 2 --option name=run"
    for name, seed in (("run", 1), ("other", 2)):
        _lirs_wct(f"{drive} --seed {seed} -o {folder}/all{seed}")
        (made,) = (p for p in (folder / f"all{seed}").iterdir() if p.is_dir())
        shutil.copytree(made, folder / name)
    run = folder / "run"
    for storage, suffix in (("mcap", "mcap"), ("sqlite3", "db3")):
        _lirs_wct(f"export {run} --to bag --storage {storage} -o {folder}/{storage}")
        (bag,) = (folder / storage).rglob(f"*.{suffix}")
        shutil.copy(bag, folder / f"a.{suffix}")
    _write_ros1(folder)
    _write_relations(folder)
    shutil.copy(run / "scans.clf.gz", folder / "log.clf.gz")
    (folder / "log.clf").write_bytes(gzip.decompress((folder / "log.clf.gz").read_bytes()))
    text = (run / "map.yaml").read_text().replace("image: ", "image: run/")
    (folder / "est.yaml").write_text(text)
    for name, file in (("truth.tum", "truth.tum"), ("est.tum", "estimate.tum"), ("imu.csv.gz", "imu.csv.gz")):
        shutil.copy(run / file, folder / name)


def _write_ros1(folder: Path) -> None:
    from rosbags.convert import convert
    from rosbags.typesys import Stores, get_typestore

    convert(
        [folder / "sqlite3" / "bag"],
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


def _write_tables(folder: Path) -> None:
    """Write a built world, waypoints, a map and a task set."""
    _lirs_wct(f"build {folder}/dune.png --size 20 --height 1 --name world --to map -o {folder}")
    (folder / "way.csv").write_text("x,y,yaw\n0,0,0\n1,0.5,0\n2,1,0\n")
    (folder / "way.yaml").write_text("waypoints:\n- [0, 0]\n- {x: 1, y: 0.5}\n- [2, 1, 0.3]\n")
    from lirs_extensions.bench.tasks import set_entry, task_set

    entry = set_entry(task_set("lirs"))
    entry["tasks"] = [t for t in entry["tasks"] if t["task"] == "navigation" and t["split"] == "test"][:1]
    (folder / "tasks.json").write_text(json.dumps(entry, indent=1))
    Image.fromarray(np.full((40, 60), 254, np.uint8)).save(folder / "map.pgm")
    (folder / "map.yaml").write_text(
        "image: map.pgm\nresolution: 0.1\norigin: [-1.0, -1.0, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\nmode: trinary\n"
    )


def _write_relations(folder: Path) -> None:
    stamps = np.loadtxt(folder / "run" / "truth.tum")[::4, 0].tolist()
    (folder / "log.relations").write_text(
        "".join(f"{a:.6f} {b:.6f} 0.1 0 0 0 0 0\n" for a, b in pairwise(stamps))
    )


def _lirs_wct(command: str) -> None:
    if code := call(command.split()):
        raise RuntimeError(f"{command} ended with {code}")


def call(arguments: Sequence[str]) -> int:
    """Run the command line in this process; return its exit code."""
    from lirs_validation.cli.app import main as lirs_wct

    sys.argv = ["lirs-wct", *arguments]
    try:
        lirs_wct()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    return 0


@dataclass(frozen=True)
class Outcome:
    """Result of one input: exit status, negative = signal; cost; stderr; the demands that it breaks."""

    kind: str
    mutation: str
    code: int
    seconds: float
    gigabytes: float
    said: str
    problems: list[str]


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


def run_input(kind: Kind, folder: Path, rng: np.random.Generator, keep: Path | None = None) -> Outcome:
    """Mutate a copy of a kind's valid files, run its command on them, and check the outcome."""
    work = Path(tempfile.mkdtemp(prefix="fuzz-"))
    try:
        shutil.copytree(folder, work / "in", symlinks=True)
        target = work / "in" / kind.file
        data = target.read_bytes()
        if kind.wrong_suffixes and rng.random() < 0.1:
            mutation, target = (
                "suffix",
                target.rename(target.with_suffix(str(rng.choice(kind.wrong_suffixes)))),
            )
        elif kind.file.endswith(".gz") and rng.random() < 0.5:  # else the compressed bytes
            mutation, inside = mutate(gzip.decompress(data), rng, text=kind.text)
            target.write_bytes(gzip.compress(inside, 1))
        else:
            mutation, data = mutate(data, rng, text=kind.text and not kind.file.endswith(".gz"))
            target.write_bytes(data)
        command = kind.commands[int(rng.integers(len(kind.commands)))]
        words = [word.replace("{}", str(target.relative_to(work))) for word in command.split()]
        outcome = _run_forked(kind.name, mutation, words, work)
        if outcome.problems and keep is not None:
            shutil.copytree(work, keep, dirs_exist_ok=True)
            (keep / "command.txt").write_text(" ".join(words) + "\n" + outcome.said, encoding="utf-8")
        return outcome
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _run_forked(kind: str, mutation: str, words: Sequence[str], work: Path) -> Outcome:
    before = _listing(work)
    if not (child := os.fork()):
        _run_in_child(words, work)
    _, status, usage = os.wait4(child, 0)
    seconds, gigabytes = usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20
    said = (work / "stderr").read_text(encoding="utf-8", errors="replace")
    code = os.waitstatus_to_exitcode(status)
    left = sorted(_listing(work) - before - {"stderr", "stdout"})
    problems = list(_problems(code, said, before, left))
    problems += [f"{seconds:.1f} s"] if seconds > LIMIT_S else []
    problems += [f"{gigabytes:.2f} GB"] if gigabytes > LIMIT_GB else []
    return Outcome(kind, mutation, code, seconds, gigabytes, said, problems)


def _run_in_child(words: Sequence[str], work: Path) -> None:
    """Run the command line in this forked process; never returns."""
    try:
        os.chdir(work)
        for name, number in (("stdout", 1), ("stderr", 2)):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT), number)
        resource.setrlimit(resource.RLIMIT_AS, (int(ADDRESS_GB * 2**30),) * 2)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(HANG_S)
        try:
            code = call(words)
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


def _problems(code: int, said: str, inputs: set[str], left: Sequence[str]) -> Iterator[str]:
    """Yield the demands that an outcome breaks, but those on its cost."""
    lines = [line for line in said.splitlines() if not NOTE.match(line)]
    if code not in (0, 2, 3):
        yield f"exit code {code}"
    if not all(line.startswith(("lirs-wct: ", "skipped ")) for line in lines):
        yield "output that is not ours"
    for pattern, problem in ((LIBRARY, "library output"), (BARE_NAME, "name of an exception")):
        if match := pattern.search(said):
            yield f"{problem} ({match[0]})"
    if len(max(lines, key=len, default="")) > 1000:
        yield "a line of more than 1,000 characters"
    hidden = [name for name in left if "/." in f"/{name}"]
    if hidden or (code == 2 and any(not name.startswith("in/") and "." in name for name in left)):
        yield f"left behind: {', '.join(left[:4])}"
    if code == 2 and len(lines) != 1:
        yield f"exit code 2 with {len(lines)} lines"
    elif code == 2:
        named = re.match(r"lirs-wct: (in/[^:,\s]*)", lines[0])
        if not named or named[1] not in inputs:
            yield "no path first"


def warm_up(seeds: Path, kinds: Sequence[Kind]) -> None:
    """Run every command on its valid file: forked processes inherit libraries and kernels."""
    cv2.setNumThreads(1)
    for kind in kinds:
        for command in kind.commands:
            with tempfile.TemporaryDirectory() as work, _quiet(), contextlib.chdir(work):
                shutil.copytree(seeds / kind.name, "in")
                code = call([word.replace("{}", f"in/{kind.file}") for word in command.split()])
            if code:
                raise SystemExit(f"valid {kind.name} ended with {code}: {command}")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep the output of this process, also of its C libraries, off the terminal."""
    kept, nowhere = [os.dup(1), os.dup(2)], os.open(os.devnull, os.O_WRONLY)
    _redirect(nowhere, nowhere)
    try:
        yield
    finally:
        _redirect(*kept)
        for handle in (nowhere, *kept):
            os.close(handle)


def _redirect(out: int, err: int) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os.dup2(out, 1)
    os.dup2(err, 2)


def fuzz_inputs(count: int, seed: int, names: Sequence[str], keep: Path | None) -> bool:
    """Run mutated inputs of the kinds in turn, print the figures; return whether a demand was broken."""
    kinds = [kind for kind in KINDS if not names or kind.name in names]
    outcomes = []
    with tempfile.TemporaryDirectory() as folder:
        seeds = Path(folder)
        with _quiet():
            write_seeds(seeds, kinds)
        warm_up(seeds, kinds)
        for number in range(count):
            kind = kinds[number % len(kinds)]
            where = None if keep is None else keep / f"{number}-{kind.name}"
            outcome = run_input(kind, seeds / kind.name, np.random.default_rng((seed, number)), where)
            outcomes.append(outcome)
            if outcome.problems:
                print(f"{number} {kind.name} {outcome.mutation}: {'; '.join(outcome.problems)}")
                print("    " + outcome.said[-1500:].strip().replace("\n", "\n    "), flush=True)
    slowest, largest = max(outcomes, key=lambda o: o.seconds), max(outcomes, key=lambda o: o.gigabytes)
    print("exit codes:", dict(Counter(o.code for o in outcomes)))
    print(f"slowest: {slowest.seconds:.1f} s ({slowest.kind}, {slowest.mutation})")
    print(f"largest memory: {largest.gigabytes:.2f} GB ({largest.kind}, {largest.mutation})")
    broken = sum(bool(o.problems) for o in outcomes)
    print(f"inputs: {len(outcomes)}, broken demands: {broken}")
    return bool(broken)


@dataclass(frozen=True)
class Reader:
    """A reader of files.

    Attributes:
        read: Function of a path.
        seed: Kind whose file it reads, or the file's name and text.
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
"""Readers by name. GDAL, laspy and pypcd4 read in a process of their own: `inputs` covers them."""


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


def fuzz_readers(seconds: int, names: Sequence[str]) -> bool:
    """Fuzz readers in turn; return whether one crashed. The code is instrumented once: that takes minutes."""
    import atheris

    crashes = 0
    with tempfile.TemporaryDirectory() as folder:
        # Before instrumentation: numba cannot compile instrumented functions, and seeds are files of a drive.
        paths = write_reader_seeds(Path(folder) / "seeds", tuple(names or READERS))
        atheris.instrument_all()
        print("| reader | inputs | crashes |\n|---|---|---|")
        for name, path in paths.items():
            inputs, crashed = fuzz_in_child(name, path, seconds)
            print(f"| {name} | {inputs} | {int(crashed)} |", flush=True)
            crashes += crashed
    return bool(crashes)


def main() -> None:
    """Fuzz inputs or readers."""
    given = arguments(__doc__, "part", part="inputs", count=1000, seed=1, seconds=60, names="", keep=Path)
    names = [name for name in given.names.split(",") if name]
    if given.part == "inputs":
        sys.exit(fuzz_inputs(given.count, given.seed, names, given.keep))
    crashed = fuzz_readers(given.seconds, names)
    sys.stdout.flush()
    os._exit(crashed)  # the usual end prints hundreds of errors of instrumented finalizers


if __name__ == "__main__":
    main()
