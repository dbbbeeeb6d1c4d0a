"""CARMEN logs: which laser is read, how it sees, where it sits, what its odometry is."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.carmen.laser import LaserFacts, no_return
from lirs_wct.formats.carmen.log import read_carmen
from lirs_wct.geometry.pose import Pose2, Pose3
from tests.lirs_wct.formats.carmen.carmen_room import flaser, room_lines, write_log

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


def test_the_front_laser_is_read_and_the_rear_one_counted(tmp_path: Path) -> None:
    lines = [flaser(HALF, at(k), 10.0 + k, name) for k in range(4) for name in ("RLASER", "FLASER")]
    log = read_carmen(write_log(tmp_path / "x.clf", lines))
    assert (log.laser, len(log.scans), log.skipped) == ("FLASER", 4, {"RLASER beside FLASER": 4})


def test_a_rear_laser_alone_looks_back(tmp_path: Path) -> None:
    lines = [
        "PARAM robot_rearlaser_offset -0.25",
        *(flaser(HALF, at(k), 10.0 + k, "RLASER") for k in range(4)),
    ]
    log = read_carmen(write_log(tmp_path / "x.clf", lines))
    mount = log.scans[0].T_base_laser
    assert log.laser == "RLASER"
    assert (mount.x, abs(mount.yaw)) == (-0.25, pytest.approx(math.pi))


def test_the_messages_poses_are_believed_before_parameters(tmp_path: Path) -> None:
    lines = ["PARAM robot_frontlaser_offset 0.1"]
    lines += [robotlaser(1.0 + k, base=at(k), laser=at(k) @ Pose2(0.3, 0.0, 0.0)) for k in range(5)]
    assert read_carmen(write_log(tmp_path / "a.clf", lines)).scans[0].T_base_laser.x == pytest.approx(0.3)
    lines = [lines[0], *(robotlaser(1.0 + k, base=at(k)) for k in range(5))]
    assert read_carmen(write_log(tmp_path / "b.clf", lines)).scans[0].T_base_laser == Pose3(0.1)


def test_corrected_poses_are_no_mount(tmp_path: Path) -> None:
    """Some logs hold the corrected pose beside the odometry's: metres apart, and more and more so."""
    lines = [robotlaser(1.0 + k, base=at(k), laser=Pose2(3.0 * k, 2.0, -0.2 * k)) for k in range(9)]
    log = read_carmen(write_log(tmp_path / "x.clf", lines))
    assert log.scans[0].T_base_laser == Pose3()
    assert list(log.repaired.values()) == [9]


def test_of_two_messages_of_one_laser_the_commoner_is_read(tmp_path: Path) -> None:
    lines = [robotlaser(1.0 + k) for k in range(5)] + [flaser(HALF, at(0), 1.0)]
    lines += [f"RAWLASER1 0 -1.570796 3.141593 0.017453 20.0 0.1 0 3 1 2 3 0 {k}.5 h 0" for k in range(9)]
    log = read_carmen(write_log(tmp_path / "x.clf", lines))
    assert (log.laser, len(log.scans)) == ("ROBOTLASER1", 5)
    assert log.skipped == {"FLASER beside ROBOTLASER1": 1, "RAWLASER1 beside ROBOTLASER1": 9}


@pytest.mark.parametrize("remissions", ["0", "3 7 8 9"])
def test_remissions_are_passed_over(tmp_path: Path, remissions: str) -> None:
    log = read_carmen(write_log(tmp_path / "x.clf", [robotlaser(1.0, remissions=remissions)]))
    assert (log.stamps.tolist(), log.odometry[0]) == ([1.0], Pose2(1.0))


def test_raw_scans_take_their_odometry_from_odom_lines(tmp_path: Path) -> None:
    lines = [f"ODOM {k}.0 0 0 0 0 0 {k}.0 host 0" for k in range(4)]
    lines.insert(2, f"RAWLASER1 0 -1.570796 3.141593 0.017453 20.0 0.1 0 181 {'2.0 ' * 181} 0 1.25 host 0")
    log = read_carmen(write_log(tmp_path / "x.clf", lines))
    assert log.odometry == (Pose2(1.25),)
    assert log.skipped == {}


def test_odometry_that_never_changes_is_none(tmp_path: Path) -> None:
    lines, _ = room_lines(5, drifting=False)
    log = read_carmen(write_log(tmp_path / "x.clf", lines))
    assert log.odometry == (None,) * 5
    assert len(log.track) == 0
    odoms = [f"ODOM {k}.0 0 0 0 0 0 {1e9 + 0.2 * k} host 0" for k in range(5)]
    mixed = [line for both in zip(lines, odoms, strict=True) for line in both]
    log = read_carmen(write_log(tmp_path / "y.clf", mixed))
    np.testing.assert_allclose([p.x for p in log.odometry if p], range(5), atol=1e-6)


def test_odometry_that_was_set_anew_goes_on(tmp_path: Path) -> None:
    poses = [at(k) for k in range(6)]
    poses[3:] = [Pose2(1e12, -4e11, 1.0) @ poses[3].inverse() @ p for p in poses[3:]]
    lines = [flaser(HALF, pose, 10.0 + k) for k, pose in enumerate(poses)]
    log = read_carmen(write_log(tmp_path / "x.clf", lines))
    assert list(log.repaired.values()) == [1]
    steps = [a.inverse() @ b for a, b in zip(log.odometry, log.odometry[1:], strict=False) if a and b]
    assert [s.x > 0.1 for s in steps] == [True, True, False, True, True]
    assert max(abs(p.x) for p in log.odometry if p) < 5


