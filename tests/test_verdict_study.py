"""The study of `verdict`: its stored tables and models, and a small version of it."""

import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from tests.benchmark_modules import load_benchmark

MEASURED = Path(__file__).resolve().parents[1] / "docs" / "measured.md"
study = load_benchmark("verdict_study")


def test_the_stored_models_are_fitted_to_the_stored_drives() -> None:
    stored = json.loads(files("lirs_extensions.decide").joinpath("forecast.json").read_text())
    fitted = study.fit_models(study.Tables())
    assert fitted["features"] == stored["features"]
    assert set(fitted["methods"]) == set(stored["methods"]) == set(study.METHODS)
    for method, model in stored["methods"].items():
        for name, values in model.items():
            np.testing.assert_allclose(fitted["methods"][method][name], values, rtol=0.01, atol=0.01)


def test_the_published_scores_are_those_of_the_stored_drives() -> None:
    published = MEASURED.read_text(encoding="utf-8")
    rows, points = study.score_rows(study.Tables(), np.random.default_rng(1))
    assert [row[0] for row in rows] == list(study.METHODS)
    for row in rows:
        assert f"| {' | '.join(row)} |" in published, row
    assert all(0 <= forecast <= 1 for forecast, _ in points)


def test_the_study_has_enough_worlds_and_families() -> None:
    for method in study.METHODS:
        data = study.data_of(method, study.Tables())
        assert len(data.drives) >= 30
        assert len(np.unique(data.families)) >= 6


@pytest.mark.slow
def test_a_study_of_six_worlds(tmp_path: Path) -> None:
    tables = ("--tables", str(tmp_path), "--quick")
    study.main(["drive", *tables, "--drives", "1", "--methods", "hector"])
    study.main(["features", *tables])
    found = study.Tables(tmp_path)
    classes = found.drives()
    assert len(classes) >= 4
    assert set("".join(classes.values())) <= set(study.LETTERS.values())
    before = (tmp_path / "verdict_drives.csv").read_bytes()
    study.main(["drive", *tables, "--drives", "1", "--methods", "hector"])
    assert (tmp_path / "verdict_drives.csv").read_bytes() == before, "finished drives are not repeated"
    data = study.data_of("hector", found)
    for predicted in study.left_out_predictions(data).values():
        assert ((predicted >= 0) & (predicted <= 1)).all()
