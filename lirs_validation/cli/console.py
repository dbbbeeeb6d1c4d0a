"""Consoles of commands: results on stdout, progress and errors on stderr."""

from __future__ import annotations

import os
import sys

from rich.console import Console

WIDE = 200
"""Columns of a file or a pipe, which have no width of their own unless COLUMNS says one."""

out = Console(width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else WIDE)
err = Console(stderr=True)

RUN_FAILED, BAD_INPUT, GATE_FAILED, INTERRUPTED = 3, 2, 4, 130
"""Exit codes, beside 0 for success."""
