"""`record`: a run's folder that is a bag, where it is put, and what is refused."""

from pathlib import Path
from typing import Any

import pytest

from lirs_validation.record.run_record import read_record

pytestmark = pytest.mark.usefixtures("plain_pictures")
SMALL = ("--size", "20", "--height", "2", "--option", "resize=129,129", "--seconds", "0.4")


def test_a_drive_is_recorded_into_the_folder_that_is_named(wct: Any, tmp_path: Path) -> None:
    told = ("simple", *SMALL, "--storage", "sqlite3", "-o", "run")
    code, shown, _ = wct("record", *told)
    assert code == 0
    assert "run" in shown.splitlines()
    assert {"metadata.yaml", "bag.db3", "record.json", "scans.clf.gz"} <= {
        p.name for p in (tmp_path / "run").iterdir()
    }
    assert [p.name for p in tmp_path.iterdir()] == ["run"]
    config = read_record(tmp_path / "run")["config"]
    assert (config["bag"], config["sensors_only"]) == ("sqlite3", False)
    code, _, said = wct("record", *told)
    assert (code, "kept 1 of 1" in said) == (0, True)
    code, _, complaint = wct("record", "simple", "--seconds", "2", "-o", "run")
    assert (code, complaint.count("\n")) == (2, 1)
    assert "run: holds another run, simple-husky-hector-s1-" in complaint


@pytest.mark.slow
def test_what_was_recorded_is_mapped(wct: Any) -> None:
    assert wct("record", "simple", *SMALL, "-o", "run")[0] == 0
    assert wct("map", "run", "--mapper", "hector", "--scan-topic", "/scan", "-o", "maps")[0] == 0


def test_several_drives_are_recorded_beside_each_other(wct: Any, tmp_path: Path) -> None:
    code, _, _ = wct("record", "simple", *SMALL, "--seed", "1-2", "-o", "bags")
    assert code == 0
    folders = [p for p in (tmp_path / "bags").iterdir() if p.is_dir()]
    assert len(folders) == 2
    assert all((folder / "bag.mcap").is_file() for folder in folders)


def test_a_folder_of_something_else_is_not_replaced(wct: Any, tmp_path: Path) -> None:
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "mine.txt").write_text("kept")
    code, _, complaint = wct("record", "simple", "-o", "notes")
    assert (code, complaint.count("\n")) == (2, 1)
    assert "notes: holds something else than a run" in complaint
    assert (tmp_path / "notes" / "mine.txt").read_text() == "kept"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("record", "simple", "--storage", "zip"), "--storage must be mcap or sqlite3, got 'zip'"),
        (("record",), "nothing to validate"),
    ],
)
def test_bad_input_is_one_line(arguments: tuple[str, ...], expected: str, wct: Any, tmp_path: Path) -> None:
    code, _, complaint = wct(*arguments)
    assert (code, complaint.count("\n")) == (2, 1)
    assert expected in complaint
    assert list(tmp_path.iterdir()) == []
