"""The files of a run's folder, and which of them are no longer as they were written."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lirs_wct.formats.rosbag.library import FILES, METADATA, Storage

RECORD = "record.json"
BAG = "bag"
"""Stem of the file of a run's bag, whose folder is the run's."""
WITH_RESULTS = (
    RECORD,
    "overview.png",
    "map.pgm",
    "map.yaml",
    "map_true_pose.pgm",
    "map_true_pose.yaml",
    "truth.tum",
    "estimate.tum",
    "odometry.tum",
    "scans.clf.gz",
    "imu.csv.gz",
    "rtf.csv",
    "commands.csv",
)
"""Of a run that drove."""
OF_PLANAR_MAPPERS = ("map.pgm", "map.yaml")
"""Of these, what mappers of point clouds do not write."""
WITHOUT = (RECORD, "error.txt")
"""Of a run that came to nothing."""


def bag_files(config: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the bag's files in a run's folder; none where it was not recorded."""
    storage: Storage | None = config.get("bag")
    return () if storage is None else (METADATA, f"{BAG}{FILES[storage]}")


def file_sizes(folder: Path) -> dict[str, int]:
    """Return the bytes of each file in a run's folder by name, without the record, which is to hold them."""
    return {path.name: path.stat().st_size for path in sorted(folder.iterdir()) if path.name != RECORD}


def damaged_files(folder: Path, entry: Mapping[str, Any]) -> list[str]:
    """Return the files of a run's folder that are missing, empty or not as long as they were written.

    Of a record without sizes, as older versions wrote them, that is every file.

    Args:
        folder: of the run.
        entry: its record as nested dicts.
    """
    expected: tuple[str, ...] = WITHOUT if entry["status"] in ("error", "timeout") else WITH_RESULTS
    if expected is WITH_RESULTS:
        expected += bag_files(entry["config"])
    if maps_clouds(entry):
        expected = tuple(name for name in expected if name not in OF_PLANAR_MAPPERS)
        expected += tuple(name for name in entry.get("file_sizes", {}) if name == "elevation.npz")
    written: Mapping[str, int] = entry.get("file_sizes", {})
    return [
        name
        for name in expected
        if not (size := _size(folder / name)) or (name != RECORD and size != written.get(name))
    ]


def maps_clouds(entry: Mapping[str, Any]) -> bool:
    """Whether a run's mapper read point clouds: it has no occupancy map, but an elevation."""
    return "elevation_rmse" in entry["map"]


def _size(path: Path) -> int:
    """Return the bytes of a file; 0 where there is none."""
    try:
        return path.stat().st_size
    except OSError:
        return 0
