"""A sweep keeps what is finished, writes down what failed, and tells of every experiment once."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from lirs_validation.sweep.engines import Processes
from lirs_validation.sweep.sweep import Serial, Sweep
from lirs_wct.errors import OutputError, WctError
from tests.lirs_validation.sweep.fake_experiments import FakeExperiment, Manner


@pytest.fixture
def notes(tmp_path: Path) -> str:
    (tmp_path / "notes").mkdir()
    return str(tmp_path / "notes")


def experiments(notes: str, *manners: Manner, seconds: float = 0.0) -> list[FakeExperiment]:
    return [FakeExperiment(f"{k}-{m.replace(' ', '_')}", notes, m, seconds) for k, m in enumerate(manners)]


def hidden(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


def test_a_failed_cell_is_written_down_and_the_rest_go_on(tmp_path: Path, notes: str) -> None:
    sweep = Sweep(experiments(notes, "good", "raises", "good"), tmp_path / "out")
    outcomes = list(sweep.run(Serial()))
    assert [outcome.status for outcome in outcomes] == ["ok", "error", "ok"]
    assert sweep.failed
    assert outcomes[1].reason == "IndexError: list index out of range"
    assert "fake_experiments.py" in (tmp_path / "out" / "1-raises" / "failed").read_text()
    assert hidden(tmp_path / "out") == []


def test_nothing_is_run_whose_results_cannot_be_written(tmp_path: Path, notes: str) -> None:
    (tmp_path / "file").write_text("")
    asked = experiments(notes, "good", "good")
    with pytest.raises(OutputError, match="is a file"):
        list(Sweep(asked, tmp_path / "file" / "out").run(Serial()))
    assert [experiment.runs for experiment in asked] == [[], []]


def test_the_same_sweep_again_runs_nothing_twice(tmp_path: Path, notes: str) -> None:
    asked = experiments(notes, "good", "interrupts", "good", "raises")
    sweep = Sweep(asked, tmp_path / "out")
    with pytest.raises(KeyboardInterrupt):
        list(sweep.run(Serial()))
    assert list(sweep.outcomes) == ["0-good"]
    assert hidden(tmp_path / "out") == []

    mended = [
        replace(experiment, manner="good") if experiment.manner == "interrupts" else experiment
        for experiment in asked
    ]
    again = Sweep(mended, tmp_path / "out")
    assert again.kept == 1
    assert len(list(again.run(Serial()))) == 3
    assert [len(experiment.runs) for experiment in mended] == [1, 2, 1, 1]
    third = Sweep(mended, tmp_path / "out")
    assert third.kept == 4
    assert third.failed
    assert list(third.run(Serial())) == []


def test_failed_cells_are_run_again_when_asked(tmp_path: Path, notes: str) -> None:
    asked = experiments(notes, "good", "raises")
    list(Sweep(asked, tmp_path / "out").run(Serial()))
    mended = [replace(experiment, manner="good") for experiment in asked]
    sweep = Sweep(mended, tmp_path / "out", retry_failed=True)
    assert [experiment.name for experiment in sweep.pending] == ["1-raises"]
    list(sweep.run(Serial()))
    assert not sweep.failed
    assert sorted(p.name for p in (tmp_path / "out" / "1-raises").iterdir()) == [
        "manifest-sha256.txt",
        "result",
    ]


def test_no_room_costs_the_experiment_a_second_run_and_others_nothing(tmp_path: Path, notes: str) -> None:
    asked = experiments(notes, "good", "no room once", "good")
    sweep = Sweep(asked, tmp_path / "out")
    order = [outcome.task for outcome in sweep.run(Serial())]
    assert order == ["0-good", "2-good", "1-no_room_once"]
    assert not sweep.failed
    assert [len(experiment.runs) for experiment in asked] == [1, 2, 1]
    assert hidden(tmp_path / "out") == []


def test_without_room_at_all_the_experiment_is_left_for_the_next_time(tmp_path: Path, notes: str) -> None:
    asked = experiments(notes, "good", "no room")
    sweep = Sweep(asked, tmp_path / "out")
    list(sweep.run(Serial()))
    assert sweep.failed
    assert "No space left" in sweep.unwritten["1-no_room"]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["0-good", "sweep.json"]
    assert (tmp_path / "out" / "0-good" / "result").read_text() == "0-good False"
    again = Sweep([replace(experiment, manner="good") for experiment in asked], tmp_path / "out")
    list(again.run(Serial()))
    assert (again.kept, again.failed) == (1, False)


def test_the_only_experiment_says_at_once_that_it_cannot_be_written(tmp_path: Path, notes: str) -> None:
    sweep = Sweep(experiments(notes, "no room"), tmp_path / "out")
    with pytest.raises(WctError, match=r"0-no_room: cannot be written: No space left"):
        list(sweep.run(Serial()))
    assert list((tmp_path / "out").iterdir()) == []


def test_the_sweeps_file_names_every_experiment_and_the_command(tmp_path: Path, notes: str) -> None:
    listing: dict[str, Any] = {"command": "lirs-wct validate --suite paper", "suite": "paper"}
    list(Sweep(experiments(notes, "good", "raises"), tmp_path / "out", **listing).run(Serial()))
    entry = json.loads((tmp_path / "out" / "sweep.json").read_text())
    assert entry["suite"] == "paper"
    assert entry["command"] == "lirs-wct validate --suite paper"
    assert [experiment["name"] for experiment in entry["cells"]] == ["0-good", "1-raises"]
    assert {"lirs-wct", "code", "python"} <= set(entry["versions"])


@pytest.mark.slow
def test_processes_lose_no_experiment_whatever_happens_to_them(tmp_path: Path, notes: str) -> None:
    asked = experiments(notes, "good", "dies once", "raises", "good", "hangs", "dies", "good", "good")
    reported: list[tuple[str, str, float]] = []
    engine = Processes(jobs=2, seconds=15.0)
    sweep = Sweep(asked, tmp_path / "out")
    outcomes = list(sweep.run(engine, lambda name: lambda *message: reported.append((name, *message))))
    assert sorted(outcome.task for outcome in outcomes) == [experiment.name for experiment in asked]
    statuses = [sweep.outcomes[experiment.name].status for experiment in asked]
    assert statuses == ["ok", "ok", "error", "ok", "timeout", "error", "ok", "ok"]
    assert [len(experiment.runs) for experiment in asked] == [1, 2, 1, 1, 1, 2, 1, 1]
    assert "died 2 times (signal SIGKILL)" in sweep.outcomes["5-dies"].reason
    hung = (tmp_path / "out" / "4-hangs" / "failed").read_text()
    assert "no end within the experiment's 15 s" in hung
    assert "fake_experiments.py" in hung
    assert (tmp_path / "out" / "0-good" / "result").read_text() == "0-good True"
    assert ("0-good", "drive", 0.5) in reported
    assert hidden(tmp_path / "out") == []


@pytest.mark.slow
def test_two_sweeps_at_once_in_one_folder_leave_whole_results(tmp_path: Path, notes: str) -> None:
    """Each may do an experiment that the other is doing; no folder is broken by that."""
    asked = experiments(notes, *(["good"] * 6), seconds=0.05)
    sweeps = [Sweep(asked, tmp_path / "out") for _ in range(2)]
    engine = Processes(jobs=1, concurrent=True)
    both = [sweep.run(engine) for sweep in sweeps]
    done = [outcome for pair in zip(*both, strict=True) for outcome in pair]
    assert [outcome.status for outcome in done] == ["ok"] * 12
    for experiment in asked:
        folder = tmp_path / "out" / experiment.name
        assert sorted(path.name for path in folder.iterdir()) == ["manifest-sha256.txt", "result"]
        assert (folder / "result").read_text() == f"{experiment.name} True"
    assert hidden(tmp_path / "out") == []
    assert Sweep(asked, tmp_path / "out").kept == 6
