"""CARMEN logs: what is read, what is skipped, and what is said about it."""

from pathlib import Path

import numpy as np
import pytest

from lirs_wct.errors import SourceError
from lirs_wct.formats.carmen.log import read_carmen
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.geometry.pose import Pose2
from tests.lirs_wct.formats.carmen.carmen_room import flaser, write_log


def read_lines(folder: Path, *lines: str) -> LaserLog:
    return read_carmen(write_log(folder / "x.clf", list(lines)))


def line_of(stamp: float, n: int = 180, x: float = 1.0, name: str = "FLASER") -> str:
    return flaser(np.full(n, 2.5), Pose2(x, 2.0, 0.5), stamp, name)


def test_unusable_lines_are_counted_by_reason(tmp_path: Path) -> None:
    good = line_of(10.0)
    cut, wrong_count = good[: len(good) // 2], good.replace("FLASER 180", "FLASER 361", 1)
    other = ("TRUEPOS 1 2 3", "SYNC x", "SYNC y", "NMEAGGA 1 49.0 N", "Laser: 1 2", "12 13", "\x07 4")
    log = read_lines(tmp_path, good, cut, wrong_count, *other)
    assert len(log.scans) == 1
    assert log.skipped == {
        "FLASER cut off or malformed": 2,
        "message TRUEPOS": 1,
        "message SYNC": 2,
        "message NMEAGGA": 1,
        "not a message": 3,
    }


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "scans", "beams", "range_max"),
    [
        ("intel/intel.clf.gz", 5426, 180, 81.83),
        ("csail/mit-csail.clf.gz", 1988, 361, 50.0),
        ("orebro/orebro.clf.gz", 237, 181, 32.76),
        ("edmonton/edmonton.clf.gz", 340, 180, 51.15),
    ],
)
def test_real_logs(shared_data: Path, name: str, scans: int, beams: int, range_max: float) -> None:
    """The largest range is what each laser reads where nothing came back; CSAIL's reads codes of invalid."""
    log = read_carmen(shared_data / "logs" / name)
    assert (len(log.scans), log.skipped) == (scans, {})
    assert {len(s.ranges) for s in log.scans} == {beams}
    assert {s.range_max for s in log.scans} == {range_max}
    assert max(float(s.ranges[s.hits].max()) for s in log.scans) < min(range_max, 50)
    assert any(np.isposinf(s.ranges).any() for s in log.scans) == (range_max != 50)


def raw(stamp: float, n: int = 180) -> str:
    return f"RAWLASER1 0 -1.57 3.14 0.017453 20.0 0.1 0 {n} {' '.join(['2.0'] * n)} 0 {stamp} h 0"


def test_the_laser_with_poses_comes_before_the_commoner_one(tmp_path: Path) -> None:
    rear = [line_of(20.0 + k, name="RLASER") for k in range(4)]
    lines = [*(raw(k + 0.5) for k in range(3)), *(line_of(10.0 + k, x=float(k)) for k in range(2)), *rear]
    log = read_lines(tmp_path, *lines)
    assert (log.laser, log.stamps.tolist()) == ("FLASER", [10.0, 11.0])
    assert log.skipped == {"RAWLASER1 beside FLASER": 3, "RLASER beside FLASER": 4}
    log = read_lines(tmp_path, *lines[:3], *rear)
    assert (log.laser, log.skipped) == ("RAWLASER1", {"RLASER beside RAWLASER1": 4})


def test_a_laser_without_a_usable_line_gives_way(tmp_path: Path) -> None:
    log = read_lines(tmp_path, "FLASER x", "FLASER y", raw(1.5))
    assert (log.laser, log.skipped) == ("RAWLASER1", {"FLASER cut off or malformed": 2})


def test_the_commonest_number_of_beams_is_kept(tmp_path: Path) -> None:
    sizes = (181, 180, 361, 180, 181, 180)
    lines = [line_of(10.0 + k, n=n, x=float(k)) for k, n in enumerate(sizes)]
    log = read_lines(tmp_path, *lines)
    assert log.stamps.tolist() == [11.0, 13.0, 15.0]
    assert log.skipped == {
        "FLASER of 181 beams where the log's have 180": 2,
        "FLASER of 361 beams where the log's have 180": 1,
    }


@pytest.mark.parametrize("reasons", [5, 6, 8])
def test_an_error_tells_five_reasons(tmp_path: Path, reasons: int) -> None:
    lines = [f"MESSAGE{k} 1" for k in range(reasons) for _ in range(k + 1)]
    with pytest.raises(SourceError) as told:
        read_lines(tmp_path, *lines)
    said = str(told.value).split("; skipped: ")[1]
    listed = ", ".join(f"{k + 1} x message MESSAGE{k}" for k in reversed(range(reasons - 5, reasons)))
    assert said == listed + (f" and {reasons - 5} other reasons" if reasons > 5 else "")


def test_a_log_of_nothing_has_no_reasons(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"in this CARMEN log$"):
        read_lines(tmp_path)


def test_long_names_are_cut(tmp_path: Path) -> None:
    log = read_lines(tmp_path, line_of(1.0), "ABCDEFGHIJKLMNOPQRSTUVWXYZ 1")
    assert log.skipped == {"message ABCDEFGHIJKLMNOPQRST": 1}


@pytest.mark.parametrize("commoner", ["FLASER", "ROBOTLASER1"])
def test_of_two_front_lasers_with_poses_the_commoner_is_read(tmp_path: Path, commoner: str) -> None:
    sweep, poses = "0 -1.57 3.14 0.017453 20.0 0.1 0", "1.0 2.0 0.5 1.0 2.0 0.5"
    lines = {
        "FLASER": [line_of(10.0 + k) for k in range(3)],
        "ROBOTLASER1": [
            f"ROBOTLASER1 {sweep} 180 {' '.join(['2.0'] * 180)} 0 {poses} 0 0 0 0 0 {20.0 + k} h 0"
            for k in range(3)
        ],
    }
    other = next(name for name in lines if name != commoner)
    log = read_lines(tmp_path, *lines[other][:2], *lines[commoner])
    assert (log.laser, log.skipped) == (commoner, {f"{other} beside {commoner}": 2})
