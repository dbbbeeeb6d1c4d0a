"""CARMEN logs: which laser is read, how it sees, where it sits, what its odometry is."""

import math
from pathlib import Path

import numpy as np
import pytest

from lirs_wct.errors import SourceError
from lirs_wct.formats.carmen.laser import no_return
from lirs_wct.formats.carmen.log import read_carmen
from lirs_wct.geometry.pose import Pose2, Pose3
from tests.lirs_wct.formats.carmen.carmen_room import flaser, write_log

HALF = np.full(181, 2.0)


def robotlaser(
    stamp: float,
    *,
    name: str = "ROBOTLASER1",
    n: int = 181,
    sweep: str = "-1.570796 3.141593 0.017453 20.0",
    base: Pose2 | None = None,
    laser: Pose2 | None = None,
    remissions: str = "0",
) -> str:
    base = base or Pose2(stamp, 0.0, 0.0)
    poses = " ".join(f"{v:.6f}" for p in (laser or base, base) for v in (p.x, p.y, p.yaw))
    ranges = " ".join(["2.0"] * n)
    return f"{name} 0 {sweep} 0.1 0 {n} {ranges} {remissions} {poses} 0 0 0 0 0 {stamp} host 0.1"


def at(k: int) -> Pose2:
    return Pose2(0.5 * k, 0.0, 0.1 * k)


def test_the_messages_poses_are_believed_before_parameters(tmp_path: Path) -> None:
    lines = ["PARAM robot_frontlaser_offset 0.1"]
    lines += [robotlaser(1.0 + k, base=at(k), laser=at(k) @ Pose2(0.3, 0.0, 0.0)) for k in range(5)]
    assert read_carmen(write_log(tmp_path / "a.clf", lines)).scans[0].T_base_laser.x == pytest.approx(0.3)
    lines = [lines[0], *(robotlaser(1.0 + k, base=at(k)) for k in range(5))]
    assert read_carmen(write_log(tmp_path / "b.clf", lines)).scans[0].T_base_laser == Pose3(0.1)


def test_several_codes_are_all_found() -> None:
    rng = np.random.default_rng(3)
    ranges = rng.uniform(0.5, 7.0, (50, 181)).astype(np.float32)
    codes = rng.random(ranges.shape)
    ranges[codes > 0.9] = 8.19
    ranges[codes > 0.97] = 8.18
    assert no_return(ranges) == pytest.approx(8.175)


# ---- codes, mounts and limits by hand


def ranges(scans: int, beams: int, most: float = 7.0) -> np.ndarray:
    return np.random.default_rng(9).uniform(0.5, most, (scans, beams)).astype(np.float32)


