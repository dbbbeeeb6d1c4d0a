"""What a run records as a CARMEN log reads back as it was."""

import gzip
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lirs_wct.errors import OutputError
from lirs_wct.formats.carmen.log import read_carmen
from lirs_wct.formats.carmen.writer import write_log
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import LaserScan

MOUNT = Pose3.from_rpy(0.22, -0.05, 0.4, 0.0, 0.0, 0.3)


def scan(stamp: float, ranges: np.ndarray, fov: float = math.radians(270), most: float = 20.0) -> LaserScan:
    n = len(ranges)
    return LaserScan(ranges.astype(np.float32), -fov / 2, fov / (n - 1), 0.05, most, stamp, MOUNT)


def drive(seed: int, beams: int = 90, count: int = 25, **more: float) -> list[tuple[LaserScan, Pose2]]:
    """A room of noisy ranges with every special value among them."""
    rng = np.random.default_rng(seed)
    out, pose = [], Pose2()
    for k in range(count):
        ranges = rng.uniform(0.5, 18.0, beams)
        ranges[rng.random(beams) < 0.1] = np.inf
        ranges[rng.random(beams) < 0.02] = -np.inf
        ranges[rng.random(beams) < 0.02] = np.nan
        out.append((scan(0.04 * k, ranges, **more), pose))
        pose = pose @ Pose2(0.02, 0.001, 0.01)
    return out


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.sampled_from([40.0, 180.0, 239.77, 270.0, 359.0]))
def test_it_reads_back(tmp_path_factory: pytest.TempPathFactory, seed: int, fov: float) -> None:
    path = tmp_path_factory.mktemp("log") / "scans.clf.gz"
    given_scans = drive(seed, fov=math.radians(fov))
    write_log(path, given_scans)
    log = read_carmen(path)
    assert len(log.scans) == len(given_scans)
    assert not log.skipped
    for (wanted, odometry), got, pose in zip(given_scans, log.scans, log.odometry, strict=True):
        assert got.stamp == pytest.approx(wanted.stamp, abs=1e-6)
        assert got.angle_min == pytest.approx(wanted.angle_min, abs=1e-8)
        assert got.angles[-1] == pytest.approx(wanted.angles[-1], abs=1e-7)
        finite = np.isfinite(wanted.ranges)
        assert np.array_equal(np.isfinite(got.ranges), finite)
        assert np.allclose(got.ranges[finite], wanted.ranges[finite], atol=0.51e-3)
        for special in (np.inf, -np.inf):
            assert np.array_equal(got.ranges == special, wanted.ranges == special)
        assert np.array_equal(np.isnan(got.ranges), np.isnan(wanted.ranges))
        assert pose.distance(odometry) < 2e-6
        assert got.T_base_laser.to_pose2().distance(MOUNT.to_pose2()) < 1e-5
        assert got.T_base_laser.yaw == pytest.approx(0.3, abs=1e-5)


def test_a_hit_at_the_largest_range_is_still_a_hit(tmp_path: Path) -> None:
    path = tmp_path / "scans.clf.gz"
    write_log(path, [(scan(0.0, np.array([19.9999, np.inf, 3.0])), Pose2())])
    words = gzip.decompress(path.read_bytes()).decode().splitlines()[-1].split()
    assert words[0] == "ROBOTLASER1"
    assert words[9:12] == ["19.999", "20.000", "3.000"]


def test_the_same_data_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.clf.gz", "b.clf.gz"):
        write_log(tmp_path / name, drive(3))
    assert (tmp_path / "a.clf.gz").read_bytes() == (tmp_path / "b.clf.gz").read_bytes()


def test_a_folder_in_its_place_is_named(tmp_path: Path) -> None:
    (tmp_path / "scans.clf.gz").mkdir()
    with pytest.raises(OutputError, match=r"scans\.clf\.gz: is a folder"):
        write_log(tmp_path / "scans.clf.gz", drive(3))
