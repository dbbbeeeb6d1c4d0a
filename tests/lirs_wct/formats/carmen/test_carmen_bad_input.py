"""Damaged CARMEN logs: what is sound is kept, what is not is counted, what is no log says so in one line."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_wct.errors import SourceError
from lirs_wct.formats.carmen.log import read_carmen
from tests.kit import refused
from tests.lirs_wct.formats.carmen.carmen_room import room_lines, write_log

LINES, _ = room_lines(12, beams=181)


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("logs")


@pytest.mark.filterwarnings("ignore:.*stamps go back")
@given(cut=st.data())
def test_a_log_that_ends_anywhere_keeps_what_is_whole(scratch: Path, cut: st.DataObject) -> None:
    whole = "\n".join(LINES[:4]).encode()
    end = cut.draw(st.integers(0, len(whole)))
    path = scratch / "cut.clf"
    path.write_bytes(whole[:end])
    ends = [len("\n".join(LINES[: k + 1])) for k in range(4)]
    # Host and logger's stamp may be missing, and a stamp may have lost digits: no word tells that.
    sure = sum(e <= end for e in ends)
    told, stamps = "", set[float]()
    try:
        stamps = set(read_carmen(path).stamps.tolist())
    except SourceError as error:
        told = str(error)
    assert sure <= len(stamps) <= sure + 1
    assert told == "" if stamps else told.startswith(f"{path}: no usable laser scan")


@pytest.mark.filterwarnings("ignore:.*stamps go back")
@given(order=st.permutations(range(12)))
def test_lines_in_any_order_stay_in_it(scratch: Path, order: list[int]) -> None:
    log = read_carmen(write_log(scratch / "mixed.clf", [LINES[k] for k in order]))
    whole = read_carmen(write_log(scratch / "whole.clf", LINES))
    assert [s.ranges.tobytes() for s in log.scans] == [whole.scans[k].ranges.tobytes() for k in order]
    assert (np.diff(log.stamps) > 0).all()
    assert log.skipped == {}
    assert log.late == sum(any(order[j] > k for j in range(i)) for i, k in enumerate(order))


def test_comments_may_be_in_any_encoding(tmp_path: Path) -> None:
    path = tmp_path / "x.clf"
    path.write_bytes("# gebaut in Tübingen\n".encode("latin-1") + "\r\n".join(LINES).encode())
    assert len(read_carmen(path).scans) == 12


PNG = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + bytes(range(256))
ZIPPED = gzip.compress("\n".join(LINES).encode())
NO_LOG = {
    "empty": (b"", "no usable laser scan"),
    "empty gzip": (gzip.compress(b""), "no usable laser scan"),
    "comments": (b"# nothing\n\n", "no usable laser scan"),
    "parameters": (b"PARAM a b\n", "no usable laser scan"),
    "a picture": (PNG, "not a text file, a CARMEN log is one"),
    "a zipped picture": (gzip.compress(PNG), "not a text file, a CARMEN log is one"),
    "UTF-16": ("FLASER 1 2".encode("utf-16"), "not a text file, a CARMEN log is one"),
    "bytes": (bytes(k * 37 % 251 + 1 for k in range(5000)), "no usable laser scan"),
    "a letter": (b"Dear Sir,\nplease find enclosed\n", "no usable laser scan"),
    "cut gzip": (ZIPPED[: len(ZIPPED) // 2], "the gzip stream is damaged or cut off"),
    "gzip head": (ZIPPED[:7], "the gzip stream is damaged or cut off"),
    "wrong gzip": (ZIPPED[:60] + b"?" * 60 + ZIPPED[120:], "the gzip stream is damaged or cut off"),
    "wrong checksum": (ZIPPED[:-6] + b"??" + ZIPPED[-4:], "the gzip stream is damaged or cut off"),
}


@pytest.mark.parametrize("case", NO_LOG)
def test_what_is_no_log_says_so_in_one_line(tmp_path: Path, case: str) -> None:
    content, expected = NO_LOG[case]
    path = tmp_path / "bad.clf"
    path.write_bytes(content)
    with refused(f"{path}: ", expected) as told:
        read_carmen(path)
    assert len(str(told.value)) < len(str(path)) + 400


@pytest.mark.shared
def test_no_file_that_is_no_log_is_taken_for_one(shared_data: Path) -> None:
    files = [p for kind in ("broken", "textures") for p in sorted((shared_data / kind).iterdir())]
    assert len(files) > 20
    for path in files:
        with refused(f"{path}: "):
            read_carmen(path)


def test_a_folder_is_no_log(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="cannot be read: Is a directory"):
        read_carmen(tmp_path)
