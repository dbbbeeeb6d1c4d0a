"""From a log to a map, a path and a record, held against a room that is known."""

import gzip
import json
import re
from dataclasses import replace
from itertools import count
from pathlib import Path

import cv2
import numpy as np
import pytest

from lirs_validation import drawing, map_log
from lirs_validation.config import MapConfig
from lirs_validation.logs.map_log import run_mapping
from lirs_validation.metrics.mapped_log import reference_errors
from lirs_validation.metrics.trajectory import rms
from lirs_validation.record.map_record import map_lines
from lirs_validation.record.metric_catalog import WORSE
from lirs_wct.errors import ConfigError, MapperError, SourceError
from lirs_wct.formats.drive_files import read_tum, write_tum
from lirs_wct.formats.map_server import read_map
from lirs_wct.geometry.pose import Pose2, Trajectory
from tests.lirs_wct.formats.carmen_room import PERIOD, START, flaser, room_lines, write_log
from tests.slam_baselines.synthetic import ROOM, ranges_to

SCANS = 90
STAMPS = [START + PERIOD * k for k in range(SCANS)]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a log, the true path (shifted and turned, for that must not matter) and relations."""
    folder = tmp_path_factory.mktemp("room")
    lines, truth = room_lines(SCANS)
    write_log(folder / "room.clf", lines)
    write_log(folder / "short.clf", lines[:20])
    write_log(folder / "blind.clf", room_lines(SCANS, drifting=False)[0])
    write_tum(folder / "truth.tum", Trajectory.from_poses(STAMPS, [Pose2(3.0, -2.0, 0.7) @ p for p in truth]))
    pairs = [(a, a + 30) for a in range(0, SCANS - 30, 5)]
    rows = [(STAMPS[a], STAMPS[b], truth[a].inverse() @ truth[b]) for a, b in pairs]
    rows.append((START + 500, START + 510, Pose2()))
    text = [f"{a:.6f} {b:.6f} {p.x:.6f} {p.y:.6f} 0 0 0 {p.yaw:.6f}" for a, b, p in rows]
    (folder / "room.relations").write_text("\n".join(text) + "\n")
    return folder


EVERY_MAPPER = pytest.mark.parametrize(
    "mapper", ["hector", *(pytest.param(m, marks=pytest.mark.slow) for m in ("gmapping", "cartographer"))]
)


@EVERY_MAPPER
def test_a_room_is_mapped_as_it_is(room: Path, tmp_path: Path, mapper: str) -> None:
    mapped = map_log(
        room / "room.clf",
        mapper=mapper,
        reference=room / "truth.tum",
        relations=room / "room.relations",
        out=tmp_path,
    )
    folder = mapped.folder
    assert folder.name.startswith(f"room-{mapper}-s1-")
    assert [p.name for p in tmp_path.iterdir()] == [folder.name]
    assert sorted(p.name for p in folder.iterdir()) == [
        "estimate.tum", "manifest-sha256.txt", "map.pgm", "map.yaml", "overview.png", "record.json",
    ]  # fmt: skip
    np.testing.assert_allclose(read_tum(folder / "estimate.tum").stamps, STAMPS, atol=1e-6)
    assert cv2.imread(str(folder / "overview.png")).std() > 10
    record = json.loads((folder / "record.json").read_text())
    reference, relations = record["accuracy"]["reference"], record["accuracy"]["relations"]
    assert reference["ate_rmse"] < 0.05
    assert (reference["used"], reference["outside"]) == (SCANS, 0)
    assert relations["translation_mean"] < 0.06
    assert relations["rotation_mean_deg"] < 1.0
    assert (relations["used"], relations["outside"]) == (12, 1)
    assert record["mapper"]["received"] == record["log"]["scans"] == SCANS
    # The map's walls stand where the room's do: seen from the start, in all directions.
    grid = read_map(folder / "map.yaml")
    start = Pose2(0.0, -0.5, 0.0)
    hits = start.apply(grid.occupied_points())
    assert len(hits) > 300
    assert np.quantile([distance_to_walls(p) for p in hits], 0.95) < 0.12
    angles = np.linspace(-1.5, 1.5, 31)
    walls = ranges_to(ROOM, start, angles)[:, None] * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    nearest = np.linalg.norm(start.apply(walls)[:, None] - hits[None], axis=2).min(axis=1)
    assert np.quantile(nearest, 0.9) < 0.15


def distance_to_walls(point: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    a, e = ROOM[:, :2], ROOM[:, 2:] - ROOM[:, :2]
    along = np.clip(((point - a) * e).sum(axis=1) / (e * e).sum(axis=1), 0, 1)
    return float(np.linalg.norm(a + along[:, None] * e - point, axis=1).min())


def test_the_same_seed_gives_the_same_bytes(room: Path, tmp_path: Path) -> None:
    config = MapConfig(
        log=str(room / "short.clf"), mapper="gmapping", parameters="particles=5", seed=3, second="none"
    )
    folders = [run_mapping(config, out=tmp_path / str(k)).folder for k in range(2)]
    for name in ("map.pgm", "map.yaml", "estimate.tum"):
        first, second = ((folder / name).read_bytes() for folder in folders if folder is not None)
        assert first == second


def test_the_digest_tells_maps_apart_and_not_their_judges() -> None:
    config = MapConfig(log="a.clf")
    assert config.digest(b"x") == replace(config, log="b.clf", relations="r", reference="t").digest(b"x")
    others = [replace(config, seed=2), replace(config, fov=270.0), replace(config, mapper="hector")]
    digests = {c.digest(b"x") for c in (config, *others)} | {config.digest(b"y")}
    assert len(digests) == 5


def test_without_odometry_hector_maps_and_the_others_say_what_they_need(room: Path) -> None:
    mapped = map_log(room / "blind.clf", mapper="hector", reference=room / "truth.tum")
    assert mapped.record.log["odometry_length"] is None
    assert mapped.record.accuracy["reference"]["ate_rmse"] < 0.05
    for other in ("gmapping", "cartographer"):
        with pytest.raises(
            SourceError, match=rf"blind\.clf: holds no odometry.*{other} needs it; hector maps"
        ):
            map_log(room / "blind.clf", mapper=other)


@pytest.mark.parametrize(("broken", "status"), [(1, "ok"), (3, "incomplete")])
def test_scans_left_out_of_the_log_have_no_pose(tmp_path: Path, broken: int, status: str) -> None:
    lines = room_lines(30)[0]
    lines[10 : 10 + broken] = [" ".join(line.split()[:9]) for line in lines[10 : 10 + broken]]
    record = map_log(write_log(tmp_path / "x.clf", lines), mapper="hector").record
    assert (record.status, record.log["left_out"]) == (status, broken)
    assert record.trajectory["scan_coverage"] == pytest.approx(1 - broken / 30)


def test_a_log_in_which_nothing_was_seen_is_no_map(tmp_path: Path) -> None:
    lines = [flaser(np.full(181, 81.83), Pose2(0.1 * k), START + k) for k in range(20)]
    with pytest.raises(SourceError, match=r"x\.clf: none of its 20 scans met anything within range"):
        map_log(write_log(tmp_path / "x.clf", lines))


def test_nothing_to_compare_with_is_told_and_null(room: Path, tmp_path: Path) -> None:
    (tmp_path / "other.relations").write_text("1 2 0 0 0 0 0 0\n")
    (tmp_path / "other.tum").write_text("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n")
    mapped = map_log(
        room / "short.clf", mapper="hector", relations=tmp_path / "other.relations",
        reference=tmp_path / "other.tum",
    )  # fmt: skip
    told = mapped.record.accuracy
    assert (told["relations"]["used"], told["relations"]["outside"]) == (0, 1)
    assert (told["reference"]["used"], told["reference"]["outside"]) == (0, 2)
    assert told["relations"]["translation_mean"] is told["reference"]["ate_rmse"] is None


def test_a_log_of_rare_scans_has_no_watch(room: Path, tmp_path: Path) -> None:
    """A path that was 4 m off had "0 alarms", as no jump is seen in steps of 2 s."""
    write_log(tmp_path / "rare.clf", (room / "room.clf").read_text().splitlines()[::5])
    rare, usual = (map_log(log, mapper="hector") for log in (tmp_path / "rare.clf", room / "room.clf"))
    assert (rare.record.trajectory["alarms"], usual.record.trajectory["alarms"]) == (None, [])
    assert dict(map_lines(rare.record))["alarms of the watch"] == "too few scans a second"


@pytest.mark.slow
def test_quality_without_truth_is_recorded_and_stated(room: Path, tmp_path: Path) -> None:
    mapped = map_log(room / "room.clf", mapper="hector", out=tmp_path)
    second = mapped.record.quality["second"]
    other = map_log(room / "room.clf", mapper="cartographer", second="none")
    with_truth = map_log(room / "room.clf", mapper="hector", reference=room / "truth.tum")
    difference = rms(reference_errors(mapped.trajectory, other.trajectory).position)
    assert second["mapper"] == "cartographer"
    assert second["difference"] == pytest.approx(difference)
    assert second["revisit_residual"] == other.record.quality["revisit_residual"]
    stored = json.loads((mapped.folder / "record.json").read_text())
    assert stored["quality"] == mapped.record.quality
    assert stored["verdict"]["conclusion"] == "cannot be checked"
    assert second["command"] == f"lirs-wct map {room / 'room.clf'} --mapper cartographer"
    assert f"the two paths differ by {difference:.2f} m" in mapped.record.verdict.sentence
    overview = drawing.map_overview(mapped.record, mapped.grid, mapped.trajectory, None, mapped.accuracy)
    assert mapped.record.verdict.sentence in overview.get_suptitle().replace("\n", " ")
    unchecked = "map of room.clf cannot be checked: it passes no place twice"
    assert unchecked in mapped.record.verdict.sentence
    assert with_truth.record.verdict.conclusion is None
    assert with_truth.record.quality["second"] is other.record.quality["second"] is None


def test_an_interrupted_mapping_leaves_nothing(room: Path, tmp_path: Path) -> None:
    def stop(stage: str, share: float) -> None:
        if stage == "draw" or share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        map_log(room / "room.clf", mapper="hector", out=tmp_path / "out", progress=stop)
    assert not (tmp_path / "out").exists()


BAD = {
    "mapper": ({"mapper": "slam"}, ConfigError, "unknown mapper 'slam'"),
    "particles of hector": (
        {"mapper": "hector", "parameters": "particles=5"},
        ConfigError,
        "unknown parameter of hector 'particles'",
    ),
    "no particles": (
        {"mapper": "gmapping", "parameters": "particles=0"},
        ConfigError,
        "particles of gmapping must be above 0",
    ),
    "seed": ({"seed": -1}, ConfigError, "seed must be at least 0, got -1"),
    "cells": ({"resolution": 1e-5}, ConfigError, "resolution must be within [0.01, 1] m, got 1e-05"),
    "no field of view": ({"fov": 0.0}, ConfigError, "fov must be within (0, 360] deg, got 0.0"),
    "second mapper": ({"second": "hectr"}, ConfigError, "unknown --second 'hectr'"),
    "no range": ({"range_max": float("nan")}, ConfigError, "range max must be a finite number above 0"),
    "no relations": ({"relations": "none.relations"}, SourceError, "none.relations: "),
    "no reference": ({"reference": "none.tum"}, SourceError, "none.tum: "),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_options_are_told_before_the_log_is_read(case: str) -> None:
    options, kind, expected = BAD[case]
    with pytest.raises(kind, match=re.escape(expected)):
        map_log("not there.clf", **options)


@pytest.mark.slow
@pytest.mark.shared
def test_a_real_log_against_its_reference(shared_data: Path) -> None:
    """ATE on the CSAIL log, from the graph poses as they are published: far better than by odometry."""
    folder = shared_data / "logs" / "csail"
    mapped = map_log(
        folder / "mit-csail.clf.gz", mapper="hector", reference=folder / "reference_poses.log.gz"
    )
    assert mapped.record.accuracy["reference"]["used"] > 1000
    assert mapped.record.accuracy["reference"]["ate_rmse"] < 0.5
    assert mapped.record.name.startswith("mit-csail-hector-s1-")


THINNED = [
    pytest.param("csail/mit-csail", 3, 0, marks=pytest.mark.slow),
    pytest.param("csail/mit-csail", 3, 1, marks=pytest.mark.slow),
    ("orebro/orebro", 1, 0),
    ("orebro/orebro", 2, 0),
]


@pytest.mark.shared
@pytest.mark.parametrize(("name", "every", "offset"), THINNED)
def test_a_thinned_log_that_is_mapped_wrong_is_not_ok(
    shared_data: Path, tmp_path: Path, name: str, every: int, offset: int
) -> None:
    """On some of these hector ends meters off, and once said nothing of it."""
    source = shared_data / "logs" / f"{name}.clf.gz"
    found = next(source.parent.glob("reference_poses.*"))
    lines = gzip.decompress(source.read_bytes()).decode().splitlines(keepends=True)
    scans = count()
    kept = [line for line in lines if not line.startswith("FLASER") or next(scans) % every == offset]
    (tmp_path / "thinned.clf").write_text("".join(kept))
    mapped = map_log(tmp_path / "thinned.clf", mapper="hector", reference=found)
    assert (mapped.record.status == "ok") == (mapped.record.accuracy["reference"]["ate_rmse"] < 1.0)


OWN = """
from lirs_wct.geometry import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.pose import Trajectory
from slam_baselines.mapper import MapperStats
import numpy as np

