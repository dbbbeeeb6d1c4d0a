"""slam_toolbox as published: the C++ program's matcher calls and poses, its gates, and its parameters."""

import csv
import gzip
import os
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from lirs_envs.robots.robot import make_robot
from lirs_extensions.originals.slam_toolbox.config import SlamToolboxOriginalConfig
from lirs_extensions.originals.slam_toolbox.mapper import WARM_UP, SlamToolboxOriginalMapper
from lirs_extensions.originals.slam_toolbox.scan_matching import (
    CorrelativeMatcher,
    ScanNode,
    SensorMatch,
    seen_from,
)
from lirs_validation.metrics.trajectory import trajectory_errors
from lirs_wct import Pose2
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.geometry import wrap_angle, wrap_angles
from slam_baselines.mapper import make_mapper, parameter_text, read_parameters, room_pose, room_scan
from tests.lirs_extensions.originals.recorded import unpacked

RUNS = ("simple-2", "medium-1", "medium-2", "advanced-1", "advanced-2", "willow-1")
MATCHED = CorrelativeMatcher.match
KERNELS = {"OPENBLAS_CORETYPE": "Haswell"}
"""Kernels of OpenBLAS by whose rounding the optimizer stops where that of the program does."""


class Traced:
    """Every call of the matchers as a row of the program's trace."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls: list[tuple[str, ScanNode, list[ScanNode], SensorMatch]] = []

        def match(matcher: CorrelativeMatcher, node: ScanNode, base: Any, start: Pose2, **how: bool) -> Any:
            found = MATCHED(matcher, node, base, start, **how)
            matched = "chain_or_fine_loop" if how.get("fine", True) else "coarse_loop"
            self.calls.append(("sequential" if how.get("penalize") else matched, node, list(base), found))
            return found

        monkeypatch.setattr(CorrelativeMatcher, "match", match)

    def compare(self, mapper: SlamToolboxOriginalMapper, trace: Path) -> None:
        number = {id(node): k for k, node in enumerate(mapper._graph.nodes)}
        rows = list(csv.DictReader(gzip.decompress(trace.read_bytes()).decode().splitlines()))
        assert len(rows) == len(self.calls) > 20
        for row, (kind, node, base, found) in zip(rows, self.calls, strict=True):
            k, chain = number[id(node)], [number[id(each)] for each in base]
            first, last = int(row["base_first"]), int(row["base_last"])
            assert (kind, chain) == (row["kind"], [*range(first, last + 1)])
            assert int(row["scan"]) == (-1 if kind == "sequential" else k)
            ours = found.response, found.sensor.x, found.sensor.y
            assert ours == pytest.approx([float(row[key]) for key in ("response", "x", "y")], abs=1e-6)
            assert abs(wrap_angle(found.sensor.yaw - float(row["heading"]))) < 1e-6
            xx, xy, yy, hh = (float(row[f"cov_{key}"]) for key in ("xx", "xy", "yy", "hh"))
            theirs = np.array(((xx, xy, 0), (xy, yy, 0), (0, 0, hh)))
            deviations = np.sqrt(np.diag(theirs))
            assert (abs(found.covariance - theirs) < 1e-3 * np.outer(deviations, deviations)).all()


def replay(log: Any, scans: Any) -> tuple[SlamToolboxOriginalMapper, np.ndarray]:
    """Return the mapper and its poses (n, 3) in the odometry frame as known online."""
    mapper, start = SlamToolboxOriginalMapper(), log.odometry[0]
    poses = [start @ mapper.update(*pair, None) for pair in zip(scans, log.odometry, strict=True)]
    return mapper, np.array([pose.as_array() for pose in poses])


@pytest.mark.shared
@pytest.mark.parametrize("run", ["simple-1", *(pytest.param(run, marks=pytest.mark.slow) for run in RUNS)])
def test_every_matcher_call_and_every_pose_is_the_original_s(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: str
) -> None:
    folder, traced = shared_data / "fidelity" / run, Traced(monkeypatch)
    log, mount = read_carmen(folder / "scans.clf.gz"), make_robot("husky").T_base_laser
    mapper, poses = replay(log, [replace(scan, T_base_laser=mount) for scan in log.scans])
    traced.compare(mapper, folder / "slam_toolbox_trace.csv.gz")
    original = unpacked(folder / "original_slam_toolbox.tum.gz", tmp_path)
    np.testing.assert_allclose(poses[:, :2], original.positions[:, :2], atol=2e-6)
    np.testing.assert_allclose(wrap_angles(poses[:, 2] - original.yaw), 0.0, atol=1e-6)


@pytest.mark.shared
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "nodes", "loops", "edges"), [("intel", 736, 69, 860), ("mit-csail", 535, 11, 587)]
)
def test_loops_are_closed_as_by_the_original(
    request: pytest.FixtureRequest,
    shared_data: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    nodes: int,
    loops: int,
    edges: int,
) -> None:
    """Where the optimizer stops is part of the result; kernels are chosen when a process starts."""
    if not KERNELS.items() <= os.environ.items():
        command = [sys.executable, "-m", "pytest", "-q", request.node.nodeid]
        done = subprocess.run(
            command, cwd=request.config.rootpath, env=os.environ | KERNELS, capture_output=True, text=True
        )
        assert "1 passed" in done.stdout, done.stdout
        return
    folder, traced = shared_data / "logs" / name.removeprefix("mit-"), Traced(monkeypatch)
    log = read_carmen(folder / f"{name}.clf.gz")
    mapper, poses = replay(log, log.scans)
    counts = mapper.stats.counts
    assert (counts["nodes"], counts["loops"], counts["edges"]) == (nodes, loops, edges)
    traced.compare(mapper, folder / "slam_toolbox_trace.csv.gz")
    original = unpacked(folder / "original_slam_toolbox_online.tum.gz", tmp_path)
    assert np.hypot(*(poses - original.positions)[:, :2].T).max() < (0.03 if name == "intel" else 1e-3)


def drive(steps: list[float], seconds: float = 0.5, turn: float = 0.0, **config: Any) -> list[int]:
    """Return the numbers of the scans that become nodes after straight steps, meters."""
    mapper, x, nodes = make_mapper("slam_toolbox_original", **config), 0.0, list[int]()
    for k, step in enumerate(steps):
        x += step
        before = mapper.stats.used
        mapper.update(room_scan(Pose2(x - 3, -2), seconds * k), Pose2(x, 0, turn * k), None)
        nodes += [k] * (mapper.stats.used - before)
    return nodes


def test_the_gate_of_the_node_comes_before_that_of_the_graph() -> None:
    """0.48 m pass the first and not the second, so that nodes lie twice as far apart."""
    assert drive([0.0] + 24 * [0.16]) == [0, 4, 10, 16, 22]
    assert drive([0.0] + 24 * [0.17]) == [0, *range(4, 25, 3)]
    assert drive([0.0] + 9 * [0.6], seconds=0.26) == [0, 4, 6, 8]
    assert drive([0.0] + 9 * [0.6], throttle_scans=4) == [0, 7]


def test_a_turn_on_the_spot_makes_no_node() -> None:
    assert drive([0.0] + 9 * [0.0], turn=0.6) == [0]
    assert drive([0.0] + 9 * [0.15], turn=0.2) == [0, 4, 7]


def test_beams_without_return_are_infinite() -> None:
    """A code for no return, too far, too near and no number: all are no hits, but count as beams."""
    scan = room_scan(Pose2(), 0.0)
    far, short = np.float32(scan.range_max * 0.9995), scan.ranges.copy()
    short[[3, 50, 100, 200, 201]] = far, np.inf, -np.inf, np.nan, scan.range_max
    node = ScanNode(replace(scan, ranges=short), Pose2(), SlamToolboxOriginalConfig())
    assert (len(node.ranges), len(node.returns)) == (len(short), len(short) - 5)
    assert np.isinf(node.ranges[[3, 50, 100, 200, 201]]).all()
    walls = ScanNode(replace(scan, ranges=short), Pose2(), SlamToolboxOriginalConfig(no_return_share=2.0))
    assert len(walls.returns) == len(short) - 3


@pytest.mark.shared
def test_a_code_for_no_return_makes_a_ring_of_walls(shared_data: Path, tmp_path: Path) -> None:
    """The C++ program has 2.849 m with it, and .293 m with infinite ranges."""
    folder, errors = shared_data / "fidelity" / "simple-1", list[float]()
    log, mount = read_carmen(folder / "scans.clf.gz"), make_robot("husky").T_base_laser
    truth = unpacked(folder / "truth.tum.gz", tmp_path)
    for code in (np.inf, 20.0):
        mapper = make_mapper("slam_toolbox_original", no_return_share=2.0)
        for scan, odometry in zip(log.scans, log.odometry, strict=True):
            ranges = np.where(np.isinf(scan.ranges), np.float32(code), scan.ranges)
            mapper.update(replace(scan, ranges=ranges, T_base_laser=mount), odometry, None)
        errors.append(trajectory_errors(truth, mapper.trajectory()).ate_rmse)
    assert errors[0] < 0.35
    assert 2.0 < errors[1] < 4.0


def test_a_wall_seen_from_behind_is_left_out() -> None:
    """Both ways along a wall: counter-clockwise about the viewpoint is its front."""
    wall = np.stack((np.full(17, 2.0), np.linspace(-1, 1, 17)), axis=-1)
    assert seen_from(wall, 0.0, 0.0).sum() == 16
    assert not seen_from(wall, 4.0, 0.0).any()
    wall[0] = np.inf, np.nan  # infinity times the sine of 0
    assert seen_from(wall, 0.0, 0.0).sum() == 16


def laps() -> SlamToolboxOriginalMapper:
    """Return a mapper after more than a lap in a room, with links so short that the lap is a loop."""
    mapper = SlamToolboxOriginalMapper(SlamToolboxOriginalConfig(**WARM_UP))  # type: ignore[arg-type]
    start, odometry = room_pose(0.0), Pose2()
    for k, (before, now) in enumerate(pairwise(np.arange(0.0, 7.4, 0.17).tolist())):
        step = room_pose(before).inverse() @ room_pose(now)
        odometry = odometry @ Pose2(1.02 * step.x, step.y, step.yaw)
        pose = mapper.update(room_scan(room_pose(now), 0.6 * k), odometry, None)
    assert pose.distance(start.inverse() @ room_pose(now)) < 0.6
    return mapper


def test_a_loop_is_closed_and_every_drive_is_the_same() -> None:
    first, second = laps(), laps()
    assert first.stats.counts["loops"] == len(first.loops) > 0
    assert first.loops[0].seen < first.loops[0].stamp
    np.testing.assert_array_equal(first.trajectory().positions, second.trajectory().positions)
    np.testing.assert_array_equal(first.map().log_odds, second.map().log_odds)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"correlation_search_space_smear_deviation": 0.2}, "correlation_search_space_smear_deviation of"),
        ({"loop_search_space_dimension": 0.05}, "loop_search_space_dimension of"),
        ({"fine_search_angle_offset": 0.05}, "fine_search_angle_offset of coarse_angle_resolution 0.0349"),
        ({"max_laser_range": 1e6}, "max_laser_range of"),
        ({"scan_buffer_size": 0}, "scan_buffer_size of slam_toolbox_original must be"),
    ],
)
def test_parameters_that_do_not_fit_are_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        SlamToolboxOriginalConfig(**values)


def test_a_parameter_file_of_the_ros_node_is_read(tmp_path: Path) -> None:
    """Values that are the defaults are left out, so that equal runs have equal names."""
    path = tmp_path / "online_sync.yaml"
    values = {"mode": "mapping", "resolution": 0.05, "scan_buffer_size": 20, "max_laser_range": 12}
    values |= {"do_loop_closing": False, "minimum_travel_distance": 0.3, "ceres_loss_function": "None"}
    path.write_text(yaml.safe_dump({"slam_toolbox": {"ros__parameters": values}}))
    with pytest.warns(
        UserWarning, match="online_sync.yaml: without effect on .*: ceres_loss_function, mode$"
    ):
        text = parameter_text(str(path))
    known = ("scan_buffer_size", "max_laser_range", "do_loop_closing", "minimum_travel_distance")
    assert read_parameters(text) == {name: values[name] for name in known}
    assert make_mapper("slam_toolbox_original", **read_parameters(text)).config.scan_buffer_size == 20  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "slam_toolbox: {ros__parameters: {resolution: -1}}",
            "resolution of slam_toolbox_original must be above 0",
        ),
        (
            "slam_toolbox: {ros__parameters: {scan_buffer_size: ten}}",
            "scan_buffer_size of .* must be a whole number",
        ),
        ("slam_toolbox: {ros__parameters: 3}", "must hold `slam_toolbox: ros__parameters"),
        ("image: map.pgm", "must hold `slam_toolbox: ros__parameters"),
        ("slam_toolbox: [", "line 1: "),
        (None, "cannot be read"),
    ],
)
def test_a_bad_parameter_file_is_one_line(text: str | None, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(SourceError, match=rf"^{path}: {reason}"):
        parameter_text(str(path))
