"""A record knows the very files of its source: another of that name is not taken for it."""

import hashlib
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from lirs_validation import validate
from lirs_validation.analysis.results import RunFolder, read_results, read_run, recorded_world_config
from lirs_validation.analysis.score import score
from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.record.run_record import same_source, source_files
from lirs_validation.report.pictures import run_figure
from lirs_validation.sweep.tasks import RunTask
from lirs_wct.errors import SourceError
from lirs_wct.formats.map_server import write_map
from lirs_wct.geometry import OccupancyGrid
from lirs_wct.sources.build import build_world

pytestmark = pytest.mark.usefixtures("plain_pictures")


def hills(seed: int) -> np.ndarray:
    rough = np.random.default_rng(seed).normal(size=(65, 65))
    smooth = cv2.GaussianBlur(rough, (0, 0), 6)
    return np.uint8(255 * (smooth - smooth.min()) / np.ptp(smooth))


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RunFolder:
    """A run of `hills.png`, typed so in a folder that is left afterwards for one with another `hills.png`."""
    for seed, name in enumerate(("here", "there")):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / "hills.png"), hills(seed))
    monkeypatch.chdir(tmp_path / "here")
    made = validate("hills.png", seconds=4, out=tmp_path / "out")
    assert made.folder is not None
    monkeypatch.chdir(tmp_path / "there")
    return read_run(made.folder)


def test_score_and_report_take_the_source_of_the_run(run: RunFolder, tmp_path: Path) -> None:
    picture = tmp_path / "here" / "hills.png"
    content = hashlib.sha256(picture.read_bytes()).hexdigest()
    assert run.entry["world"]["files"] == [{"path": str(picture), "sha256": content}]
    assert recorded_world_config(run.entry).source == str(picture)
    assert score(run, map_yaml=run.folder / "map.yaml", frame="world").map["f1"] == run.entry["map"]["f1"]
    assert run_figure(run, ScenarioCache()).note == ""


def test_another_source_of_that_name_is_refused(run: RunFolder, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "here" / "hills.png"), hills(7))
    with pytest.raises(SourceError, match=r"here/hills\.png: is not what the run was made from: sha256 "):
        score(run, map_yaml=run.folder / "map.yaml", frame="world")
    assert "without its terrain: " in run_figure(run, ScenarioCache()).note
    (tmp_path / "here" / "hills.png").unlink()
    with pytest.raises(SourceError, match=r"here/hills\.png: no such file"):
        score(run, map_yaml=run.folder / "map.yaml", frame="world")


def test_a_sweep_runs_again_what_another_source_of_that_name_gave(run: RunFolder, tmp_path: Path) -> None:
    experiment = RunTask(RunConfig(source="hills.png", seconds=4.0))
    assert experiment.name == run.folder.name
    os.utime(run.folder / "record.json", (2e9, 2e9))  # the other picture is older than the record
    assert experiment.find_outcome(tmp_path / "out") is None
    os.chdir(tmp_path / "here")
    assert experiment.find_outcome(tmp_path / "out") is not None


def test_every_kind_of_source_has_its_files(tmp_path: Path) -> None:
    assert source_files(RunConfig(source="simple")) == ()
    write_map(tmp_path / "room", OccupancyGrid.from_probability(np.full((40, 40), 0.1), 0.1))
    of_map = source_files(RunConfig(source=str(tmp_path / "room.yaml")))
    assert [Path(file["path"]).name for file in of_map] == ["room.yaml", "room.pgm"]
    build_world("simple").save(tmp_path / "built")
    built = RunConfig(source=str(tmp_path / "built"))
    recorded = source_files(built)
    assert [Path(file["path"]).name for file in recorded] == ["world.json", "world.npz"]
    assert same_source(built, recorded)
    assert same_source(RunConfig(source="gone"), ())
    assert not same_source(RunConfig(source=str(tmp_path / "gone")), recorded)
    moved = {"world": {"files": recorded}, "config": {"source": "typed", "build": {}}, "name": "a"}
    assert recorded_world_config(moved).source == str(tmp_path / "built")


def test_a_folder_of_results_says_so_in_the_report(run: RunFolder) -> None:
    assert read_results(run.folder.parent).skipped == ()
