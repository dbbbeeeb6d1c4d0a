"""Readers of result folders: valid records, and the names of unreadable folders."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from lirs_validation.collision.validation import CollisionVerdict
from lirs_validation.record.map_record import is_mapped_log
from lirs_validation.record.metric_catalog import Entry
from lirs_validation.record.run_record import read_whole_record
from lirs_validation.sweep.experiment import MANIFEST, STATUS, read_verdict
from lirs_wct.errors import SourceError, reason_of


@dataclass(frozen=True)
class RunFolder:
    """A run's folder and its record as nested dicts."""

    folder: Path
    entry: Entry


@dataclass(frozen=True)
class ResultFolder:
    """Contents of a folder of results.

    Attributes:
        root: the folder.
        runs: by name of their folders.
        collisions: verdicts of collision validations.
        broken: names of collision validations without a result, and why.
        skipped: names of folders that cannot be read, and why.
        manifest: content of `sweep.json`; empty without one.
    """

    root: Path
    runs: tuple[RunFolder, ...]
    collisions: tuple[CollisionVerdict, ...] = ()
    broken: tuple[tuple[str, str], ...] = ()
    skipped: tuple[tuple[str, str], ...] = ()
    manifest: Entry | None = None


def read_run(folder: Path) -> RunFolder:
    """Read a run's folder.

    Raises:
        SourceError: it holds no record, or one that is damaged or of another version.
    """
    return RunFolder(folder, read_whole_record(folder))


def read_results(root: Path) -> ResultFolder:
    """Read a run's folder, or a folder of such folders; unreadable ones are listed.

    Raises:
        SourceError: there is no such folder, or no record in it can be read.
    """
    if not root.is_dir():
        raise SourceError(f"{root}: no such folder of results")
    if (root / "record.json").exists():
        return ResultFolder(root, (read_run(root),))
    runs: list[RunFolder] = []
    verdicts: list[CollisionVerdict] = []
    broken: list[tuple[str, str]] = []
    skipped: list[tuple[str, str]] = []
    for folder in sorted(p for p in root.iterdir() if p.is_dir() and not p.name.startswith(".")):
        try:
            if is_mapped_log(folder):
                continue  # a source of runs, and none itself
            if (folder / "record.json").exists():
                runs.append(read_run(folder))
            elif (folder / STATUS).exists() and (reason := _failure(folder / STATUS)) is not None:
                broken.append((folder.name, reason))
            elif (folder / STATUS).exists():
                verdicts.append(read_verdict(folder))
        except SourceError as error:
            skipped.append((folder.name, str(error).removeprefix(f"{folder}/")))
    manifest = _manifest(root / MANIFEST, skipped)
    if not runs and not verdicts:
        named = "".join(f"; {name}: {reason}" for name, reason in skipped[:3])
        raise SourceError(f"{root}: holds no readable record of a run (folders with a record.json){named}")
    return ResultFolder(root, tuple(runs), tuple(verdicts), tuple(broken), tuple(skipped), manifest)


def _failure(path: Path) -> str | None:
    """Return the reason of a failed collision validation; None of a successful one."""
    entry = _json(path)
    status, reason = entry.get("status"), entry.get("reason")
    if not isinstance(status, str) or not isinstance(reason, str):
        raise SourceError(f"{path}: damaged: status and reason must be text")
    return None if status == "ok" else reason or status


def _manifest(path: Path, skipped: list[tuple[str, str]]) -> Entry | None:
    if not path.exists():
        return None
    try:
        entry = _json(path)
        cells = entry.get("cells", [])
        if not isinstance(cells, list) or not all(
            isinstance(cell, dict) and isinstance(cell.get("name"), str) for cell in cells
        ):
            raise SourceError(f"{path}: damaged: cells must be a list of objects with a name")
        return entry
    except SourceError as error:
        skipped.append((path.name, str(error)))
        return None


def _json(path: Path) -> Entry:
    try:
        entry = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SourceError(f"{path}: not readable, or damaged: {reason_of(error)}") from error
    if not isinstance(entry, dict):
        raise SourceError(f"{path}: damaged: an object is required, got {entry!r:.40}")
    return entry
