"""Folders of results that were cut off, emptied or filled with nonsense: named in one line, no traceback."""

import copy
import json
import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from lirs_validation import resolve_source
from lirs_validation.analysis.results import read_results, recorded_config
from lirs_validation.report.run_report import report_of
from lirs_validation.report.run_tables import results_table
from lirs_validation.sweep.tasks import RunTask
from lirs_wct.errors import OutputError, SourceError
from lirs_wct.formats.map_server import read_map
from lirs_wct.sources.source import BuildOptions
from tests.command_line import run_command
from tests.lirs_validation.records import WITH_RESULTS, record, saved, saved_whole

pytestmark = pytest.mark.usefixtures("empty_charts")
NONSENSE: tuple[Any, ...] = (None, [], {}, "much", -7, [[1]], {"a": {"b": 1}}, True, "\u0000", 1e308)


@pytest.fixture
def folder(finished_run_copy: Path) -> Path:
    """A copy of the run, beside a second one that is whole."""
    saved(finished_run_copy.parent, seed=2)
    return finished_run_copy


def lines(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    """Run a command; whatever it says, a traceback would come out of it as an exception."""
    return run_command(*words), capsys.readouterr().err


def cut(path: Path, how: str) -> None:
    content = path.read_bytes()
    if how == "gone":
        path.unlink()
    else:
        path.write_bytes(
            {"empty": b"", "half": content[: len(content) // 2], "noise": b"\xff\x00{[" * 40}[how]
        )


CUTS = [
    *((name, how) for name in WITH_RESULTS for how in ("gone", "half")),
    *((name, how) for name in ("record.json", "map.pgm", "truth.tum") for how in ("empty", "noise")),
]


@pytest.mark.parametrize(
    ("name", "how"),
    [pytest.param(*cut, marks=pytest.mark.slow) if k > 1 else cut for k, cut in enumerate(CUTS)],
)
def test_a_file_that_is_cut_off_is_named(
    name: str, how: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cut(folder / name, how)
    out = str(folder.parent)
    monkeypatch.chdir(folder.parent.parent)
    code, said = lines(capsys, "report", out, "-o", "r.html")
    assert code == 0
    if name == "record.json" and how != "gone":
        assert said.count("\n") == 1
        assert said.startswith(f"skipped {folder.name}: record.json: ")
    code, said = lines(capsys, "compare", out, out)
    assert code == 0
    files = ("--trajectory", str(folder / "estimate.tum"), "--map", str(folder / "map.yaml"))
    code, said = lines(capsys, "score", str(folder), *files)
    assert code in (0, 2, 3)
    assert code != 2 or (said.count("\n") == 1 and str(folder) in said), said


def places(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield every place in a record; of lists the first element alone."""
    if path:
        yield path
    children = (
        node.items() if isinstance(node, dict) else enumerate(node[:1]) if isinstance(node, list) else ()
    )
    for key, child in children:
        yield from places(child, (*path, key))


@pytest.mark.slow
def test_nonsense_in_a_record_is_named_or_does_not_matter(tmp_path: Path) -> None:
    """Every value of a record is replaced by nonsense, one at a time."""
    folder = saved_whole(tmp_path, record())
    whole = json.loads((folder / "record.json").read_text())
    experiment = RunTask(recorded_config(whole))
    assert experiment.find_outcome(tmp_path) is not None
    for place in places(whole):
        for value in NONSENSE:
            odd = copy.deepcopy(whole)
            at = odd
            for part in place[:-1]:
                at = at[part]
            at[place[-1]] = value
            (folder / "record.json").write_text(json.dumps(odd))
            outcome = experiment.find_outcome(tmp_path)  # no traceback
            assert outcome is None or isinstance(outcome.reason, str), (place, value)
            with suppress(SourceError):
                results = read_results(tmp_path)
                assert len(report_of(results).tables["commands"].rows) == 1
                results_table([run.entry for run in results.runs])
                recorded_config(results.runs[0].entry)


@pytest.mark.parametrize(
    "cells", [3, [3], [{"name": []}], [{"name": {}}], {"a": 1}, [{"name": None, "x": 1}]]
)
def test_nonsense_in_a_manifest_does_not_matter(
    cells: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved(tmp_path / "out")
    (tmp_path / "out" / "sweep.json").write_text(json.dumps({"cells": cells, "suite": [], "command": {}}))
    code, _ = lines(capsys, "report", str(tmp_path / "out"), "-o", str(tmp_path / "r.html"))
    assert code == 0


@pytest.mark.parametrize(
    "text", ["[]", '{"status": [], "reason": 1, "versions": {}}', "3", "{", '{"status": "ok"}']
)
def test_a_collision_check_that_is_nonsense_is_run_again(text: str, tmp_path: Path) -> None:
    from lirs_validation.record.run_record import versions
    from lirs_validation.sweep.tasks import CollisionTask

    check = CollisionTask(source="simple", robot="husky")
    folder = tmp_path / check.name
    folder.mkdir()
    (folder / "cell.json").write_text(text)
    assert check.find_outcome(tmp_path) is None
    whole = {"status": "ok", "reason": "", "versions": versions()}
    (folder / "cell.json").write_text(json.dumps(whole))
    (folder / "collisions.json").write_text(text)
    assert check.find_outcome(tmp_path) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "how"),
    [("record.json", "half"), ("map.pgm", "gone"), ("map.pgm", "noise"), ("map.yaml", "empty")],
)
def test_a_mapped_log_that_is_cut_off_is_mapped_again(
    name: str, how: str, mapped: Path, finished_run: Path, tmp_path: Path
) -> None:
    log, out = finished_run / "scans.clf.gz", tmp_path / "out"
    shutil.copytree(mapped.parent, out)
    damaged = out / mapped.name / name
    cut(damaged, how)
    if how in ("noise", "empty"):  # may be the user's work
        with pytest.raises(
            OutputError, match=rf"^{damaged}: was not written by this program, or was changed"
        ):
            resolve_source(log, BuildOptions(), out)
        damaged.unlink()
    found = resolve_source(log, BuildOptions(), out)
    assert read_map(Path(found)).known.any()


@pytest.fixture(scope="module")
def mapped(finished_run: Path, plain_pictures: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    options = BuildOptions()
    return Path(
        resolve_source(finished_run / "scans.clf.gz", options, tmp_path_factory.mktemp("mapped"))
    ).parent
