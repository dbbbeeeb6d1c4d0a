import gzip
import json
import math
import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from lirs_envs.lidar.noise import LidarNoise, draw_noise, measure
from lirs_envs.lidar.ray_casting import RayCaster
from lirs_envs.robot_model import CONTROL_PERIOD
from lirs_envs.sensing.odometry import DistanceNoise
from lirs_envs.sensing.sensors import read_noise
from lirs_envs.sensing.wheel_odometry import OdometryConfig
from lirs_extensions.search.twin.fit import Sample, fit_noise, fit_odometry, resolution_of
from lirs_extensions.search.twin.surface import (
    GATE,
    LogComparison,
    LogScans,
    blocks_of,
    compare,
    fit_surfaces,
)
from lirs_extensions.search.twin.twin import TwinResult, _beam_shares
from lirs_validation.cli import app as cli
from lirs_validation.cli.command import PROGRAM
from lirs_wct.arrays import FloatArray
from lirs_wct.geometry import Pose2, WallGrid
from lirs_wct.sources.laser_map import level_floor

ROOT = Path(__file__).parents[4]
ANGLES = np.radians(np.arange(-90.0, 91.0, 2.0))
PLANTED = LidarNoise(sigma=0.015, sigma_relative=0.002, quantization=0.01, dropout=0.02)


def room() -> WallGrid:
    """Return a room of 14 x 10 m with three boxes, oblique to the axes."""
    solid = np.zeros((200, 280), np.bool_)
    solid[[0, 1, -2, -1], :] = solid[:, [0, 1, -2, -1]] = True
    for row, col, height, width in ((90, 120, 20, 40), (10, 60, 16, 12), (170, 200, 14, 30)):
        solid[row : row + height, col : col + width] = True
    return WallGrid(solid, 0.05, Pose2(-3.0, -5.0, 0.3))


