"""Exit codes of the commands."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """Exit codes of commands, beside 0 for success."""

    BAD_INPUT = 2
    RUN_FAILED = 3
    GATE_FAILED = 4
    INTERRUPTED = 130