def test_wrong_poses_among_sound_ones_are_taken_from_between(tmp_path: Path) -> None:
    poses = [at(k) for k in range(12)]
    poses[4] = Pose2(1e9, 3.0, 0.0)
    poses[7] = poses[8] = Pose2(-200.0, 500.0, 2.0)
    lines = [flaser(HALF, pose, 10.0 + k) for k, pose in enumerate(poses)]
    log = read_carmen(write_log(tmp_path / "x.clf", lines))
    assert list(log.repaired.values()) == [3]
    np.testing.assert_allclose(
        [(p.x, p.yaw) for p in log.odometry if p], [(p.x, p.yaw) for p in map(at, range(12))]
    )


def test_a_fast_robot_is_no_jump(tmp_path: Path) -> None:
    lines = [flaser(HALF, Pose2(20.0 * k), 10.0 + k) for k in range(4)]
    log = read_carmen(write_log(tmp_path / "x.clf", lines))
    assert ([p.x for p in log.odometry if p], log.repaired) == ([0, 20, 40, 60], {})


SWEEPS: dict[str, tuple[int, list[str], LaserFacts, float, float]] = {
    "by number": (401, [], LaserFacts(), -50, 50),
    "by parameter": (241, ["PARAM laser_front_laser_resolution 0.5 host 0"], LaserFacts(), -60, 60),
    "by the user": (241, [], LaserFacts(fov=math.radians(240)), -120, 120),
    "the user knows best": (181, [], LaserFacts(fov=math.radians(90)), -45, 45),
}


@pytest.mark.parametrize("case", SWEEPS)
def test_field_of_view(tmp_path: Path, case: str) -> None:
    n, parameters, facts, first, last = SWEEPS[case]
    lines = [*parameters, flaser(np.full(n, 2.0), at(1), 1.0)]
    angles = read_carmen(write_log(tmp_path / "x.clf", lines), facts).scans[0].angles
    np.testing.assert_allclose(np.degrees(angles[[0, -1]]), (first, last), atol=1e-9)


def test_a_field_of_view_that_nobody_knows_is_asked_for(tmp_path: Path) -> None:
    path = write_log(tmp_path / "x.clf", [flaser(np.full(200, 2.0), at(1), 1.0)])
    with pytest.raises(
        SourceError, match=r"x\.clf: FLASER messages of 200 beams .* \(lirs-wct map --fov DEG\)"
    ):
        read_carmen(path)


@pytest.mark.parametrize("facts", [{"fov": 0.0}, {"fov": 7.0}, {"range_max": 0.0}, {"range_max": math.nan}])
def test_facts_that_no_laser_has(facts: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="must be above"):
        LaserFacts(**facts)


@pytest.mark.parametrize(
    "sweep", ["-1.57 3.14 0.0 20", "-1.57 3.14 0.035 20", "nan 3.14 0.0174 20", "-1.57 3.14 0.0174 0"]
)
def test_sweeps_that_contradict_themselves(tmp_path: Path, sweep: str) -> None:
    with pytest.raises(SourceError, match="1 x ROBOTLASER1 cut off or malformed"):
        read_carmen(write_log(tmp_path / "x.clf", [robotlaser(1.0, sweep=sweep)]))


@pytest.mark.parametrize("most", [3.0, 4.21])
def test_the_largest_range_that_comes_again_and_again_is_no_wall(tmp_path: Path, most: float) -> None:
    """The room's own walls are up to 8 m away: the laser gives its largest range for them."""
    lines, _ = room_lines(40, most=most)
    log = read_carmen(write_log(tmp_path / "x.clf", lines))
    ranges = np.stack([s.ranges for s in log.scans])
    assert ranges[np.isfinite(ranges)].max() < most
    assert np.isinf(ranges).mean() > 0.05
    assert list(log.repaired) == [f"readings of {most - 0.005:.2f} m or more, a code for no return"]


def test_several_codes_are_all_found() -> None:
    rng = np.random.default_rng(3)
    ranges = rng.uniform(0.5, 7.0, (50, 181)).astype(np.float32)
    codes = rng.random(ranges.shape)
    ranges[codes > 0.9] = 8.19
    ranges[codes > 0.97] = 8.18
    assert no_return(ranges) == pytest.approx(8.175)


ROOMS: dict[str, Callable[[], list[str]]] = {
    "all of the room": lambda: room_lines(40)[0],
    "a round room": lambda: [flaser(np.full(181, 4.0), at(k), 10.0 + k) for k in range(40)],
    "standing before a far wall": lambda: [
        flaser(np.concatenate((np.linspace(1, 3, 178), (9.0, 9.0, 9.0))), at(k), 10.0 + k) for k in range(200)
    ],
}


@pytest.mark.parametrize("case", ROOMS)
def test_walls_are_no_codes(tmp_path: Path, case: str) -> None:
    log = read_carmen(write_log(tmp_path / "x.clf", ROOMS[case]()))
    assert log.repaired == {}
    assert all(scan.hits.all() for scan in log.scans)


def test_the_user_may_say_the_largest_range(tmp_path: Path) -> None:
    lines, _ = room_lines(10)
    log = read_carmen(write_log(tmp_path / "x.clf", lines), LaserFacts(range_max=2.5))
    ranges = np.stack([s.ranges for s in log.scans])
    assert ranges[np.isfinite(ranges)].max() < 2.5
    assert np.isposinf(ranges).any()
