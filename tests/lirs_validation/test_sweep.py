"""A sweep keeps what is finished, writes down what failed, and tells of every cell once."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from lirs_validation.sweep.engines.base import Limits
from lirs_validation.sweep.engines.processes import Processes
from lirs_validation.sweep.engines.serial import Serial
from lirs_validation.sweep.manifest import Manifest
from lirs_validation.sweep.sweep import Sweep
from lirs_wct.errors import WctError
from tests.lirs_validation.fake_cells import FakeCell, Manner


@pytest.fixture
def notes(tmp_path: Path) -> str:
    (tmp_path / "notes").mkdir()
    return str(tmp_path / "notes")


def cells(notes: str, *manners: Manner, seconds: float = 0.0) -> list[FakeCell]:
    return [FakeCell(f"{k}-{m.replace(' ', '_')}", notes, m, seconds) for k, m in enumerate(manners)]


def hidden(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


def test_a_failed_cell_is_written_down_and_the_rest_go_on(tmp_path: Path, notes: str) -> None:
    sweep = Sweep(cells(notes, "good", "raises", "good"), tmp_path / "out")
    outcomes = list(sweep.run(Serial()))
    assert [outcome.status for outcome in outcomes] == ["ok", "error", "ok"]
    assert sweep.failed
    assert outcomes[1].reason == "IndexError: list index out of range"
    assert "fake_cells.py" in (tmp_path / "out" / "1-raises" / "failed").read_text()
    assert hidden(tmp_path / "out") == []


def test_the_same_sweep_again_runs_nothing_twice(tmp_path: Path, notes: str) -> None:
    asked = cells(notes, "good", "interrupts", "good", "raises")
    sweep = Sweep(asked, tmp_path / "out")
    with pytest.raises(KeyboardInterrupt):
        list(sweep.run(Serial()))
    assert list(sweep.outcomes) == ["0-good"]
    assert hidden(tmp_path / "out") == []

    mended = [replace(cell, manner="good") if cell.manner == "interrupts" else cell for cell in asked]
    again = Sweep(mended, tmp_path / "out")
    assert again.kept == 1
    assert len(list(again.run(Serial()))) == 3
    assert [len(cell.runs) for cell in mended] == [1, 2, 1, 1]
    third = Sweep(mended, tmp_path / "out")
    assert third.kept == 4
    assert third.failed
    assert list(third.run(Serial())) == []


def test_failed_cells_are_run_again_when_asked(tmp_path: Path, notes: str) -> None:
    asked = cells(notes, "good", "raises")
    list(Sweep(asked, tmp_path / "out").run(Serial()))
    mended = [replace(cell, manner="good") for cell in asked]
    sweep = Sweep(mended, tmp_path / "out", retry_failed=True)
    assert [cell.name for cell in sweep.pending] == ["1-raises"]
    list(sweep.run(Serial()))
    assert not sweep.failed
    assert sorted(p.name for p in (tmp_path / "out" / "1-raises").iterdir()) == ["result"]


def test_no_room_costs_the_cell_a_second_run_and_others_nothing(tmp_path: Path, notes: str) -> None:
    asked = cells(notes, "good", "no room once", "good")
    sweep = Sweep(asked, tmp_path / "out")
    order = [outcome.cell for outcome in sweep.run(Serial())]
    assert order == ["0-good", "2-good", "1-no_room_once"]
    assert not sweep.failed
    assert [len(cell.runs) for cell in asked] == [1, 2, 1]
    assert hidden(tmp_path / "out") == []


def test_without_room_at_all_the_cell_is_left_for_the_next_time(tmp_path: Path, notes: str) -> None:
    asked = cells(notes, "good", "no room")
    sweep = Sweep(asked, tmp_path / "out")
    list(sweep.run(Serial()))
    assert sweep.failed
    assert "No space left" in sweep.unwritten["1-no_room"]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["0-good", "sweep.json"]
    assert (tmp_path / "out" / "0-good" / "result").read_text() == "0-good False"
    again = Sweep([replace(cell, manner="good") for cell in asked], tmp_path / "out")
    list(again.run(Serial()))
    assert (again.kept, again.failed) == (1, False)


def test_the_only_cell_says_at_once_that_it_cannot_be_written(tmp_path: Path, notes: str) -> None:
    sweep = Sweep(cells(notes, "no room"), tmp_path / "out")
    with pytest.raises(WctError, match=r"0-no_room: cannot be written: No space left"):
        list(sweep.run(Serial()))
    assert list((tmp_path / "out").iterdir()) == []


def test_a_cell_named_twice_is_run_once(tmp_path: Path, notes: str) -> None:
    (cell,) = cells(notes, "good")
    assert len(list(Sweep([cell, cell], tmp_path / "out").run(Serial()))) == 1


def test_the_sweeps_file_names_every_cell_and_the_command(tmp_path: Path, notes: str) -> None:
    manifest = Manifest(command="lirs-wct validate --suite paper", suite="paper")
    list(Sweep(cells(notes, "good", "raises"), tmp_path / "out", manifest=manifest).run(Serial()))
    entry = json.loads((tmp_path / "out" / "sweep.json").read_text())
    assert entry["suite"] == "paper"
    assert entry["command"] == "lirs-wct validate --suite paper"
    assert [cell["name"] for cell in entry["cells"]] == ["0-good", "1-raises"]
    assert {"lirs-wct", "code", "python"} <= set(entry["versions"])


def test_processes_lose_no_cell_whatever_happens_to_them(tmp_path: Path, notes: str) -> None:
    asked = cells(notes, "good", "dies once", "raises", "good", "hangs", "dies", "leaks", "good", "good")
    told: list[tuple[str, str, float]] = []
    engine = Processes(jobs=2, limits=Limits(seconds=8.0, memory=1_000_000_000))
    sweep = Sweep(asked, tmp_path / "out")
    outcomes = list(sweep.run(engine, lambda *message: told.append(message)))
    assert sorted(outcome.cell for outcome in outcomes) == [cell.name for cell in asked]
    statuses = [sweep.outcomes[cell.name].status for cell in asked]
    assert statuses == ["ok", "ok", "error", "ok", "timeout", "error", "error", "ok", "ok"]
    assert [len(cell.runs) for cell in asked] == [1, 2, 1, 1, 1, 2, 1, 1, 1]
    assert sweep.outcomes["6-leaks"].reason == "MemoryError"
    assert "died 2 times (signal SIGKILL)" in sweep.outcomes["5-dies"].reason
    hung = (tmp_path / "out" / "4-hangs" / "failed").read_text()
    assert "no end within the cell's 8 s" in hung
    assert "fake_cells.py" in hung
    assert (tmp_path / "out" / "0-good" / "result").read_text() == "0-good True"
    assert ("0-good", "drive", 0.5) in told
    assert hidden(tmp_path / "out") == []


def test_one_process_at_a_time_is_no_company(tmp_path: Path, notes: str) -> None:
    list(Sweep(cells(notes, "good"), tmp_path / "out").run(Processes(jobs=1)))
    assert (tmp_path / "out" / "0-good" / "result").read_text() == "0-good False"
