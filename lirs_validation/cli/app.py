"""The program `lirs-wct`: errors become one line and an exit code."""

from __future__ import annotations

import errno
import gc
import os
import sys
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from lirs_validation.cli.command import PROGRAM
from lirs_validation.cli.exit_codes import ExitCode
from lirs_validation.cli.progress import note
from lirs_validation.processes import importable, is_interrupt, raise_interrupts
from lirs_wct.errors import MapperError, WctError

DISK_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
"""Error numbers of a full disk."""
MAX_MESSAGE_LENGTH = 900
"""Characters of an error message, at most; of longer ones the middle is omitted."""


def main() -> None:
    """Run the command line; bad input is one line on stderr and exit code 2."""
    warnings.showwarning = _one_line
    # Of NumPy, about numbers in damaged files; a message of ours about the file follows.
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    raise_interrupts()
    gc.set_threshold(100_000, 50, 50)  # imports and compiler make many objects, and little garbage
    try:
        with importable(Path.cwd()):
            code = PROGRAM.main(prog_name="lirs-wct", standalone_mode=False)
    except MapperError as error:  # the input was good, its mapping failed
        _fail(str(error), ExitCode.RUN_FAILED)
    except WctError as error:
        _fail(str(error))
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(ExitCode.BAD_INPUT)
    except click.ClickException as error:
        _fail(error.format_message())
    except (click.Abort, KeyboardInterrupt, SystemError) as error:
        if isinstance(error, SystemError) and not is_interrupt(error):
            raise
        _fail("interrupted; nothing half-written was left", ExitCode.INTERRUPTED)
    except OSError as error:
        if error.errno not in DISK_FULL:
            raise
        # Output that is still buffered would fail again at exit.
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        _fail(f"{error.filename or 'output'}: cannot be written: {error.strerror}")
    gc.freeze()  # nothing is left to collect; the end of the interpreter would look through all of it
    sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str, code: int = ExitCode.BAD_INPUT) -> None:
    if len(message) > MAX_MESSAGE_LENGTH:
        message = f"{message[: MAX_MESSAGE_LENGTH - 200]} ... {message[-200:]}"
    note(f"lirs-wct: {message}", style="red")
    sys.exit(code)


def _one_line(message: Warning | str, *_: Any, **__: Any) -> None:
    note(f"lirs-wct: {message}", style="yellow")
