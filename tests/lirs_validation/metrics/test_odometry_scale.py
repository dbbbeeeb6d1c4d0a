"""Scale errors of odometry: sign, size and margin against errors that are put in."""

import math
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from lirs_validation import map_log, validate
from lirs_validation.metrics.mapped_log import odometry_scale
from lirs_wct.geometry.pose import Pose2, Trajectory
from tests.command_line import run_command
from tests.lirs_wct.formats.carmen_room import PERIOD, START, flaser, write_log
from tests.slam_baselines.synthetic import ROOM, ranges_to

EXAMPLES = Path(__file__).parents[3] / "examples/data"


def eights(laps: int, side: float = 1.0, scans: int = 10) -> list[Pose2]:
    """Return poses around two squares in turn, one to the left and one to the right."""
    ahead, left = Pose2(side / scans), Pose2(yaw=math.pi / 2 / 4)
    lap = [step for turn in (left, left.inverse()) for _ in range(4) for step in [ahead] * scans + [turn] * 4]
    poses = [Pose2(-0.5, -0.2)]
    for step in lap * laps:
        poses.append(poses[-1] @ step)
    return poses


def wheels_of(
    path: Sequence[Pose2], distance: float, turn: float, rng: np.random.Generator, noise: float = 0.0
) -> list[Pose2]:
    """Return odometry that is too long and turns too far, with noise that lasts for meters."""
    odometry, off = [Pose2()], 0.0
    for a, b in pairwise(path):
        step = a.inverse() @ b
        off += -0.05 * off + noise * rng.normal()
        # A robot that skids in a turn shifts unseen, and one wheel is larger: neither is an error of scale.
        x = (1 + distance + off) * step.x + 0.02 * abs(step.yaw)
        odometry.append(odometry[-1] @ Pose2(x, step.y, (1 + turn) * step.yaw + 0.01 * step.x))
    return odometry


def timed(poses: Sequence[Pose2]) -> Trajectory:
    return Trajectory.from_poses(START + PERIOD * np.arange(len(poses)), list(poses))


@pytest.mark.parametrize(("distance", "turn"), [(0.03, 0.04), (-0.02, -0.05), (0.0, 0.0)])
def test_sign_and_size_are_those_of_the_wheels(distance: float, turn: float) -> None:
    path = eights(6)
    found = odometry_scale(timed(wheels_of(path, distance, turn, np.random.default_rng(0))), timed(path))
    assert found["distance"] == pytest.approx((distance, 0.0), abs=2e-3)
    assert found["turn"] == pytest.approx((turn, 0.0), abs=2e-3)


def test_the_margin_holds_the_error_of_nearly_all_drives() -> None:
    """The path has errors of matching, and the odometry's scale changes on the way."""
    rng, inside = np.random.default_rng(1), 0
    path = eights(8)
    for _ in range(40):
        matched = [pose @ Pose2(*(rng.normal(size=3) * (0.005, 0.005, 0.002))) for pose in path]
        found = odometry_scale(timed(wheels_of(path, 0.02, 0.04, rng, noise=0.005)), timed(matched))
        for key, true in (("distance", 0.02), ("turn", 0.04)):
            error, margin = found[key] or (0.0, 0.0)
            inside += abs(error - true) <= margin
            assert 0 < margin < 0.03
    assert inside >= 0.9 * 80


def test_a_short_or_straight_drive_and_a_circle_tell_no_scale() -> None:
    rng = np.random.default_rng(2)
    straight, circle = [Pose2(0.1 * k) for k in range(300)], [Pose2()]
    for _ in range(600):
        circle.append(circle[-1] @ Pose2(0.1, 0.0, 0.05))
    for path in (eights(1), straight):
        assert odometry_scale(timed(wheels_of(path, 0.03, 0.04, rng)), timed(path))["turn"] is None
    odometry = wheels_of(circle, 0.03, 0.04, rng, noise=0.005)
    matched = [pose @ Pose2(*(rng.normal(size=3) * (0.005, 0.005, 0.002))) for pose in circle]
    assert all(
        value is None or value[1] > 0.1 for value in odometry_scale(timed(odometry), timed(matched)).values()
    )


def logged(path: Path, odometry: Sequence[Pose2], truth: Sequence[Pose2]) -> Path:
    """Write a log of the room."""
    rng, angles, lines = np.random.default_rng(3), math.pi / 180 * np.arange(-90, 91), list[str]()
    for k, (pose, measured) in enumerate(zip(truth, odometry, strict=True)):
        ranges = ranges_to(ROOM, pose, angles) + rng.normal(0, 0.01, len(angles))
        lines.append(flaser(np.where(np.isfinite(ranges), ranges, 81.83), measured, START + PERIOD * k))
    return write_log(path, lines)


@pytest.mark.slow
@pytest.mark.parametrize("mapper", ["hector", "gmapping", "cartographer"])
def test_the_line_of_map_states_the_errors_of_the_wheels(
    mapper: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = eights(5)
    log = logged(tmp_path / "room.clf", wheels_of(truth, 0.03, -0.04, np.random.default_rng(4)), truth)
    assert run_command("map", str(log), "--mapper", mapper, "-o", str(tmp_path)) == 0
    line = re.search(
        r"^wheels: (\S+) ± (\S+) % too long; turns (\S+) ± (\S+) % not far enough$",
        capsys.readouterr().out,
        re.M,
    )
    assert line is not None
    distance, low, turn, far = map(float, line.groups())
    assert abs(distance - 3.0) <= low + 0.1
    assert abs(turn - 4.0) <= far + 0.1
    assert max(low, far) < 1.5


@pytest.mark.slow
def test_nothing_is_said_without_odometry_and_little_of_a_short_drive(tmp_path: Path) -> None:
    truth = eights(5)
    still = map_log(logged(tmp_path / "still.clf", [Pose2()] * len(truth), truth), mapper="hector")
    assert still.record.wheels == ""
    truth = eights(1)
    short = map_log(
        logged(tmp_path / "short.clf", wheels_of(truth, 0.03, 0.0, np.random.default_rng(4)), truth),
        mapper="hector",
    )
    unknown = "not known, the drive is too short"
    assert short.record.wheels == f"wheels: {unknown}; turns {unknown}"


@pytest.mark.slow
def test_a_simulated_wheel_radius_is_found_in_the_log_of_the_run(tmp_path: Path) -> None:
    (tmp_path / "noise.yaml").write_text("odometry: {scale_bias: 0.03, scale_sigma: 0.005}\n")
    run = validate(
        EXAMPLES / "office.yaml",
        robot="turtlebot2",
        seconds=90,
        noise=str(tmp_path / "noise.yaml"),
        out=tmp_path,
    )
    assert run.folder is not None
    record = map_log(run.folder / "scans.clf.gz", mapper="hector").record
    error, margin = record.odometry["scale"]["distance"]
    assert abs(error - 0.03) <= margin + 0.002
    assert "% too long; turns" in record.wheels
