"""Where commands speak: results on stdout, progress and complaints on stderr."""

from __future__ import annotations

from rich.console import Console

out, err = Console(), Console(stderr=True)

RUN_FAILED, BAD_INPUT, INTERRUPTED = 3, 2, 130
"""Exit codes, beside 0 for success."""
