"""A reference trajectory, in either of the formats that the data sets use."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

from lirs_wct.errors import SourceError
from lirs_wct.formats.carmen.log import read_carmen
from lirs_wct.formats.tum import read_tum
from lirs_wct.geometry.trajectory import Trajectory


def read_reference(path: Path) -> Trajectory:
    """Read a TUM file, or a CARMEN log whose poses were corrected (as of a pose graph's nodes).

    Raises:
        SourceError: it is neither, or holds no poses.
    """
    if _begins_with_a_number(path):
        return read_tum(path)
    track = read_carmen(path).track
    if len(track) == 0:
        raise SourceError(f"{path}: holds no poses that change, a reference trajectory does")
    return track


def _begins_with_a_number(path: Path) -> bool:
    """Whether the first token that is no comment is a number; the readers report what cannot be read."""
    try:
        with path.open("rb") as raw:
            zipped = raw.read(2) == b"\x1f\x8b"
        with gzip.open(path, "rb") if zipped else path.open("rb") as lines:
            for line in lines:
                tokens = line.split(None, 1)
                if tokens and not tokens[0].startswith(b"#"):
                    float(tokens[0])
                    return True
    except (OSError, EOFError, zlib.error, ValueError):
        return False
    return False
