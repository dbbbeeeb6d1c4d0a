"""Scoring a run's own files gives the run's own figures; what does not fit the run is said."""

import json
import math
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lirs_validation.analysis.export import export_run
from lirs_validation.analysis.results import RunFolder, read_run, recorded_config, true_pose_map
from lirs_validation.analysis.score import find_time_offset, score
from lirs_validation.metrics.map import agreement, iou
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.drive_files import read_tum, write_tum
from lirs_wct.formats.map_server import read_map, write_map
from lirs_wct.geometry.pose import Pose2, Trajectory
from lirs_wct.sources.source import BuildOptions
from tests.command_line import run_command
from tests.kit import refused


@pytest.fixture
def run(finished_run: Path) -> RunFolder:
    return read_run(finished_run)


@pytest.fixture
def foreign(run: RunFolder, tmp_path: Path) -> tuple[Path, Path]:
    """The run's own result as of another program: in the map frame, with pauses of more than 2 s."""
    folder = tmp_path / "foreign"
    folder.mkdir()
    T_map_world = read_tum(run.folder / "truth.tum").pose2(0).inverse()
    estimate = read_tum(run.folder / "estimate.tum").moved(T_map_world)
    some = np.arange(101) % 35 < 12
    thinned = Trajectory(estimate.stamps[some], estimate.positions[some], estimate.quaternions[some])
    write_tum(folder / "est.tum", thinned)
    write_map(folder / "map", read_map(run.folder / "map.yaml").moved(T_map_world))
    return folder / "est.tum", folder / "map.yaml"


def test_a_bag_scores_as_the_poses_in_it(run: RunFolder, tmp_path: Path) -> None:
    export_run(run, tmp_path, ("bag",))
    recorded = run.entry["trajectory"]
    found = score(run, trajectory=tmp_path / "bag")
    assert found.frame == "map"
    for name in ("ate_rmse", "yaw_rmse", "final_drift", "scan_coverage", "poses"):
        assert found.trajectory[name] == pytest.approx(recorded[name], abs=1e-6), name
    assert score(run, trajectory=Path(f"{tmp_path}/bag:/ground_truth")).trajectory["ate_rmse"] < 1e-6
    odometry = score(run, trajectory=Path(f"{tmp_path}/bag:/odom")).trajectory
    assert odometry["ate_rmse"] == pytest.approx(recorded["odometry_ate_rmse"], abs=1e-6)
    with pytest.raises(SourceError, match="BAG:/TOPIC /pose: no topic of"):
        score(run, trajectory=Path(f"{tmp_path}/bag:/pose"))
    with pytest.raises(ConfigError, match=r"estimate\.tum: a topic can be given for a ROS bag only"):
        score(run, trajectory=Path(f"{run.folder}/estimate.tum:/pose"))


def test_its_own_files_score_its_own_figures(run: RunFolder) -> None:
    own = score(run, trajectory=run.folder / "estimate.tum", map_yaml=run.folder / "map.yaml")
    assert own.frame == "world"
    for name, value in own.map.items():
        # Poses are written to the nanometer: a cell at the tolerance may fall on either side of it.
        near = pytest.approx(run.entry["map"][name], abs=2e-3)
        assert value == (
            near if name.endswith("_aligned") or name.startswith("start_") else run.entry["map"][name]
        ), name
    recorded = run.entry["trajectory"]
    assert set(recorded) - set(own.trajectory) == {"ate_rmse_online", "robot_lengths"}
    for name, value in own.trajectory.items():
        assert value == pytest.approx(recorded[name], abs=2e-8), name


def claimed(run: RunFolder, path: Path, *, factor: float = 1.0) -> Path:
    """The true path in the map frame with errors of a known covariance, which the file claims."""
    rng, truth = np.random.default_rng(2), read_tum(run.folder / "truth.tum")
    A = np.array(((0.2, 0.0, 0.0), (0.1, 0.005, 0.0), (0.0, 0.0, 0.01)))
    assert abs(truth.pose2(0).yaw) > 0.05, "frames must differ"
    in_map = truth.moved(truth.pose2(0).inverse())
    positions = in_map.positions.copy()
    positions[1:, :2] += rng.standard_normal((len(truth) - 1, 3)) @ A.T[:, :2]
    write_tum(path, replace(in_map, positions=positions))
    numbers = " ".join(f"{factor * x:.9g}" for x in (A @ A.T)[np.triu_indices(3)])
    lines = [line if line.startswith("#") else f"{line} {numbers}" for line in path.read_text().splitlines()]
    path.write_text("\n".join(lines))
    return path


