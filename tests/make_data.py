"""Make the recorded results under tests/data again: `.venv/bin/python -m tests.make_data`, 20 seconds.

The tests of all that comes after a drive read them instead of driving; tests/conftest.py unpacks them.
"""

import os
import shutil
import tempfile
import zipfile
from pathlib import Path

from lirs_wct.drawing import canvas
from tests.command_line import run_command

DATA = Path(__file__).with_name("data").resolve()
SMALL = "--robot jackal --lidar urg04lx --size 20 --height 2 --option resize=129,129"
COMMANDS = {
    "run": f"validate simple {SMALL} --seconds 10",
    "mapped": "map drive.clf.gz --mapper hector",
    "sweep": f"validate simple {SMALL} --mapper hector,gmapping --seconds 2",
}


def pack(folder: Path, target: Path) -> None:
    """Pack the content of a folder; the times of its files are left out."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as packed:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                name = zipfile.ZipInfo(path.relative_to(folder).as_posix())
                packed.writestr(name, path.read_bytes(), zipfile.ZIP_DEFLATED)


def main() -> None:
    canvas.DPI = 16  # pictures of a hundredth of the bytes
    with tempfile.TemporaryDirectory() as here:
        os.chdir(here)
        for name, command in COMMANDS.items():
            assert run_command(*command.split(), "-o", name) == 0
            if name == "run":
                shutil.copy(next(Path(name).glob("*/scans.clf.gz")), "drive.clf.gz")
            pack(Path(name), DATA / f"{name}.zip")


if __name__ == "__main__":
    main()
