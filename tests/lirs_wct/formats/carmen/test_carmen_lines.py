"""Lines of a CARMEN log, token by token."""

import gzip
import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from lirs_wct.errors import SourceError
from lirs_wct.formats.carmen.lines import LaserConfig, Message, messages_of, parameters_of, read_lines
from lirs_wct.geometry.pose import Pose2

BASE, LASER = "1.5 -2.5 0.25", "1.75 -2.25 0.5"
T_BASE, T_LASER = Pose2(1.5, -2.5, 0.25), Pose2(1.75, -2.25, 0.5)
SWEEP = "-1.5 3.0 1.0 20.0"


def parsed(line: str) -> Message | None:
    """Return a line as a message; None where it is counted as malformed."""
    skipped = Counter[str]()
    found = messages_of(line.split()[0], [(7, line)], skipped)
    assert skipped == ({} if found else {f"{line.split()[0]} cut off or malformed": 1})
    return found[0] if found else None


def same(found: Message | None, base: Pose2 | None, laser: Pose2 | None, ranges: list[float]) -> bool:
    assert (found.line, found.stamp) == (7, 12.5)
    assert found.ranges.dtype == np.float32
    return (found.base, found.laser, found.ranges.tolist()) == (base, laser, ranges)


@pytest.mark.parametrize("tail", ["", " host", " host 0.5"])
def test_every_message_token_by_token(tail: str) -> None:
    odom = parsed(f"ODOM {BASE} 7 8 9 12.5{tail}")
    assert same(odom, T_BASE, None, [])
    for name in ("FLASER", "RLASER"):
        old = parsed(f"{name} 3 1 2 4.5 {LASER} {BASE} 12.5{tail}")
        assert same(old, T_BASE, T_LASER, [1, 2, 4.5])
        assert old.config is None
    for remissions in ("2 70 80", "3 70 80 90"):
        body = f"{SWEEP} 0.1 0 4 1 2 3 4 {remissions}"
        for name in ("RAWLASER1", "RAWLASER2"):
            raw = parsed(f"{name} 0 {body} 12.5{tail}")
            assert same(raw, None, None, [1, 2, 3, 4])
        for name in ("ROBOTLASER1", "ROBOTLASER2"):
            robot = parsed(f"{name} 0 {body} {LASER} {BASE} 0.6 0.7 0.8 0.9 1.1 12.5{tail}")
            assert same(robot, T_BASE, T_LASER, [1, 2, 3, 4])
            assert robot.config == LaserConfig(-1.5, 1.0, 20.0)


@pytest.mark.parametrize(("remissions", "tail"), [("0 ", " host 0.5"), ("", ""), ("", " host 0.5")])
def test_no_remissions(remissions: str, tail: str) -> None:
    """Their number is 0, or left out as well."""
    sweep = f"0 {SWEEP} 0.1 0 4 1 2 3 4 {remissions}"
    assert same(parsed(f"RAWLASER1 {sweep}12.5{tail}"), None, None, [1, 2, 3, 4])
    line = f"ROBOTLASER1 {sweep}{LASER} {BASE} 0.6 0.7 0.8 0.9 1.1 12.5{tail}"
    assert same(parsed(line), T_BASE, T_LASER, [1, 2, 3, 4])


@pytest.mark.parametrize(
    "line",
    [
        f"ODOM {BASE} 7 8 9",
        f"ODOM {BASE} 7 8 9 12.5 host 0.5 more",
        f"FLASER 3 1 2 4.5 {LASER} {BASE}",
        f"FLASER 3 1 2 4.5 {LASER} {BASE} 12.5 host 0.5 more",
        f"FLASER 0 {LASER} {BASE} 12.5 host 0.5",
        "FLASER 0",
        f"FLASER 3 1 2 1.2.3 {LASER} {BASE} 12.5",
        *(f"FLASER {n} 1 2 4.5 {LASER} {BASE} 12.5" for n in ("many", "-3", "999999999999")),
        f"RAWLASER1 0 {SWEEP} 0.1 0 4 1 2 3 4",
        f"RAWLASER1 0 {SWEEP} 0.1 0 4 1 2 3 4 3 70 80 90",
        f"RAWLASER1 0 {SWEEP} 0.1 0 4 1 2 3 4 0 12.5 host 0.5 more",
        f"RAWLASER1 0 {SWEEP} 0.1 0 4 1 2 3 4 -1 12.5 host 0.5",
        f"ROBOTLASER1 0 {SWEEP} 0.1 0 4 1 2 3 4 3 70 80 90 {LASER} {BASE} 0.6 0.7 0.8 0.9 1.1",
        f"ROBOTLASER1 0 {SWEEP} 0.1 0 4 1 2 3 4 0 {LASER} {BASE} 0.6 0.7 0.8 0.9 1.1 12.5 host 0.5 more",
    ],
)
def test_wrong_tokens_are_malformed(line: str) -> None:
    assert parsed(line) is None