def test_a_claimed_covariance_is_scored(run: RunFolder, tmp_path: Path) -> None:
    found = score(run, trajectory=claimed(run, tmp_path / "est.tum"))
    assert found.trajectory["inside_95"] == pytest.approx(0.95, abs=0.07)
    small = score(run, trajectory=claimed(run, tmp_path / "small.tum", factor=0.01)).trajectory
    assert small["inside_95"] < 0.2
    assert small["ate_rmse"] == pytest.approx(found.trajectory["ate_rmse"])
    aligned = score(run, trajectory=tmp_path / "est.tum", frame="align")
    assert "inside_95" not in aligned.trajectory
    with pytest.raises(SourceError, match=r"bad\.tum: covariance must be 3 x 3, .* got \[\[-0\.04"):
        score(run, trajectory=claimed(run, tmp_path / "bad.tum", factor=-1.0))


def test_the_map_frame_is_that_of_the_first_base_pose(run: RunFolder, foreign: tuple[Path, Path]) -> None:
    scored = score(run, trajectory=foreign[0], map_yaml=foreign[1])
    assert scored.frame == "map"
    assert scored.given == scored.trajectory["poses"] == 36
    assert scored.trajectory["scan_coverage"] == pytest.approx(36 / 101)
    assert scored.status == "incomplete"
    assert "35.6 % of the scans, at least 95 %" in scored.reason
    assert scored.trajectory["ate_rmse"] == pytest.approx(run.entry["trajectory"]["ate_rmse"], rel=0.3)
    assert scored.map["f1"] == pytest.approx(run.entry["map"]["f1"], abs=1e-6)
    assert scored.map["occupied_cells"] == run.entry["map"]["occupied_cells"]
    alone = score(run, map_yaml=foreign[1])
    assert (alone.frame, alone.trajectory, alone.status) == ("map", {}, "ok")
    aligned = {"f1_aligned", "false_occupied_aligned", "start_shift", "start_turn"}
    assert all(alone.map[name] is None for name in aligned)
    assert {k: v for k, v in alone.map.items() if k not in aligned} == {
        k: v for k, v in scored.map.items() if k not in aligned
    }


def test_a_map_alone_is_read_in_the_frame_that_it_fits(
    run: RunFolder, foreign: tuple[Path, Path], tmp_path: Path
) -> None:
    """The run's own map was read in the map frame without a word, and had an F1 of .067."""
    own = score(run, map_yaml=run.folder / "map.yaml")
    assert (own.frame, own.map["f1"]) == ("world", run.entry["map"]["f1"])
    assert score(run, map_yaml=foreign[1]).frame == "map"
    built = read_map(run.folder / "map.yaml")
    rng = np.random.default_rng(0)
    noise = replace(built, log_odds=rng.permuted(built.log_odds.ravel()).reshape(built.shape))
    write_map(tmp_path / "noise", noise)
    with pytest.raises(
        SourceError, match=r"noise\.yaml: in which frame\? F1 .* --frame map .* --frame world"
    ):
        score(run, map_yaml=tmp_path / "noise.yaml")
    assert score(run, map_yaml=tmp_path / "noise.yaml", frame="world").frame == "world"


def test_a_map_of_other_cells_meets_a_true_pose_map_of_its_own(run: RunFolder, tmp_path: Path) -> None:
    config = recorded_config(run.entry)
    fine = true_pose_map(run.folder, config, 0.05)
    recorded = read_map(run.folder / "map_true_pose.yaml")
    found = agreement(fine, recorded).f1
    overlap = iou(fine, recorded)
    # Scans to the millimeter.
    assert found > 0.995
    assert overlap > 0.95
    coarse = true_pose_map(run.folder, config, 0.1)
    write_map(tmp_path / "coarse", coarse)
    scored = score(run, map_yaml=tmp_path / "coarse.yaml", frame="world")
    assert (scored.map["f1"], scored.map["iou"], scored.map["unknown"]) == (1.0, 1.0, 0.0)


def test_the_config_reads_back(run: RunFolder) -> None:
    config = recorded_config(run.entry)
    assert config.build == BuildOptions(size=20.0, height=2.0, resize=(129, 129))
    assert config.digest == run.folder.name[-8:]
    with_more = json.loads(json.dumps(run.entry)) | {"config": dict(run.entry["config"]) | {"wind": 3}}
    with pytest.raises(SourceError, match="unknown to this version: wind"):
        recorded_config(with_more)


@pytest.mark.parametrize("turn", [Pose2(40.0, -3.0, 0.0), Pose2(0.0, 0.0, 1.2)])
def test_another_frame_is_said(
    run: RunFolder, foreign: tuple[Path, Path], tmp_path: Path, turn: Pose2
) -> None:
    write_tum(tmp_path / "odd.tum", read_tum(foreign[0]).moved(turn))
    with pytest.raises(SourceError, match=r"odd\.tum: another frame: .* first base pose; --frame align"):
        score(run, trajectory=tmp_path / "odd.tum")
    with pytest.raises(SourceError, match="it fits the map frame: --frame map"):
        score(run, trajectory=foreign[0], frame="world")


