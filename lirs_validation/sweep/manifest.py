"""`sweep.json`: what a folder of results was asked for."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lirs_validation.record.provenance import machine, versions
from lirs_validation.record.run_record import plain
from lirs_wct.files import atomic_write

NAME = "sweep.json"
SCHEMA = 1


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """What was asked for.

    Attributes:
        command: the command line.
        suite: name of the suite; None = the experiments were asked for one by one.
        cells: of each experiment its name, world and config, and the suite's tables that it belongs to.
    """

    command: str = ""
    suite: str | None = None
    cells: tuple[dict[str, Any], ...] = ()
    versions: dict[str, str] = field(default_factory=versions)
    machine: dict[str, Any] = field(default_factory=machine)

    def save(self, folder: Path) -> None:
        """Write `sweep.json`.

        Raises:
            OutputError: the folder cannot be written.
        """
        with atomic_write(folder / NAME) as path:
            text = json.dumps({"schema": SCHEMA} | vars(self), indent=1, default=plain)
            path.write_text(text + "\n", encoding="utf-8")
