"""Preflight of a log: a sound one is fit, each fault is named, and no mapper runs."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_validation import map_log
from lirs_validation.logs.map_log import check_log_file
from lirs_validation.logs.preflight import check_log_data
from lirs_validation.record.verdict import judge_log
from lirs_wct.errors import SourceError
from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.formats.drive_files import write_scans
from lirs_wct.formats.laser_log import LaserLog, LineStamps, LogTopic
from lirs_wct.geometry.pose import Pose2, Pose3, Trajectory
from lirs_wct.geometry.scan import ImuReadings, LaserScan

N, PERIOD = 60, 0.1


def log(mount: Pose3 | None = None, returns: int = 31, jump: float = 0.0, frozen: float = 0.0) -> LaserLog:
    """A robot that stands for 3 s and drives with 0.5 m/s; its scan is frozen for the last seconds."""
    stamps = 100 + PERIOD * np.arange(N)
    driven = 0.5 * np.maximum(0.0, stamps - 103) + jump * (stamps > 104)
    ranges = np.full((N, 31), np.inf, np.float32)
    ranges[:, :returns] = 3.0 - 0.1 * np.clip(stamps - 103, 0.0, 2.9 - frozen)[:, None]
    scans = [
        LaserScan(row, -1.5, 0.1, 0.1, 10.0, t, mount or Pose3())
        for row, t in zip(ranges, stamps.tolist(), strict=True)
    ]
    poses = [Pose2(x) for x in driven.tolist()]
    topics = (
        LogTopic("/scan", ("laser",), stamps, stamps + 0.01),
        LogTopic("/odom", ("odom -> base_link",), stamps, stamps + 0.02),
    )
    lines = LineStamps(stamps, stamps, np.ones(N, bool))
    track = Trajectory.from_poses(stamps.tolist(), poses)
    return LaserLog(tuple(scans), tuple(poses), track, lines, topics=topics)


def shifted(topic: int, stamps: float = 0.0, received: float = 0.0, some: slice = slice(None)) -> LaserLog:
    found = log()
    topics = list(found.topics)
    t = topics[topic]
    topics[topic] = replace(t, stamps=t.stamps[some] + stamps, received=t.received[some] + received)
    return replace(found, topics=tuple(topics))


def test_a_sound_log_is_fit() -> None:
    found = check_log_data(log())
    assert (found.findings, found.repairs) == ((), ())
    assert found.sentence == "fit for planar mapping"
    facts = dict(found.facts)
    assert facts["/scan"] == "60 messages, 10.0 Hz, laser, stamps 10 ms before reception"
    assert facts["motion by odometry"] == "1.5 m, at most 0.50 m/s, 0 deg/s"
    assert facts["common to scans and odometry"] == "5.9 s"


BY = " by their reception: --time receive if the map breaks"
FAULTS: list[tuple[LaserLog, str, bool]] = [
    (
        log(Pose3.from_rpy(0, 0, 0, math.pi / 2, 0, 0)),
        "the transforms mount the laser at 90 deg to the gr",
        True,
    ),
    (log(Pose3.from_rpy(0, 0, 0, math.pi, 0, 0)), "", False),
    (log(returns=9), "100 % of the scans have fewer than 10 returns", True),
    (log(frozen=1.5), "the scan stays the same over 0.8 m of odometry", True),
    (log(frozen=0.9), "", False),
    (log(returns=0, frozen=1.5), "100 % of the scans have fewer than 10 returns", True),
    (log(jump=1.6), "odometry jumps by up to 1.6 m (1 x)", True),
    (log(jump=0.6), "", False),
    (shifted(0, received=0.5), f"stamps of /scan are 0.49 s older than those of /odom{BY}", False),
    (shifted(1, received=0.4), f"stamps of /odom are 0.41 s older than those of /scan{BY}", False),
    (shifted(1, received=0.2), "", False),
    (shifted(1, some=slice(20, None)), "odometry begins 2.0 s after the scans", False),
    (shifted(1, some=slice(0, 40)), "odometry ends 2.0 s before the scans", False),
    (shifted(0, some=slice(0, None, 59)), "", False),
    (
        replace(log(), track=Trajectory.from_poses([], [])),
        "no odometry, or one that never changes: --mapper",
        False,
    ),
]


@pytest.mark.parametrize(("faulty", "text", "unfit"), FAULTS)
def test_faults_are_named(faulty: LaserLog, text: str, unfit: bool) -> None:
    found = check_log_data(faulty)
    assert [str(finding)[: len(text)] for finding in found.findings] == ([text] if text else [])
    assert bool(found.unfit) == unfit
    assert found.sentence.startswith("not fit for planar mapping: " if unfit else "fit for planar mapping")


def test_pauses_are_counted() -> None:
    found = shifted(0)
    stamps = np.concatenate((found.topics[0].stamps[:30], found.topics[0].stamps[30:] + 2.5))
    paused = replace(found, topics=(replace(found.topics[0], stamps=stamps), found.topics[1]))
    assert "/scan pauses for up to 2.6 s (1 x)" in map(str, check_log_data(paused).findings)


@pytest.mark.parametrize(("noise", "told"), [(0.01, False), (0.2, True)])
def test_a_shaky_gyroscope_is_told(noise: float, told: bool) -> None:
    stamps = np.arange(100.0, 105.9, 0.01)
    rates = np.random.default_rng(1).normal(0, noise, (len(stamps), 3))
    rates[stamps > 103] += 5.0  # the motion is not the gyroscope's noise
    found = check_log_data(replace(log(), inertial=ImuReadings(stamps, rates, np.zeros((len(stamps), 3)))))
    assert any("gyroscope at rest" in str(finding) for finding in found.findings) == told
    noted = float(dict(found.facts)["gyroscope at rest"].split()[1])
    assert noted == pytest.approx(noise, rel=0.2)


def test_the_log_is_at_fault_and_not_the_mapper() -> None:
    entry: dict[str, Any] = {
        "name": "a",
        "config": {"log": "a.clf", "mapper": "cartographer"},
        "status": "lost",
        "reason": "the mapper lost its place",
        "log": {"unfit": "stamps of /scan are 1 s older: --time receive"},
    }
    sentence = judge_log(entry).sentence
    assert sentence.startswith("a.clf is not fit for planar mapping: stamps of /scan are 1 s older")
    assert "cartographer" not in sentence
    entry["log"] = {"findings": ["/odom pauses for up to 8.0 s (1 x)"], "repaired": {}}
    sentence = judge_log(entry).sentence
    assert "cartographer" in sentence
    assert "The log may be at fault: /odom pauses for up to 8.0 s (1 x)." in sentence
    entry["log"] = {}
    assert "cartographer" in judge_log(entry).sentence


@pytest.mark.shared
@pytest.mark.parametrize("name", ["csail/mit-csail", "edmonton/edmonton", "intel/intel", "orebro/orebro"])
def test_real_logs_are_fit(name: str, shared_data: Path) -> None:
    assert check_log_file(shared_data / "logs" / f"{name}.clf.gz").sentence == "fit for planar mapping"


def test_mapping_warns_of_an_unfit_log_and_keeps_the_findings(finished_run: Path, tmp_path: Path) -> None:
    own = read_carmen(finished_run / "scans.clf.gz")
    poses = [pose or Pose2() for pose in own.odometry]
    far = [Pose2(100, 0, 0) @ pose if k > len(poses) // 2 else pose for k, pose in enumerate(poses)]
    write_scans(tmp_path / "jump.clf.gz", zip(own.scans, far, strict=True))
    with pytest.warns(UserWarning, match=r"jump\.clf\.gz: not fit for planar mapping: odometry jumps by"):
        mapped = map_log(tmp_path / "jump.clf.gz", mapper="hector", second="none")
    assert mapped.record.log["findings"] == [mapped.record.log["unfit"]]
    assert mapped.record.verdict.sentence.startswith("jump.clf.gz is not fit for planar mapping")


def test_a_stamp_far_away_costs_no_memory() -> None:
    found = log()
    stamps = np.concatenate(([0.0], found.track.stamps[1:] + 1.7e9))
    track = replace(found.track, stamps=stamps)
    facts = dict(check_log_data(replace(found, track=track)).facts)
    assert facts["motion by odometry"] == "1.5 m, at most 0.50 m/s, 0 deg/s"


def test_a_car_on_a_road_does_not_jump() -> None:
    found = log()
    track = Trajectory.from_poses(found.track.stamps.tolist(), [Pose2(1.6 * k) for k in range(N)])
    assert check_log_data(replace(found, track=track)).unfit == ""


def test_odometry_that_leaves_no_map_is_refused(finished_run: Path, tmp_path: Path) -> None:
    own = read_carmen(finished_run / "scans.clf.gz")
    poses = [Pose2(1e6) if k == 50 else pose or Pose2() for k, pose in enumerate(own.odometry)]
    write_scans(tmp_path / "far.clf.gz", zip(own.scans, poses, strict=True))
    with pytest.raises(SourceError, match=r"far\.clf\.gz: not fit for planar mapping: odometry jumps"):
        map_log(tmp_path / "far.clf.gz", mapper="hector", second="none")
