"""The process that reads rasters and point clouds: its limits, and what its faults become."""

import struct
from pathlib import Path

import numpy as np
import pytest

from lirs_wct.errors import SourceError
from lirs_wct.formats import limited
from lirs_wct.formats.limited import read_limited

GRID = "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\nnodata_value nan\n1 2 3\n4 nan 6\n"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "a.grd"
    path.write_text(GRID)
    return path


def run_program(text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the process run another program."""
    (tmp_path / "program.py").write_text(text)
    monkeypatch.setattr(limited, "PROGRAM", tmp_path / "program.py")


def test_values_and_arrays_come_back(path: Path) -> None:
    found, (pixels,) = read_limited("raster", path, 6)
    assert (found["width"], found["height"], found["bands"]) == (3, 2, 1)
    assert np.isnan(found["nodata"])
    np.testing.assert_array_equal(pixels, [[1, 2, 3], [4, np.nan, 6]])
    assert read_limited("raster", path, 5)[1] == []


def test_memory_is_limited(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path.write_bytes(b"LASF" + bytes(21) + b"\x02" + bytes(400))
    monkeypatch.setattr(limited, "MEMORY", 1 << 20)
    with pytest.raises(SourceError, match=rf"^{path}: needs more than 1 MiB of memory$"):
        read_limited("las", path)


def test_waiting_is_limited(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_program("import time; time.sleep(100)", tmp_path, monkeypatch)
    monkeypatch.setattr(limited, "SECONDS", 1.0)
    monkeypatch.setattr(limited, "WAIT", 0.6)
    with pytest.raises(SourceError, match=rf"^{path}: cannot be read: its reader takes more than 1 s$"):
        read_limited("raster", path)


def test_cpu_time_is_limited(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    head = bytearray(227)
    head[:4], head[24:26] = b"LASF", bytes((1, 2))
    struct.pack_into("<HIIBH", head, 94, 227, 227, 2**32 - 1, 0, 20)  # as many records
    path.write_bytes(head)
    monkeypatch.setattr(limited, "SECONDS", 1.0)
    with pytest.raises(SourceError, match=rf"^{path}: cannot be read: its reader takes more than 1 s$"):
        read_limited("las", path)


@pytest.mark.parametrize(
    ("program", "reason"),
    [
        ("import os; os.abort()", "was ended by SIGABRT"),
        ("import os; os._exit(3)", "ended with exit code 3"),
        ("print('{\"arrays\": [[\"<f8\", [5]]]}'); print('short')", "ended with exit code 0"),
    ],
)
def test_a_crash_ends_the_reader_alone(
    program: str, reason: str, path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_program(program, tmp_path, monkeypatch)
    with pytest.raises(SourceError, match=rf"^{path}: cannot be read: its reader {reason}$"):
        read_limited("raster", path)
