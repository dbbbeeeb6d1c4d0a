"""A trajectory that leaves out scans is no result, however well its few poses fit: in runs and logs."""

import gzip
import json
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_validation import map_log, validate
from lirs_validation.analysis.results import read_run
from lirs_validation.experiment.mapper_under_test import LocalMapper
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.record.run_record import damaged_files
from lirs_validation.report.pictures import run_figure
from lirs_wct.geometry import Pose2, Trajectory
from slam_baselines.hector import HectorMapper
from tests.command_line import run_command

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The first 40 scans of the office's log."""
    lines = gzip.decompress((ROOT / "examples" / "data" / "office.clf.gz").read_bytes()).splitlines()
    scans = [k for k, line in enumerate(lines) if b"LASER" in line]
    path = tmp_path_factory.mktemp("log") / "log.clf"
    path.write_bytes(b"\n".join(lines[: scans[39] + 1]) + b"\n")
    return str(path)


class FewPoses(HectorMapper):
    """Maps as Hector does, and gives only some of its poses."""

    kept: slice | tuple[int, ...] = (0, -1)

    def trajectory(self) -> Trajectory:
        """Return what is kept of the trajectory."""
        whole, kept = super().trajectory(), self.kept
        kept = kept if isinstance(kept, slice) else np.array(kept, dtype=np.int64)  # type: ignore[assignment]
        return Trajectory(whole.stamps[kept], whole.positions[kept], whole.quaternions[kept])


def few(kept: slice | tuple[int, ...]) -> FewPoses:
    mapper = FewPoses()
    mapper.kept = kept
    return mapper


@pytest.mark.parametrize(
    ("kept", "coverage", "ate"),
    [((0, -1), 2 / 26, True), ((0,), 1 / 26, False), ((), 0.0, False), (slice(None, None, 2), 13 / 26, True)],
)
def test_a_run_whose_trajectory_leaves_out_scans_is_incomplete(
    kept: slice | tuple[int, ...],
    coverage: float,
    ate: bool,
    room: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    plain_pictures: None,
) -> None:
    """Two poses earned an ATE of 0.000 and `ok`."""
    monkeypatch.setattr("lirs_validation.experiment.mapper_under_test.mapper_named", lambda *_: few(kept))
    run = validate(room, seconds=1, out=tmp_path)
    assert run.folder is not None
    record = read_run(run.folder).entry
    assert record["status"] == "incomplete"
    assert f"a pose for {100 * coverage:.1f} % of the scans, at least 95 % are required" in record["reason"]
    assert record["trajectory"]["scan_coverage"] == pytest.approx(coverage)
    assert ("ate_rmse" in record["trajectory"]) == ate
    assert damaged_files(run.folder, "record.json") == []
    picture = run_figure(read_run(run.folder), ScenarioCache())
    assert picture.picture or "estimate.tum" in picture.note


def test_a_log_whose_trajectory_leaves_out_scans_is_incomplete(
    log: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    plain_pictures: None,
) -> None:
    monkeypatch.setattr(
        "lirs_validation.logs.map_log.log_mapper", lambda config: nullcontext(LocalMapper(FewPoses(), "few"))
    )
    assert run_command("map", log, "--mapper", "hector", "-o", str(tmp_path)) == 3
    assert "incomplete" in capsys.readouterr().out
    record = json.loads(next(tmp_path.glob("*/record.json")).read_text())
    assert record["status"] == "incomplete"
    assert record["trajectory"]["poses"] == 2
    assert record["trajectory"]["scan_coverage"] == pytest.approx(2 / 40, rel=0.05)


def test_a_log_during_which_the_place_was_lost_is_lost(log: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last scan alone was looked at: 756 of 2,008 lost scans were told as ok."""

    class LostInBetween(HectorMapper):
        def process(self, *reading: Any) -> Pose2:
            pose = super().process(*reading)
            self.lost = 5 <= self.received < 35
            return pose

    monkeypatch.setattr(
        "lirs_validation.logs.map_log.log_mapper",
        lambda config: nullcontext(LocalMapper(LostInBetween(), "lost")),
    )
    record = map_log(log, mapper="hector").record
    assert record.status == "lost"
    assert "30 of 39 scans" in record.reason