@pytest.mark.parametrize(("share", "code"), [(0.0012, True), (0.0008, False)])
def test_a_code_is_a_thousandth_of_all(share: float, code: bool) -> None:
    r = np.full((400, 100), 3.0, np.float32)
    count = round(share * r.size)
    r.flat[np.arange(count) * (r.size // count) + np.arange(count) % 7] = 8.0
    assert no_return(r) == (pytest.approx(7.995) if code else 50.0)


@pytest.mark.parametrize(("beams", "code"), [(5, True), (4, False)])
def test_a_code_comes_in_a_twentieth_of_the_directions(beams: int, code: bool) -> None:
    r = np.full((100, 100), 3.0, np.float32)
    r[:40, 20 : 20 + beams] = 8.0
    assert no_return(r) == (pytest.approx(7.995) if code else 50.0)


@pytest.mark.parametrize(
    ("below", "count", "code"), [(4, 100, True), (5, 100, True), (5, 99, False), (6, 100, False)]
)
def test_a_code_is_twenty_times_as_frequent_as_the_three_meters_below(
    below: int, count: int, code: bool
) -> None:
    """Each centimeter from 5 to 8 m comes a few times."""
    r = np.full((30, 100), 1.0, np.float32)
    r.flat[: below * 300] = np.repeat(np.arange(500, 800), below) / np.float32(100)
    r[29, :count] = 8.0
    assert no_return(r) == (pytest.approx(7.995) if code else 50.0)


def test_a_largest_range_that_is_all_there_is_is_a_wall() -> None:
    r = np.full((10, 200), 8.0, np.float32)
    for others, code in ((19, False), (21, True)):
        r[:] = 8.0
        r.flat[:others] = 2.0
        r.flat[30:90] = math.nan
        assert no_return(r) == (pytest.approx(7.995) if code else 50.0), others


def test_readings_that_are_none_are_no_code() -> None:
    r = ranges(50, 100)
    for value in (0.0, 0.019, 50.0, 81.83, math.inf, math.nan, -5.0):
        codes = r.copy()
        codes[:, ::3] = value
        assert no_return(codes) == 50.0
    codes[:, ::3] = 49.99
    assert no_return(codes) == pytest.approx(49.985)
    assert no_return(np.zeros((3, 4), np.float32)) == 50.0


@pytest.mark.parametrize(
    ("value", "meaning"),
    [
        ("0.02", 0.02),
        ("0.019", -math.inf),
        ("-3", -math.inf),
        ("49.99", 49.99),
        ("50.0", math.inf),
        ("81.87", math.nan),
        ("81.88", math.nan),
        ("81.89", math.nan),
        ("81.90", math.nan),
        ("81.91", math.nan),
        ("81.86", math.inf),
        ("1e300", math.inf),
        ("inf", math.inf),
        ("-inf", -math.inf),
        ("nan", math.nan),
        ("81.92", math.inf),
    ],
)
def test_what_a_range_means(tmp_path: Path, value: str, meaning: float) -> None:
    beams = " ".join([value, *["2.0"] * 179])
    line = f"FLASER 180 {beams} 1 0 0 1 0 0 5.0 host 0"
    scan = read_carmen(write_log(tmp_path / "x.clf", [line])).scans[0]
    np.testing.assert_array_equal(scan.ranges[:2], np.float32([meaning, 2.0]))
    assert scan.hits[0] == math.isfinite(meaning)
    code = float(value) if meaning == math.inf and float(value) < 1e3 else 50.0
    assert (scan.range_min, scan.range_max) == (0.02, code)


@pytest.mark.parametrize(
    ("said", "facts", "most"), [("20.0", None, 20.0), ("99.0", None, 50.0), ("20.0", 9.0, 9.0)]
)
def test_the_largest_range_is_the_least_that_is_said(
    tmp_path: Path, said: str, facts: float | None, most: float
) -> None:
    sweep = f"-1.570796 3.141593 0.017453 {said}"
    line = robotlaser(1.0, sweep=sweep).replace("2.0 2.0", f"{most} {most - 0.01}", 1)
    scan = read_carmen(write_log(tmp_path / "x.clf", [line]), range_max=facts).scans[0]
    assert scan.range_max == most
    np.testing.assert_array_equal(scan.ranges[:3], np.float32([np.inf, most - 0.01, 2.0]))
    assert (scan.angle_min, scan.angle_increment) == (-1.570796, 0.017453)


@pytest.mark.parametrize(
    ("beams", "fov"), [((180, 181, 360, 361), 180), ((101, 201, 401), 100), ((540, 541, 1080, 1081), 270)]
)
def test_angles_of_every_usual_laser(tmp_path: Path, beams: tuple[int, ...], fov: float) -> None:
    for n in beams:
        scan = read_carmen(write_log(tmp_path / "x.clf", [flaser(np.full(n, 2.0), at(1), 1.0)])).scans[0]
        assert math.degrees(scan.angle_min) == pytest.approx(-fov / 2)
        assert math.degrees(scan.angle_increment) == pytest.approx(fov / (n - n % 2))


@pytest.mark.parametrize(
    ("name", "parameter", "n", "fov"),
    [
        ("FLASER", "laser_front_laser_resolution 0.5", 240, 120),
        ("FLASER", "laser_front_laser_resolution 0.5", 241, 120),
        ("RLASER", "laser_rear_laser_resolution 1.0", 91, 90),
        ("FLASER", "laser_front_laser_resolution 1.0", 362, None),
        ("FLASER", "laser_front_laser_resolution 1.0", 359, 358),
        ("FLASER", "laser_front_laser_resolution 2.0", 182, None),
        ("FLASER", "laser_front_laser_resolution 0.5", 720, 360),
        ("FLASER", "laser_front_laser_resolution 0.1", 8, 0.8),
        ("FLASER", "laser_front_laser_resolution 0.0", 91, None),
        ("FLASER", "laser_rear_laser_resolution 1.0", 91, None),
    ],
)
def test_the_resolution_of_a_parameter(
    tmp_path: Path, name: str, parameter: str, n: int, fov: float | None
) -> None:
    path = write_log(tmp_path / "x.clf", [f"PARAM {parameter}", flaser(np.full(n, 2.0), at(1), 1.0, name)])
    if fov is None:
        words = rf"x\.clf: {name} messages of {n} beams do not say how wide .* \(lirs-wct map --fov DEG\)"
        with pytest.raises(SourceError, match=words):
            read_carmen(path)
        return
    scan = read_carmen(path).scans[0]
    assert math.degrees(scan.angle_min) == pytest.approx(-fov / 2)
    assert math.degrees(scan.angle_increment) == pytest.approx(fov / (n - n % 2))


@pytest.mark.parametrize(("n", "steps"), [(1, 1), (2, 2), (181, 180)])
def test_the_user_says_the_field_of_view(tmp_path: Path, n: int, steps: int) -> None:
    """A whole turn is legal, one beam has all of it, and the number of beams says no more."""
    path = write_log(tmp_path / "x.clf", [flaser(np.full(n, 2.0), at(1), 1.0)])
    scan = read_carmen(path, fov=math.tau).scans[0]
    assert (scan.angle_min, scan.angle_increment) == (-math.pi, math.tau / steps)


@pytest.mark.parametrize(
    ("mount", "known"),
    [
        (Pose2(0.3, -0.2, 0.5), True),
        (Pose2(2.9, 0.5, 0.0), True),
        (Pose2(2.9, 0.9, 0.0), False),
        (Pose2(0.1, 0.0, math.pi), True),
        (Pose2(0.0, 0.0011, 0.0), True),
        (Pose2(0.0, 0.0009, 0.0), False),
        (Pose2(0.0, 0.0, 0.0011), True),
        (Pose2(0.0011, 0.0, 0.0), True),
    ],
)
def test_the_mount_is_where_the_laser_follows_the_base(tmp_path: Path, mount: Pose2, known: bool) -> None:
    lines = [robotlaser(1.0 + k, base=at(k), laser=at(k) @ mount) for k in range(9)]
    found = read_carmen(write_log(tmp_path / "x.clf", lines)).scans[0].T_base_laser
    expected = Pose3.from_pose2(mount) if known else Pose3()
    assert (found.x, found.y, found.z) == pytest.approx((expected.x, expected.y, 0.0), abs=5e-6)
    assert math.remainder(found.yaw - expected.yaw, math.tau) == pytest.approx(0.0, abs=5e-6)


@pytest.mark.parametrize(("spread", "steady"), [(0.045, True), (0.055, False)])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_mount_that_differs_by_five_centimeters_is_none(
    tmp_path: Path, spread: float, steady: bool, axis: int
) -> None:
    """Half of the poses differ from the median one by so many meters or radians, to either side."""

    def mount(k: int) -> Pose2:
        off = [0.0, 0.0, 0.0]
        off[axis] = (0.0, spread, -spread, spread, -spread)[k % 5]
        return Pose2(0.4 + off[0], -0.3 + off[1], 0.7 + off[2])

    lines = [robotlaser(1.0 + k, base=at(k), laser=at(k) @ mount(k)) for k in range(15)]
    log = read_carmen(write_log(tmp_path / "x.clf", lines))
    found = log.scans[0].T_base_laser
    assert (found.x, found.y) == (pytest.approx((0.4, -0.3), abs=1e-5) if steady else (0.0, 0.0))
    assert list(log.repaired.values()) == ([] if steady else [15])


@pytest.mark.parametrize(
    ("name", "parameter", "x", "yaw"),
    [
        ("FLASER", "robot_frontlaser_offset 0.25", 0.25, 0.0),
        ("FLASER", "robot_frontlaser_offset -2.99", -2.99, 0.0),
        ("FLASER", "robot_frontlaser_offset 3.0", 0.0, 0.0),
        ("FLASER", "robot_rearlaser_offset 0.25", 0.0, 0.0),
        ("RLASER", "robot_rearlaser_offset 0.25", 0.25, math.pi),
        ("RLASER", "robot_frontlaser_offset 0.25", 0.0, math.pi),
    ],
)
def test_the_mount_of_a_parameter(tmp_path: Path, name: str, parameter: str, x: float, yaw: float) -> None:
    lines = [f"PARAM {parameter}", *(flaser(HALF, at(k), 10.0 + k, name) for k in range(3))]
    found = read_carmen(write_log(tmp_path / "x.clf", lines)).scans[0].T_base_laser
    assert (found.x, found.y, found.z) == (x, 0.0, 0.0)
    assert abs(found.yaw) == pytest.approx(yaw)


def test_readings_of_a_code_are_counted(tmp_path: Path) -> None:
    """Every range from the code on and below 50 m, of all scans."""
    lines = [
        flaser(np.concatenate((np.linspace(1, 3, 160), [8.0] * 20, [50.0])), at(k), 10.0 + k)
        for k in range(9)
    ]
    log = read_carmen(write_log(tmp_path / "x.clf", lines))
    assert log.repaired == {f"readings of {7.995:.2f} m or more, a code for no return": 180}
    assert log.scans[0].range_max == 8.0


@pytest.mark.parametrize(
    ("said", "facts", "codes", "range_max"),
    [
        ("50.0", None, "81.83 81.83 51.2", 81.83),  # a SICK's, beyond what the header says
        ("80.0", None, "81.83 50.0 49.0", 50.0),
        ("20.0", None, "20.0 20.0 81.83", 81.83),
        ("20.0", None, "20.0 20.0 81.91", 20.0),  # invalid is no code for no return
        ("20.0", 9.0, "81.83 12.0 10.0", 81.83),
        ("20.0", 9.0, "12.0 10.0 10.0", 9.0),  # hits that the user does not want
        ("20.0", None, "1e39 1e39 nan", 20.0),
    ],
)
def test_the_largest_range_is_the_reading_where_nothing_came_back(
    tmp_path: Path, said: str, facts: float | None, codes: str, range_max: float
) -> None:
    line = robotlaser(1.0, sweep=f"-1.570796 3.141593 0.017453 {said}").replace("2.0 2.0 2.0", codes, 1)
    scan = read_carmen(write_log(tmp_path / "x.clf", [line]), range_max=facts).scans[0]
    assert scan.range_max == range_max
    np.testing.assert_array_equal(scan.ranges[3:], 2.0)
