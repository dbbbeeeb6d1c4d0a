"""Bags rebuilt from public bug reports: each gives its right trajectory, or one line that names the fault."""

import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from lirs_validation import map_log
from lirs_validation.logs.map_log import check_log_file
from lirs_wct.errors import SourceError

pytestmark = pytest.mark.shared


@pytest.fixture(scope="module")
def bags(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags")
    subprocess.run([sys.executable, shared_data / "reports" / "logs" / "make.py", folder], check=True)
    return folder


ROBOT_1 = {"scan_topic": "/robot1/scan", "odom_topic": "/robot1/odom"}
CASES = [
    ("range_max_inf", 0.006, ["range_max is inf m: the largest reading is taken, 4.00 m"]),
    ("misses_at_range_max", 0.010, ["2.5 m is a no-return code"]),
    ("odom_nan_last", 0.003, ["1 pose that is not finite skipped"]),
    (
        "scan_clock",
        0.003,
        ["scans and odometry share no time by their headers: times of reception are taken"],
    ),
    pytest.param("two_robots", 0.003, [], marks=pytest.mark.slow),
    ("joint_jitter", 0.003, []),
    ("two_lasers_one_topic", 0.003, ["scans of several lasers on /scan: front, rear"]),
    ("two_tf_publishers", 0.003, ["odom -> base_link has two sources: the one with more poses is taken"]),
    pytest.param("wal_half", 0.003, [], marks=pytest.mark.slow),
    pytest.param("split_ros1", 0.003, [], marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("name", "ate", "lines"), CASES)
def test_each_bag_gives_its_trajectory(name: str, ate: float, lines: list[str], bags: Path) -> None:
    topics = ROBOT_1 if name == "two_robots" else {}
    found = check_log_file(bags / name, **topics)
    assert (list(found.repairs), found.unfit) == (lines, "")
    assert found.sentence == "fit for planar mapping"
    with warnings.catch_warnings(action="error"):
        truth = bags / ("truth_boot.tum" if name == "scan_clock" else "truth.tum")
        mapped = map_log(bags / name, reference=truth, second="none", **topics)
    log, accuracy = mapped.record.log, mapped.record.accuracy["reference"]
    assert (mapped.record.status, accuracy["used"]) == ("ok", 229)
    assert accuracy["ate_rmse"] < ate + 5e-4
    assert log["odometry_length"] == pytest.approx(9.1, abs=0.2)


def test_millimeters_are_asked_for(bags: Path) -> None:
    with pytest.raises(SourceError, match=r"millimetres: /scan has ranges up to 11,982 m: millimeters\?"):
        map_log(bags / "millimetres")


def test_a_bag_of_two_robots_asks_for_a_topic(bags: Path) -> None:
    with pytest.raises(SourceError, match=r"--scan-topic must say which; there are: /robot1/odom"):
        check_log_file(bags / "two_robots")


def test_times_of_reception_can_be_asked_for(bags: Path) -> None:
    mapped = map_log(bags / "scan_clock", reference=bags / "truth.tum", second="none", time="receive")
    assert mapped.record.log["repaired"] == {}
    assert mapped.record.accuracy["reference"]["ate_rmse"] < 0.0035
