"""The whole method: a room, a hill, bad input, real logs."""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lirs_validation.logs.read_log import read_constraints, read_reference
from lirs_validation.metrics.map import agreement, false_occupied
from lirs_validation.metrics.mapped_log import constraint_errors, reference_errors
from lirs_wct.formats.carmen_log import read_carmen
from slam_baselines.front_end import KnownPoseMapper
from slam_baselines.hector import HectorMapper
from tests.slam_baselines.synthetic import Drive, drive_room, loop, room_scan, wavy

Array = NDArray[np.float64]


@pytest.mark.parametrize("odometry", [True, False])
def test_a_drive_through_a_room(odometry: bool) -> None:
    mapper = HectorMapper()
    errors = drive_room(mapper, odometry=odometry)
    assert np.hypot(errors[:, 0], errors[:, 1]).max() < 0.05
    assert np.abs(errors[:, 2]).max() < 0.02
    assert not mapper.lost
    assert len(mapper.trajectory()) == 240
    stats = mapper.stats
    assert (stats.received, stats.used, stats.lost) == (240, 239, 0)
    assert 0 < stats.ms_p50 <= stats.ms_p95 <= stats.ms_max


def test_the_map_of_the_room_is_that_of_the_true_poses() -> None:
    mapper, known, rng = HectorMapper(), KnownPoseMapper(), np.random.default_rng(0)
    drive_room(mapper)
    path = loop(240)
    for k, pose in enumerate(path):
        known.update(room_scan(pose, 0.1 * k, rng), path[0].inverse() @ pose, None)
    score = agreement(mapper.map(), known.map())
    assert score.f1 is not None
    assert score.f1 > 0.97


def test_the_same_again_gives_the_same_bytes() -> None:
    one, two = HectorMapper(), HectorMapper()
    np.testing.assert_array_equal(drive_room(one, n=80), drive_room(two, n=80))
    np.testing.assert_array_equal(one.map().log_odds, two.map().log_odds)


def test_hilly_ground() -> None:
    surface = wavy(1.5)
    drive = Drive(surface, 24.0, np.random.default_rng(1))
    mapper, known = HectorMapper(), KnownPoseMapper()
    T = drive.truth[0].to_pose2()
    for scan, odometry, imu, truth in zip(drive.scans, drive.odometry, drive.imus, drive.truth, strict=True):
        mapper.update(scan, odometry, imu)
        known.update(scan, T.inverse() @ truth.to_pose2(), imu)
    estimate = mapper.trajectory().moved(T)
    error = np.linalg.norm(estimate.xy - np.array([(p.x, p.y) for p in drive.truth]), axis=1)
    built, true = mapper.map().moved(T), known.map().moved(T)
    assert np.sqrt((error**2).mean()) < 0.1
    for grid in (built, true):
        false = false_occupied(grid, surface, None)
        assert false is not None
        assert false <= 0.05
    assert true.occupied.sum() > 100
    f1 = agreement(built, true).f1
    assert f1 is not None
    assert f1 > 0.85


@pytest.mark.shared
def test_intel_beginning(shared_data: Path) -> None:
    folder = shared_data / "logs" / "intel"
    log, mapper = read_carmen(folder / "intel.clf.gz"), HectorMapper()
    for scan, odometry in zip(log.scans[:1500], log.odometry[:1500], strict=True):
        mapper.update(scan, odometry, None)
    errors = constraint_errors(
        mapper.trajectory(), read_constraints(folder / "intel.relations.gz"), log.track
    )
    assert len(errors.translation) > 100
    assert errors.translation.mean() < 0.025
    assert math.degrees(errors.rotation.mean()) < 0.75


@pytest.mark.slow
@pytest.mark.shared
def test_the_stamps_of_a_log_have_no_part_in_its_map(shared_data: Path) -> None:
    """With odometry, time says nothing: the stamps as logged give the same, repaired in the file's order."""
    folder, paths = shared_data / "logs" / "intel", []
    with pytest.warns(UserWarning, match="stamps go back"):
        logs = [read_carmen(folder / name) for name in ("intel.clf.gz", "stamps_as_logged.clf.gz")]
    for log in logs:
        mapper = HectorMapper()
        for scan, odometry in zip(log.scans[:700], log.odometry[:700], strict=True):
            mapper.update(scan, odometry, None)
        paths.append(mapper.trajectory())
    np.testing.assert_allclose(paths[0].positions, paths[1].positions, atol=0.005)
    np.testing.assert_allclose(paths[0].yaw, paths[1].yaw, atol=0.002)


@pytest.mark.shared
def test_csail_beginning(shared_data: Path) -> None:
    folder = shared_data / "logs" / "csail"
    log, mapper = read_carmen(folder / "mit-csail.clf.gz"), HectorMapper()
    for scan, odometry in zip(log.scans[:600], log.odometry[:600], strict=True):
        mapper.update(scan, odometry, None)
    errors = reference_errors(mapper.trajectory(), read_reference(folder / "reference_poses.log.gz"))
    assert len(errors.position) > 500
    assert np.sqrt((errors.position**2).mean()) < 0.2
