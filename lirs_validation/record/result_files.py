"""The files of a run's folder, and which of them are not there."""

from __future__ import annotations

from pathlib import Path

WITH_RESULTS = (
    "record.json",
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
WITHOUT = ("record.json", "error.txt")
"""Of a run that came to nothing."""


def lacking_files(folder: Path, status: str) -> list[str]:
    """Return the files that a run's folder should hold and does not, or holds empty."""
    expected = WITHOUT if status in ("error", "timeout") else WITH_RESULTS
    return [name for name in expected if not _filled(folder / name)]


def _filled(path: Path) -> bool:
    try:
        return path.stat().st_size > 0
    except OSError:
        return False
