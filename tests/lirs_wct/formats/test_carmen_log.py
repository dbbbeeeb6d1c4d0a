"""CARMEN logs: messages, lasers, damage, and logs that are written."""

import gzip
import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lirs_wct.errors import SourceError
from lirs_wct.formats.carmen_log import messages_of, read_carmen
from lirs_wct.formats.drive_files import write_scans
from lirs_wct.formats.laser_log import LaserConfig, LaserLog, Message
from lirs_wct.formats.range_codes import no_return
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import LaserScan
from tests.kit import refused
from tests.lirs_wct.formats.carmen_room import flaser, room_lines, write_log


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


def test_the_commonest_number_of_beams_is_kept(tmp_path: Path) -> None:
    sizes = (181, 180, 361, 180, 181, 180)
    lines = [line_of(10.0 + k, n=n, x=float(k)) for k, n in enumerate(sizes)]
    log = read_lines(tmp_path, *lines)
    assert log.stamps.tolist() == [11.0, 13.0, 15.0]
    assert log.skipped == {
        "FLASER of 181 beams where the log's have 180": 2,
        "FLASER of 361 beams where the log's have 180": 1,
    }


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


@pytest.mark.parametrize(
    ("sweep", "n", "legal"),
    [
        ("-1.5 3.0 1.0 20", 3, True),  # the field of view ends one step behind the last beam,
        ("-1.5 2.0 1.0 20", 3, True),  # or at it
        ("-1.5 4.51 1.0 20", 3, False),
        ("-1.5 1.49 1.0 20", 3, False),
        ("-1.5 0 1.0 20", 3, True),  # not said
        ("inf 3.0 1.0 20", 3, False),
        ("-1.5 3.0 0 20", 3, False),
        ("-1.5 3.0 1.0 0", 3, False),
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
        ("49.99", 49.99),
        ("50.0", math.inf),
        ("81.87", math.nan),
        ("81.91", math.nan),
        ("81.86", math.inf),
        ("1e300", math.inf),
        ("nan", math.nan),
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
        ("RLASER", "laser_rear_laser_resolution 1.0", 91, 90),
        ("FLASER", "laser_front_laser_resolution 1.0", 362, None),
        ("FLASER", "laser_front_laser_resolution 0.5", 720, 360),
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
        (Pose2(0.0, 0.0011, 0.0), True),
        (Pose2(0.0, 0.0009, 0.0), False),
    ],
)
def test_the_mount_is_where_the_laser_follows_the_base(tmp_path: Path, mount: Pose2, known: bool) -> None:
    lines = [robotlaser(1.0 + k, base=at(k), laser=at(k) @ mount) for k in range(9)]
    found = read_carmen(write_log(tmp_path / "x.clf", lines)).scans[0].T_base_laser
    expected = Pose3.from_pose2(mount) if known else Pose3()
    assert (found.x, found.y, found.z) == pytest.approx((expected.x, expected.y, 0.0), abs=5e-6)
    assert math.remainder(found.yaw - expected.yaw, math.tau) == pytest.approx(0.0, abs=5e-6)


@pytest.mark.parametrize(("spread", "steady"), [(0.045, True), (0.055, False)])
def test_a_mount_that_differs_by_five_centimeters_is_none(
    tmp_path: Path, spread: float, steady: bool
) -> None:
    """Half of the poses differ from the median one, to either side."""
    lines = []
    for k in range(15):
        mount = Pose2(0.4 + (0.0, spread, -spread, spread, -spread)[k % 5], -0.3, 0.7)
        lines.append(robotlaser(1.0 + k, base=at(k), laser=at(k) @ mount))
    log = read_carmen(write_log(tmp_path / "x.clf", lines))
    mounted = log.scans[0].T_base_laser
    assert (mounted.x, mounted.y) == (pytest.approx((0.4, -0.3), abs=1e-5) if steady else (0.0, 0.0))
    assert list(log.repaired.values()) == ([] if steady else [15])


@pytest.mark.parametrize(
    ("name", "parameter", "x", "yaw"),
    [
        ("FLASER", "robot_frontlaser_offset 0.25", 0.25, 0.0),
        ("FLASER", "robot_frontlaser_offset 3.0", 0.0, 0.0),
        ("FLASER", "robot_rearlaser_offset 0.25", 0.0, 0.0),
        ("RLASER", "robot_rearlaser_offset 0.25", 0.25, math.pi),
    ],
)
def test_the_mount_of_a_parameter(tmp_path: Path, name: str, parameter: str, x: float, yaw: float) -> None:
    lines = [f"PARAM {parameter}", *(flaser(HALF, at(k), 10.0 + k, name) for k in range(3))]
    found = read_carmen(write_log(tmp_path / "x.clf", lines)).scans[0].T_base_laser
    assert (found.x, found.y, found.z) == (x, 0.0, 0.0)
    assert abs(found.yaw) == pytest.approx(yaw)


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
    write_scans(path, given_scans)
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
    write_scans(path, [(scan(0.0, np.array([19.9999, np.inf, 3.0])), Pose2())])
    words = gzip.decompress(path.read_bytes()).decode().splitlines()[-1].split()
    assert words[0] == "ROBOTLASER1"
    assert words[9:12] == ["19.999", "20.000", "3.000"]
