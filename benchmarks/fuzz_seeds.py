"""Small valid files of every kind that the command line reads, and the commands that read them."""

from __future__ import annotations

import gzip
import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from PIL import Image
from rasterio.transform import from_origin

PICTURES = (".png", ".jpg", ".tif", ".pgm", ".webp", ".bmp", ".gif")
MESHES = (".stl", ".obj", ".ply", ".dae", ".glb")
INFO = ("info {}", "build {} -o out")
RUN = "in/run"


@dataclass(frozen=True)
class Kind:
    """A kind of input.

    Attributes:
        name: of the kind, and of the folder that holds its valid files.
        file: that is mutated, within that folder.
        commands: that read it; `{}` is the file.
        text: whether it is text.
        wrong_suffixes: suffixes of other formats.
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
