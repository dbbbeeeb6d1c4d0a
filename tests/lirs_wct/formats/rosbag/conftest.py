from pathlib import Path

import pytest

from lirs_wct.formats.rosbag.messages import BagDrive
from lirs_wct.formats.rosbag.writer import write_bag


@pytest.fixture(scope="module")
def bag(given: BagDrive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive `given` of a test file as a bag."""
    folder = tmp_path_factory.mktemp("bags") / "run"
    write_bag(folder, given)
    return folder