def test_one_beam_is_a_scan() -> None:
    assert same(parsed(f"FLASER 1 3.5 {LASER} {BASE} 12.5"), T_BASE, T_LASER, [3.5])


@pytest.mark.parametrize(
    ("sweep", "n", "legal"),
    [
        ("-1.5 3.0 1.0 20", 3, True),  # the field of view ends one step behind the last beam,
        ("-1.5 2.0 1.0 20", 3, True),  # or at it
        ("-1.5 4.5 1.0 20", 3, True),
        ("-1.5 1.5 1.0 20", 3, True),
        ("-1.5 4.51 1.0 20", 3, False),
        ("-1.5 1.49 1.0 20", 3, False),
        ("-1.5 0 1.0 20", 3, True),  # not said
        ("-1.5 -5 1.0 20", 3, True),
        ("inf 3.0 1.0 20", 3, False),
        ("nan 3.0 1.0 20", 3, False),
        ("-1.5 3.0 0 20", 3, False),
        ("-1.5 3.0 -1.0 20", 3, False),
        ("-1.5 3.0 1.0 0", 3, False),
        ("-1.5 3.0 1.0 -20", 3, False),
        ("-1.5 3.0 1.0 1e-9", 3, True),
        ("-3.14 0 1.5708 20", 5, True),  # a whole turn from the first beam to the last
        ("-3.14 0 1.5713 20", 5, False),
    ],
)
def test_a_sweep_that_contradicts_itself_is_malformed(sweep: str, n: int, legal: bool) -> None:
    found = parsed(f"RAWLASER1 0 {sweep} 0.1 0 {n} {' 1' * n} 0 12.5")
    assert (found is not None) == legal
    if found is not None:
        start, _, step, most = map(float, sweep.split())
        assert found.config == LaserConfig(start, step, most)


@pytest.mark.parametrize("at", range(2, 9))
@pytest.mark.parametrize("word", ["nan", "inf"])
def test_stamps_and_poses_are_finite(at: int, word: str) -> None:
    words = f"FLASER 1 3.5 {LASER} {BASE} 12.5".split()
    words[at + 1] = word
    skipped = Counter[str]()
    assert messages_of("FLASER", [(0, " ".join(words))], skipped) == []
    assert skipped == {"FLASER whose stamp or pose is not finite": 1}


def test_ranges_beyond_single_precision_are_endless() -> None:
    found = parsed(f"FLASER 3 1e300 -1e300 nan {LASER} {BASE} 12.5")
    np.testing.assert_array_equal(found.ranges, np.float32([math.inf, -math.inf, math.nan]))


def test_each_reason_is_counted() -> None:
    skipped = Counter({"FLASER cut off or malformed": 3})
    good, bad = f"FLASER 1 3.5 {LASER} {BASE} 12.5", "FLASER 1 x"
    found = messages_of("FLASER", [(1, bad), (4, good), (5, bad), (9, good)], skipped)
    assert [m.line for m in found] == [4, 9]
    assert skipped == {"FLASER cut off or malformed": 5}


def test_lines_are_kept_by_name_with_their_numbers(tmp_path: Path) -> None:
    text = b"# a comment\nPARAM a 1\n\n  ODOM x\r\n#FLASER 1\nODOM\ty\nFLASER\n"
    for content in (text, gzip.compress(text)):
        (tmp_path / "x.clf").write_bytes(content)
        found = read_lines(tmp_path / "x.clf")
        assert {k: [(n, line.strip()) for n, line in v] for k, v in found.items()} == {
            "PARAM": [(1, "PARAM a 1")],
            "ODOM": [(3, "ODOM x"), (5, "ODOM\ty")],
            "FLASER": [(6, "FLASER")],
        }


def test_a_zero_byte_in_the_first_pages_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "x.clf"
    for zeros, text in ((65_535, False), (65_536, True), (0, False)):
        path.write_bytes(b"#" * zeros + b"\0\nODOM 1\n")
        if text:
            assert list(read_lines(path)) == ["ODOM"]
            continue
        with pytest.raises(SourceError, match="not a text file, a CARMEN log is one"):
            read_lines(path)


def test_parameters_are_those_that_are_numbers() -> None:
    texts = ["PARAM a 1.5", "PARAM b on", "PARAM c", "PARAM a -2 host 0.1", "PARAM d 1e3 host", "PARAM"]
    assert parameters_of(list(enumerate(texts))) == {"a": -2.0, "d": 1000.0}
