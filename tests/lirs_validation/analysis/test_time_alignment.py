"""Trajectories of other programs: another rate, another clock, another frame."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lirs_validation.analysis.results import read_run
from lirs_validation.analysis.score import find_time_offset, interpolate_poses, score
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.drive_files import read_tum, write_tum
from lirs_wct.geometry import Pose2, Trajectory
from tests.command_line import run_command


def drive(stamps: np.ndarray) -> Trajectory:
    """Return a smooth drive with changing speed and turns at any stamps."""
    t = np.asarray(stamps)
    fine = np.arange(-5, 130, 0.005)
    speed = 0.8 + 0.4 * np.sin(fine / 3.1) * np.sin(fine / 1.7)
    yaw = 1.5 * np.sin(fine / 4.3) + 0.8 * np.sin(fine / 2.1 + 1)
    x, y = (np.cumsum(speed * f(yaw)) * 0.005 for f in (np.cos, np.sin))
    columns = (np.interp(t, fine, c).tolist() for c in (x, y, yaw))
    return Trajectory.from_poses(t, (Pose2(*row) for row in zip(*columns, strict=True)))


@settings(deadline=None, max_examples=20)
@given(
    offset=st.one_of(st.floats(-30, 30), st.just(1.7e9)),
    rate=st.sampled_from((5.0, 10.0, 30.0, 100.0)),
    turn=st.floats(-3, 3),
    seed=st.integers(0, 1000),
)
def test_the_offset_of_a_clock_is_found(offset: float, rate: float, turn: float, seed: int) -> None:
    """Within 10 ms, in any frame, of a part of the drive with the noise of a mapper; below 50 ms, none."""
    rng = np.random.default_rng(seed)
    truth = drive(np.arange(0, 60, 0.1))
    part = drive(np.arange(7.013, 52, 1 / rate)).moved(Pose2(5.0, -3.0, turn))
    noisy = part.positions + rng.normal(0, (0.01, 0.01, 0.0), part.positions.shape)
    found = find_time_offset(truth, Trajectory(part.stamps - offset, noisy, part.quaternions))
    assert found == pytest.approx(offset, abs=0.01) or (found == 0.0 and abs(offset) < 0.06)


@pytest.mark.parametrize("seed", range(4))
def test_the_same_clock_has_no_offset_though_the_path_errs(seed: int) -> None:
    truth = drive(np.arange(0, 60, 0.1))
    walk = np.cumsum(np.random.default_rng(seed).normal(0, 0.02, truth.positions.shape), axis=0)
    noisy = Trajectory(truth.stamps, truth.positions + walk * (1, 1, 0), truth.quaternions)
    assert find_time_offset(truth, noisy) == 0.0
    late = replace(noisy, stamps=noisy.stamps + 0.2)
    assert find_time_offset(truth, late) == pytest.approx(-0.2, abs=0.05)


def test_an_offset_that_is_not_there_is_said() -> None:
    truth = drive(np.arange(0, 60, 0.1))
    straight = Trajectory.from_poses(truth.stamps, [Pose2(0.1 * k, 0.0) for k in range(len(truth))])
    with pytest.raises(SourceError, match="no time offset found"):
        find_time_offset(truth, straight)
    with pytest.raises(SourceError, match="too short"):
        find_time_offset(truth, drive(np.array((0.0, 0.1))))


def test_poses_of_another_rate_are_interpolated() -> None:
    scans = np.arange(0, 60, 0.1)
    truth = drive(scans)
    found = interpolate_poses(drive(np.arange(0.03, 58, 1 / 30)), scans)
    assert len(found) == pytest.approx(580, abs=1)
    same = truth.planar_at(found.stamps)
    np.testing.assert_allclose(found.planar_at(found.stamps), same, atol=2e-3)
    keyframes = interpolate_poses(drive(scans[::3]), scans)
    np.testing.assert_array_equal(keyframes.stamps, scans[:598])
    np.testing.assert_allclose(keyframes.xy, truth.xy[:598], atol=1e-2)
    sparse = drive(scans[::25])
    assert interpolate_poses(sparse, scans) is sparse
    gap = np.concatenate((np.arange(0.03, 20, 1 / 30), np.arange(30, 58, 1 / 30)))
    kept = interpolate_poses(drive(gap), scans).stamps
    assert not ((kept > 20.1) & (kept < 29.9)).any()


def test_another_rate_clock_and_frame_score_alike(finished_run: Path, tmp_path: Path) -> None:
    run = read_run(finished_run)
    own = read_tum(run.folder / "estimate.tum")
    stamps = np.arange(own.stamps[0] + 0.013, own.stamps[-1], 1 / 30)
    x, y, yaw = own.planar_at(stamps).T.tolist()
    other = Trajectory.from_poses(stamps - 1.7e9, map(Pose2, x, y, yaw)).moved(Pose2(50, 20, 2))
    write_tum(tmp_path / "est.tum", other)
    with pytest.raises(SourceError, match="--time-offset auto finds a constant difference"):
        score(run, trajectory=tmp_path / "est.tum")
    with pytest.raises(SourceError, match=r"another frame: .*--frame align"):
        score(run, trajectory=tmp_path / "est.tum", time_offset="auto")
    found = score(run, trajectory=tmp_path / "est.tum", time_offset="auto", frame="align")
    assert found.time_offset == pytest.approx(1.7e9, abs=0.05)  # of 10 s
    assert found.status == "ok"
    assert found.trajectory["ate_rmse"] == pytest.approx(run.entry["trajectory"]["ate_rmse"], abs=0.01)
    with pytest.raises(ConfigError, match="--frame align needs a trajectory"):
        score(run, map_yaml=run.folder / "map.yaml", frame="align")
    words = ["score", str(run.folder), "--trajectory", str(tmp_path / "est.tum")]
    words += ["--frame", "align", "-o", str(tmp_path / "score.json"), "--time-offset"]
    for given_, code in (("auto", 0), ("1.7e9", 0), ("soon", 2), ("nan", 2)):
        assert run_command(*words, given_) == code
    document = json.loads((tmp_path / "score.json").read_text())
    assert document["time_offset"] == 1.7e9
    assert math.isfinite(document["trajectory"]["ate_rmse"])