def drive(noise: LidarNoise, seed: int = 1) -> LogScans:
    """Return scans of two laps in the room, at poses with the errors of a mapper."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 4 * math.pi, 200)
    walls = room()
    around = np.column_stack((7 + 4.5 * np.cos(t), 5 + 3 * np.sin(t)))
    yaw = np.arctan2(3 * np.cos(t), -4.5 * np.sin(t)) + 0.3
    poses = np.column_stack((walls.origin.apply(around), np.unwrap(yaw)))
    caster = RayCaster(level_floor(walls), walls)
    ranges = np.empty((len(poses), len(ANGLES)), np.float32)
    for k, (x, y, heading) in enumerate(poses.tolist()):
        angles = heading + ANGLES
        rays = np.column_stack((np.cos(angles), np.sin(angles), np.zeros_like(angles)))
        exact = caster.cast((x, y, 0.5), rays, 30.0)
        measure(exact, *draw_noise(noise, len(ANGLES), rng), (0.0, 30.0), noise.parameters, ranges[k])
    errors = rng.normal(0, (0.01, 0.01, 0.002), poses.shape)
    return LogScans(ranges.astype(np.float64), ANGLES, poses + errors, blocks_of(poses), 30.0)


@pytest.fixture(scope="module")
def planted() -> tuple[LogScans, LogComparison]:
    scans = drive(PLANTED)
    return scans, compare(scans)


@pytest.mark.parametrize("quick", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_planted_noise_is_recovered(
    quick: bool, planted: tuple[LogScans, LogComparison], monkeypatch: pytest.MonkeyPatch
) -> None:
    if quick:
        for name, value in {"ROUNDS": 2, "SAMPLES": 12, "LEAST_SCANS": 1}.items():
            monkeypatch.setattr(f"lirs_extensions.search.twin.fit.{name}", value)
    scans, real = planted
    fitted = fit_noise(real, scans.poses, seed=2)
    at = np.array((2.0, 4.0, 6.0))
    found = fitted.noise.sigma + fitted.noise.sigma_relative * at
    np.testing.assert_allclose(found, PLANTED.sigma + PLANTED.sigma_relative * at, rtol=0.1)
    assert fitted.noise.dropout == pytest.approx(PLANTED.dropout, rel=0.2)
    assert fitted.noise.quantization == 0.01
    assert fitted.distance < 0.05
    assert fitted.low.dropout < fitted.noise.dropout < fitted.high.dropout
    result = TwinResult("room", "lms100", real, fitted, 1.0, None, len(scans.poses))
    drawn = [result.draw_noise(np.random.default_rng(k)).lidar for k in range(40)]
    assert set(drawn) <= set(fitted.samples)
    assert len(set(drawn)) > 5, "noise has the fit's uncertainty"


def test_without_noise_the_residuals_are_the_maps() -> None:
    sample = Sample.of(compare(drive(LidarNoise())))
    assert np.nanmax(sample.widths(sample.blocks)) < 0.005
    assert sample.shares(sample.blocks)[0] == 0


def test_only_localized_scans_of_odd_blocks_are_compared(planted: tuple[LogScans, LogComparison]) -> None:
    scans, real = planted
    assert not (real.used & scans.even).any()
    assert real.used.sum() > 0.9 * (~scans.even).sum()
    assert not real.compared[scans.even].any()


def test_an_object_that_the_map_lacks_is_no_noise(planted: tuple[LogScans, LogComparison]) -> None:
    scans, real = planted
    before = Sample.of(real)
    ranges = scans.ranges.copy()
    odd = np.flatnonzero(~scans.even)
    ranges[odd, 40:45] -= 1.0
    changed = compare(LogScans(ranges, scans.angles, scans.poses, scans.block, scans.range_max))
    hidden = changed.compared & (changed.residual < -GATE)
    assert hidden[:, 40:45].sum() > 0.9 * hidden.sum() > 0
    share = _beam_shares(changed)["on objects"]
    assert share == pytest.approx(
        hidden.sum() / np.isfinite(changed.residual[changed.compared]).sum(), rel=0.1
    )
    after = Sample.of(changed)
    widths = before.widths(before.blocks), after.widths(after.blocks)
    np.testing.assert_allclose(*widths, rtol=0.1)


def test_a_line_lies_on_the_mean_of_its_points() -> None:
    rng = np.random.default_rng(3)
    n = 4000
    normal = np.array((math.cos(0.7), math.sin(0.7)))
    bearing = rng.uniform(-0.5, 0.5, n) + 0.7
    directions = np.column_stack((np.cos(bearing), np.sin(bearing)))
    ranges = (2.0 + rng.normal(0, 0.02, n)) / (directions @ normal)
    scans = LogScans(
        ranges[:, None], np.zeros(1), np.column_stack((np.zeros((n, 2)), bearing)), np.arange(n) % 2 * 2, 30.0
    )
    surfaces = fit_surfaces(scans)
    lines = surfaces.lines[surfaces.lines[..., 3] > 500]
    assert len(lines) > 10
    assert np.abs(lines[:, :2] @ normal).min() > math.cos(math.radians(3))
    row, col = np.nonzero(surfaces.slot >= 0)
    centers = surfaces.low + (np.column_stack((col, row)) + 0.5) * 0.05
    offset = np.sign(surfaces.lines[..., :2] @ normal) * surfaces.lines[..., 2]
    error = offset - (2.0 - centers @ normal)[:, None]
    assert np.abs(error[surfaces.lines[..., 3] > 500]).max() < 0.01


def turning_path(length: float) -> FloatArray:
    """Return (n, 3) poses every 5 cm of a path that turns left and right."""
    s = np.arange(0, length, 0.05)
    yaw = np.sin(s / 6)
    return np.column_stack((np.cumsum(0.05 * np.cos(yaw)), np.cumsum(0.05 * np.sin(yaw)), yaw))


def test_planted_odometry_errors_are_recovered() -> None:
    rng = np.random.default_rng(4)
    truth = turning_path(1500.0)
    stamps = np.arange(len(truth)) * 0.1
    wheels = DistanceNoise(OdometryConfig(scale_sigma=0.04), rng)
    driven = [wheels.measure(0.05) for _ in truth]
    drift = np.cumsum(rng.normal(0, 0.01 * math.sqrt(CONTROL_PERIOD * 0.1), len(truth))) + 0.001 * stamps
    yaw = truth[:, 2] + drift
    measured = np.column_stack((np.cumsum(driven * np.cos(yaw)), np.cumsum(driven * np.sin(yaw)), yaw))
    fitted = fit_odometry(measured, truth, stamps, truth, 5.0, seed=5)
    assert fitted is not None
    assert fitted.scale_sigma[0] == pytest.approx(0.04, rel=0.1)
    assert fitted.rate_sigma[0] == pytest.approx(0.01, rel=0.1)
    assert fitted.rate_bias == pytest.approx(0.001, rel=0.2)
    assert fit_odometry(measured[:200], truth[:200], stamps[:200], truth[:200], 5.0, seed=5) is None


def test_times_at_rest_say_nothing_about_wheels() -> None:
    """Wheels that stand have no error, however long they do."""
    rng = np.random.default_rng(5)
    truth = turning_path(1500.0)
    yaw = truth[:, 2] + np.cumsum(rng.normal(0, 0.01 * math.sqrt(CONTROL_PERIOD * 0.1), len(truth)))
    measured = np.column_stack((np.cumsum(0.05 * np.cos(yaw)), np.cumsum(0.05 * np.sin(yaw)), yaw))
    stamps = 0.1 * np.arange(len(truth))
    fitted = fit_odometry(measured, truth, stamps, truth, 5.0, seed=5)
    k = np.sort(np.concatenate((np.arange(len(truth)), rng.integers(len(truth), size=300).repeat(200))))
    resting = fit_odometry(measured[k], truth[k], 0.1 * np.arange(len(k)), truth[k], 5.0, seed=5)
    assert fitted is not None
    assert resting is not None
    assert resting.rate_sigma[0] == pytest.approx(fitted.rate_sigma[0], rel=0.05)
    assert resting.rate_bias == pytest.approx(fitted.rate_bias, rel=0.05)


def test_steps_of_ranges_are_found() -> None:
    ranges = np.random.default_rng(6).uniform(1, 20, 5000)
    assert [resolution_of(np.round(ranges / step) * step) for step in (0.05, 0.01, 0.001)] == [
        0.05,
        0.01,
        0.001,
    ]
    assert resolution_of(ranges) == 0


def test_a_log_that_is_too_short_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = gzip.decompress((ROOT / "examples" / "data" / "office.clf.gz").read_bytes()).splitlines()
    log = tmp_path / "short.clf"
    log.write_bytes(b"\n".join(lines[:40]) + b"\n")
    monkeypatch.setattr("sys.argv", ["lirs-wct", "twin", str(log), "-o", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    error = capsys.readouterr().err.replace("\n", "")
    assert re.search(rf"{log}: its path must be at least 10 m long for a comparison, got [0-9.]+ m$", error)


@pytest.mark.slow
def test_the_command_writes_page_figures_and_preset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"ROUNDS": 2, "LEAST_SCANS": 1}.items():
        monkeypatch.setattr(f"lirs_extensions.search.twin.fit.{name}", value)
    log = str(ROOT / "examples" / "data" / "office.clf.gz")
    arguments = ("twin", log, "--draws", "3")
    result = CliRunner().invoke(PROGRAM, [*arguments, "-o", str(tmp_path)])
    assert result.exit_code == 0, result.output
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir())
    figures = json.loads((folder / "twin.json").read_text())
    page = (folder / "twin.html").read_text()
    for sentence in figures["sentences"]:
        assert sentence in result.output
        assert sentence in unescape(page)
    assert re.match(r"wheels: not known, the drive is too short; turns 0\.\d ± ", figures["sentences"][2])
    assert re.match(
        "On this log's noise, cartographer's ATE is .* m in all 3 draws.$", figures["sentences"][3]
    )
    assert "What differs most: " in figures["sentences"][4]
    assert "Not covered: loop closures that fail" in figures["sentences"][5]
    assert f"next: lirs-wct validate medium --noise {folder / 'noise.yaml'}" in result.output.replace(
        "\n", ""
    )
    assert figures["kolmogorov"]["after"] < figures["kolmogorov"]["before"]
    noise = read_noise(folder / "noise.yaml")
    assert isinstance(noise.lidar, LidarNoise)
    assert noise.lidar.sigma == figures["noise"]["fitted"]["sigma"]
    assert noise.odometry.scale_bias == figures["odometry"]["scale"]
    assert page.count("data:image/png") == 3
    assert (folder / "scans.png").stat().st_size > 10_000
    (row,) = figures["replay"]["mappers"]
    assert (row["mapper"], row["real"], row["inside"]) == ("cartographer", None, None)
    assert row["status"] == ["ok"] * 3
    assert row["interval"] == {
        **{"inside": 3, "total": 3, "low": min(row["simulated"]), "high": max(row["simulated"])}
    }
    assert [path.name for path in folder.glob("simulated-*")] == ["simulated-1.clf.gz"]

    # Several processes change nothing; with a truth, the error on the log is compared.
    known = ("--reference", str(folder / "truth.tum"), "--replay", "cartographer,hector", "--jobs", "2")
    result = CliRunner().invoke(PROGRAM, [*arguments, *known, "-o", str(tmp_path / "known")])
    assert result.exit_code == 0, result.output
    assert "; on the log it is " in result.output
    (folder,) = (tmp_path / "known").iterdir()
    same, hector = json.loads((folder / "twin.json").read_text())["replay"]["mappers"]
    assert same["simulated"] == row["simulated"]
    assert same["inside"] == (min(row["simulated"]) <= same["real"] <= max(row["simulated"]))
    assert len(set(hector["simulated"])) == 3
