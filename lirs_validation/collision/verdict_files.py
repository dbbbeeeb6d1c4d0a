"""Collision verdicts as JSON and as CSV."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from lirs_validation.collision.validation import CollisionVerdict
from lirs_wct.files import atomic_write

SCHEMA = 1


def write_verdicts(folder: Path, verdicts: Sequence[CollisionVerdict]) -> tuple[Path, Path]:
    """Write `collisions.json` and `collisions.csv`; return their paths.

    Raises:
        OutputError: the folder cannot be written.
    """
    document = {"schema": SCHEMA, "collisions": [verdict.as_dict() for verdict in verdicts]}
    with atomic_write(folder / "collisions.json") as path:
        path.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    with (
        atomic_write(folder / "collisions.csv") as path,
        path.open("w", newline="", encoding="utf-8") as file,
    ):
        rows = [asdict(verdict) | {"passed": verdict.passed} for verdict in verdicts]
        writer = csv.DictWriter(file, list(rows[0]) if rows else ["world"])
        writer.writeheader()
        writer.writerows(rows)
    return folder / "collisions.json", folder / "collisions.csv"
