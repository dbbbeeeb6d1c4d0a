"""Commands and inertial readings of a drive: exact round trips, and errors for damaged files."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from lirs_wct.errors import SourceError
from lirs_wct.formats.drive_csv import (
    IMU_HEADER as HEADER,
    Commands,
    read_commands,
    read_imu,
    write_commands,
    write_imu,
)
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu


def readings(count: int = 40) -> list[Imu]:
    rng = np.random.default_rng(3)
    return [
        Imu(
            stamp=0.04 * k,
            roll=float(rng.normal()),
            pitch=float(rng.normal()),
            angular_velocity=tuple(rng.normal(size=3).tolist()),
            linear_acceleration=tuple(rng.normal(size=3).tolist()),
        )
        for k in range(count)
    ]


def test_it_reads_back(tmp_path: Path) -> None:
    path = tmp_path / "imu.csv.gz"
    write_imu(path, readings())
    got = read_imu(path)
    assert len(got) == 40
    for a, b in zip(readings(), got, strict=True):
        assert (a.stamp, a.roll, a.pitch) == pytest.approx((b.stamp, b.roll, b.pitch), rel=1e-8)
        assert a.angular_velocity == pytest.approx(b.angular_velocity, rel=1e-8)
        assert a.linear_acceleration == pytest.approx(b.linear_acceleration, rel=1e-8)
    first = path.read_bytes()
    write_imu(path, readings())
    assert path.read_bytes() == first
    assert gzip.decompress(first).decode().splitlines()[0] == HEADER


def test_nothing_to_write_is_a_header(tmp_path: Path) -> None:
    write_imu(tmp_path / "imu.csv.gz", [])
    assert read_imu(tmp_path / "imu.csv.gz") == ()


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "9 numbers a line"),
        (f"{HEADER}\n1,2,3\n".encode(), "9 numbers a line"),
        (gzip.compress(b"stamp\n1\n", mtime=0), "9 numbers a line"),
        (gzip.compress(f"{HEADER}\n1,2,3\n".encode(), mtime=0), "9 numbers a line"),
        (gzip.compress(f"{HEADER}\n1,2,3,4,5,6,7,8,inf\n".encode(), mtime=0), "line 2: .* finite"),
        (gzip.compress(f"{HEADER}\n1,2,x\n".encode(), mtime=0), "not inertial readings"),
        (
            gzip.compress(f"{HEADER}\n1,2,3\n".encode() * 50, mtime=0)[:60],
            "the gzip stream is damaged or cut off",
        ),
    ],
)
def test_what_is_none_is_said(tmp_path: Path, data: bytes, told: str) -> None:
    path = tmp_path / "imu.csv.gz"
    path.write_bytes(data)
    with pytest.raises(SourceError, match=rf"imu\.csv\.gz: .*{told}"):
        read_imu(path)


def test_every_number_has_its_place(tmp_path: Path) -> None:
    path = tmp_path / "imu.csv.gz"
    path.write_text(f"{HEADER}\n1.5,2,3,4,5,6,7,8,9\n2,3,4,5,6,7,8,9,10\n")
    first, second = read_imu(path)
    assert first == Imu(
        stamp=1.5, roll=2.0, pitch=3.0, angular_velocity=(4.0, 5.0, 6.0), linear_acceleration=(7.0, 8.0, 9.0)
    )
    assert second.linear_acceleration == (8.0, 9.0, 10.0)
    write_imu(path, [first])
    assert gzip.decompress(path.read_bytes()).decode() == f"{HEADER}\n1.5,2,3,4,5,6,7,8,9\n"
    assert path.read_bytes()[4:8] == bytes(4)  # no time of day: the same data give the same bytes


def test_commands_read_back_as_they_were(tmp_path: Path) -> None:
    rows = np.random.default_rng(0).normal(size=(50, 3)) * (1.0, 1e-9, 1e9)
    given = Commands(Pose2(0.1, -1 / 3, 2e-17), rows)
    write_commands(tmp_path / "commands.csv", given)
    found = read_commands(tmp_path / "commands.csv")
    assert found.start == given.start
    assert np.array_equal(found.rows, rows)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "time,v,omega\n0,0,0\n",
        "# start 0 0 0\nv,omega\n0,0\n",
        "# start 0 0\ntime,v,omega\n0,0,0\n",
        "# start 0 0 0\ntime,v,omega\n0,nan,0\n",
        "# start 0 0 0\ntime,v,omega\n0,0,0\n0.04,1\n",
    ],
)
def test_damaged_commands_are_named(text: str, tmp_path: Path) -> None:
    path = tmp_path / "commands.csv"
    path.write_text(text)
    with pytest.raises(SourceError, match=r"commands\.csv: "):
        read_commands(path)