def test_a_map_from_elsewhere_is_said(run: RunFolder, tmp_path: Path) -> None:
    write_map(tmp_path / "far", read_map(run.folder / "map.yaml").moved(Pose2(500.0, 0.0, 0.0)))
    with pytest.raises(SourceError, match=r"far\.yaml: knows no cell of where the run took place"):
        score(run, map_yaml=tmp_path / "far.yaml")


def test_the_command(
    run: RunFolder, foreign: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "score.json"
    words = ["score", str(run.folder), "--trajectory", str(foreign[0]), "--map", str(foreign[1])]
    assert run_command(*words, "-o", str(target)) == 3  # a third of the scans has a pose
    document = json.loads(target.read_text())
    assert document["map"]["f1"] == pytest.approx(run.entry["map"]["f1"], abs=1e-6)
    assert document["files"]["map"] == str(foreign[1])
    assert np.isfinite(document["trajectory"]["ate_rmse"])
    shown = " ".join(capsys.readouterr().out.split())
    assert "36 scans have a pose, 36 poses were given" in shown
    assert "35.6 % of the scans" in shown
    for wrong in (words[:2], [*words, "--frame", "moon"]):
        assert run_command(*wrong) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1


CAMERA = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Rotation from a base (x ahead, z up) to a camera's optical frame (z ahead, y down)."""


def rows(trajectory: Trajectory, turn: np.ndarray | None = None) -> np.ndarray:
    """Return (n, 8) rows of a TUM file; `turn` expresses frame and body in other axes."""
    turned = Rotation.from_matrix(np.eye(3) if turn is None else turn)
    q = turned * Rotation.from_quat(trajectory.quaternions, scalar_first=True) * turned.inv()
    return np.column_stack((trajectory.stamps, turned.apply(trajectory.positions), q.as_quat()))


@pytest.fixture
def whole(run: RunFolder) -> Trajectory:
    """The run's estimate in the map frame."""
    T_map_world = read_tum(run.folder / "truth.tum").pose2(0).inverse()
    return read_tum(run.folder / "estimate.tum").moved(T_map_world)


def write_kitti(path: Path, table: np.ndarray) -> None:
    matrices = np.dstack((Rotation.from_quat(table[:, 4:]).as_matrix(), table[:, 1:4]))
    np.savetxt(path, matrices.reshape(-1, 12))


@pytest.mark.parametrize("form", ["tum", "bom", "unsorted", "equal", "euroc", "kitti"])
def test_trajectories_of_other_programs_are_read(
    form: str, run: RunFolder, whole: Trajectory, tmp_path: Path
) -> None:
    path, table = tmp_path / "est.txt", rows(whole)
    if form == "kitti":
        write_kitti(path, table)
    elif form == "euroc":
        nanoseconds = [f"{round(row[0] * 1e9) + 10**18}" for row in table]
        lines = [
            f"{t}," + ",".join(repr(float(v)) for v in (*row[1:4], row[7], *row[4:7], 0.0))
            for t, row in zip(nanoseconds, table, strict=True)
        ]
        path.write_text("\n".join(["#timestamp [ns],p_x [m],p_y,p_z,q_w,q_x,q_y,q_z,v_x", *lines]))
    else:
        table = {"unsorted": table[::-1], "equal": np.repeat(table, 2, axis=0)}.get(form, table)
        np.savetxt(path, table, header="stamp x y z qx qy qz qw")
        if form == "bom":
            path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    offset = -1e9 if form == "euroc" else 0.0
    with warnings.catch_warnings(record=True, action="always") as told:
        found = score(run, trajectory=path, time_offset=offset)
    assert found.trajectory["ate_rmse"] == pytest.approx(run.entry["trajectory"]["ate_rmse"], abs=1e-5)
    assert found.trajectory["scan_coverage"] == 1.0
    words = {"unsorted": "stamps go back 100 times, 0", "equal": "stamps go back 0 times, 101"}
    assert [words[form] in str(line.message) for line in told] == ([True] if form in words else [])


BAD = {
    "words": ("1 2 three", "not a trajectory"),
    "short": (
        "1 2 3\n2 3 4",
        r"has 8 numbers a line \(TUM\), 14 with a covariance, 12 \(KITTI\) or commas \(EuRoC\)",
    ),
    "ragged": ("1 0 0 0 0 0 0 1\n2 0 0", "not a trajectory"),
    "empty": ("# nothing\n", "has 8 numbers a line"),
    "nan": ("1 nan 0 0 0 0 0 1\n2 0 0 0 0 0 0 1", "its numbers must be finite"),
    "no rotation": ("1 0 0 0 0 1 0 0 0 0 0 0\n" * 101, "its matrices are no rotations"),
    "kitti": ("1 0 0 0 0 1 0 0 0 0 1 0\n" * 7, "has no stamps: needs one pose per scan, 101, got 7 poses"),
}


@pytest.mark.parametrize("name", BAD)
def test_damaged_trajectories_are_one_line(name: str, run: RunFolder, tmp_path: Path) -> None:
    text, message = BAD[name]
    (tmp_path / "bad.txt").write_text(text)
    with refused(words=rf"bad\.txt: .*{message}"):
        score(run, trajectory=tmp_path / "bad.txt")


@pytest.mark.parametrize("offset", [0.0, 5.0])
def test_the_axes_of_a_camera_are_named_and_turned(
    offset: float, run: RunFolder, whole: Trajectory, tmp_path: Path
) -> None:
    table = rows(whole, CAMERA)
    table[:, 0] += offset
    np.savetxt(tmp_path / "camera.tum", table)
    with pytest.warns(UserWarning, match=r"camera\.tum: its axes are z ahead, -y up: moved to the best fit"):
        found = score(run, trajectory=tmp_path / "camera.tum", time_offset="auto" if offset else 0.0)
    aligned = score(run, trajectory=run.folder / "estimate.tum", frame="align")
    assert found.frame == "align"
    assert found.time_offset == pytest.approx(-offset, abs=0.02)
    for name in ("ate_rmse", "yaw_rmse"):
        assert found.trajectory[name] == pytest.approx(aligned.trajectory[name], abs=5e-3), name


def test_the_axes_of_a_camera_do_not_fit_a_frame_of_the_robot(
    run: RunFolder, whole: Trajectory, tmp_path: Path
) -> None:
    np.savetxt(tmp_path / "camera.tum", rows(whole, CAMERA))
    for frame in ("map", "world"):
        words = rf"camera\.tum: its axes are z ahead, -y up, those of the {frame} frame x ahead, z up"
        with pytest.raises(SourceError, match=words):
            score(run, trajectory=tmp_path / "camera.tum", frame=frame)


@pytest.mark.parametrize(("step", "covered"), [(5, True), (19, True), (21, False)])
def test_keyframes_up_to_two_seconds_apart_are_interpolated(
    step: int, covered: bool, run: RunFolder, whole: Trajectory, tmp_path: Path
) -> None:
    """Scans come every 0.1 s."""
    np.savetxt(tmp_path / "keyframes.tum", rows(whole)[::step])
    found = score(run, trajectory=tmp_path / "keyframes.tum")
    assert (found.trajectory["scan_coverage"] > 0.9) == covered
    if covered:
        assert found.trajectory["ate_rmse"] == pytest.approx(run.entry["trajectory"]["ate_rmse"], abs=0.05)


def test_a_mirrored_trajectory_is_not_turned_over(run: RunFolder, whole: Trajectory, tmp_path: Path) -> None:
    table = rows(whole)
    table[:, 2] *= -1
    table[:, 6] *= -1
    np.savetxt(tmp_path / "mirrored.tum", table)
    with warnings.catch_warnings(action="error"):
        found = score(run, trajectory=tmp_path / "mirrored.tum", frame="map")
        auto = score(run, trajectory=tmp_path / "mirrored.tum")
    assert auto.trajectory["ate_rmse"] == pytest.approx(found.trajectory["ate_rmse"])
    assert found.trajectory["ate_rmse"] > 0.2


def test_laps_that_fit_at_several_offsets_are_refused() -> None:
    stamps = np.arange(0.0, 120.0, 0.1)
    phase = 2 * np.pi * stamps / 20 + 0.3 * np.sin(2 * np.pi * stamps / 20)
    laps = Trajectory.from_poses(
        stamps.tolist(), [Pose2(3 * math.cos(p), 2 * math.sin(p), p + math.pi / 2) for p in phase.tolist()]
    )
    part = Trajectory(laps.stamps[400:800] + 7.3, laps.positions[400:800], laps.quaternions[400:800])
    with pytest.raises(SourceError, match="fits the run's at several time offsets"):
        find_time_offset(laps, part)
    whole = replace(laps, stamps=laps.stamps + 7.3)
    assert find_time_offset(laps, whole) == pytest.approx(-7.3, abs=0.02)
    with pytest.raises(SourceError, match=r"its stamps span 1\.199e\+12 s"):
        find_time_offset(laps, replace(laps, stamps=laps.stamps * 1e10))