class Still:
    lost = False
    def __init__(self): self.stamps = []
    def update(self, scan, odometry, imu):
        self.stamps.append(scan.stamp)
        return ANSWER
    def map(self): return OccupancyGrid.from_probability(np.full((4, 5), 0.9), 0.1)
    def trajectory(self): return Trajectory.from_poses(self.stamps, [Pose2()] * len(self.stamps))
    stats = MapperStats(received=7)
"""


def test_a_mapper_of_your_own(room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wct_own_log_mapper.py").write_text(OWN.replace("ANSWER", "Pose2()"))
    (tmp_path / "wct_bad_log_mapper.py").write_text(OWN.replace("ANSWER", "None"))
    mapped = map_log(room / "short.clf", mapper="wct_own_log_mapper:Still", second="none")
    assert (mapped.record.mapper["received"], len(mapped.trajectory)) == (7, 20)
    assert mapped.record.name.startswith("short-Still-s1-")
    with pytest.raises(MapperError, match=r"must return a Pose2, got NoneType"):
        map_log(room / "short.clf", mapper="wct_bad_log_mapper:Still", second="none")
    with pytest.raises(
        ConfigError, match=r"resolution can be given for hector, .*, slam_toolbox_original only"
    ):
        map_log(room / "room.clf", mapper="wct_own_log_mapper:Still", resolution=0.1)


def test_the_accuracy_of_the_odometry_stands_beside_that_of_the_mapper(room: Path) -> None:
    truth = {"reference": room / "truth.tum", "relations": room / "room.relations"}
    record = map_log(room / "room.clf", mapper="hector", **truth).record
    alone = record.odometry
    assert alone["reference"]["used"] == record.accuracy["reference"]["used"] == SCANS
    assert alone["reference"]["ate_rmse"] > 2 * record.accuracy["reference"]["ate_rmse"]
    assert alone["relations"]["translation_mean"] > record.accuracy["relations"]["translation_mean"]
    lines = dict(map_lines(record))
    assert lines["ATE of the odometry"] == f"{alone['reference']['ate_rmse']:.3f} m"
    assert WORSE not in lines.values()
    worse = replace(record, odometry={"relations": None, "reference": {"used": 9, "ate_rmse": 0.001}})
    assert WORSE in dict(map_lines(worse)).values()
    assert map_log(room / "blind.clf", mapper="hector", **truth).record.odometry == {}
