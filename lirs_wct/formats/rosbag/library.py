"""The library that ROS bags need, which only the extra `[ros]` installs."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from lirs_wct.errors import SourceError


def require_rosbags(path: Path) -> None:
    """Check that bags can be read and written.

    Raises:
        SourceError: rosbags is not installed.
    """
    if find_spec("rosbags") is None:
        raise SourceError(f"{path}: a ROS bag needs the package rosbags: pip install 'lirs-wct[ros]'")
