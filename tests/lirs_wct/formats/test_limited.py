"""Readers in a process with limits."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from lirs_wct.errors import SourceError
from lirs_wct.formats import limited
from lirs_wct.formats.limited import run_limited


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "a.bin"
    path.write_bytes(b"a")
    return path


def test_a_result_comes_back_and_what_is_printed_does_not_matter(path: Path) -> None:
    found = run_limited(path, _print_and_double, np.arange(1e6))
    np.testing.assert_array_equal(found, 2 * np.arange(1e6))


def test_an_error_keeps_its_one_line(path: Path) -> None:
    with pytest.raises(SourceError, match=rf"^{path}: wrong$"):
        run_limited(path, _refuse, f"{path}: wrong")
    with pytest.raises(SourceError, match=rf"^{path}: cannot be read: two lines$"):
        run_limited(path, _fail, "two\nlines")


def test_memory_is_limited(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limited, "MEMORY", 160 << 20)
    with pytest.raises(SourceError, match=rf"^{path}: cannot be read: needs more than 160 MiB of memory$"):
        run_limited(path, np.ones, 2**24)
    assert run_limited(path, _count_ones, 2**24, memory=2**28) == 2**24


def test_time_is_limited(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limited, "SECONDS", 1.0)
    with pytest.raises(SourceError, match=rf"^{path}: cannot be read: its reader takes more than 1 s$"):
        run_limited(path, time.sleep, 100)


def test_a_crash_ends_the_reader_alone(path: Path) -> None:
    with pytest.raises(SourceError, match=rf"^{path}: cannot be read: its reader was ended by SIGABRT$"):
        run_limited(path, os.abort)
    with pytest.raises(SourceError, match="was ended by SIGSEGV"):
        run_limited(path, signal.raise_signal, signal.SIGSEGV)


def _print_and_double(values: np.ndarray) -> np.ndarray:
    os.write(1, b"noise\n")
    return 2 * values


def _count_ones(count: int) -> int:
    return len(np.ones(count))


def _refuse(text: str) -> None:
    raise SourceError(text)


def _fail(text: str) -> None:
    raise ValueError(text)
