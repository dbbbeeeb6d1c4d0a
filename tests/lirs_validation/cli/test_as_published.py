"""Methods as published by their names in `validate`, `map` and `score`, one after the other."""

import json
from pathlib import Path

import pytest

from slam_baselines.mapper import MAPPERS
from tests.command_line import run_command

OFFICE = Path(__file__).parents[3] / "examples/data/office.yaml"
"""Walls on level ground: here the methods hold, and rounding does not lead them elsewhere."""


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in MAPPERS if name.endswith("_original")])
def test_a_run_mapped_again_from_its_scans_scores_as_the_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A log's ranges are in millimeters: all is the same where the method rounds to them itself."""
    monkeypatch.chdir(tmp_path)
    assert run_command("validate", str(OFFICE), "--mapper", name, "--seconds", "12", "-o", "runs") == 0
    (run,) = (tmp_path / "runs").glob("*/record.json")
    assert run_command("map", str(run.parent / "scans.clf.gz"), "--mapper", name, "-o", "maps") == 0
    (mapped,) = (tmp_path / "maps").glob("*/estimate.tum")
    files = ("--trajectory", str(mapped), "--map", str(mapped.with_name("map.yaml")))
    assert run_command("score", str(run.parent), *files, "-o", "score.json") == 0
    recorded, scored = (json.loads(path.read_text()) for path in (run, tmp_path / "score.json"))
    assert recorded["config"]["mapper"] == name
    ate, again = (entry["trajectory"]["ate_rmse"] for entry in (recorded, scored))
    rounds = name == "gmapping_original"
    assert again == pytest.approx(ate, abs=1e-6 if rounds else 1e-3)
    assert scored["map"]["f1"] == pytest.approx(recorded["map"]["f1"], abs=1e-6 if rounds else 0.03)
