"""Recorded trajectories of the original programs."""

import gzip
from pathlib import Path

from lirs_wct import Trajectory
from lirs_wct.formats.drive_files import read_tum


def unpacked(path: Path, folder: Path) -> Trajectory:
    tum = folder / path.stem
    tum.write_bytes(gzip.decompress(path.read_bytes()))
    return read_tum(tum)
