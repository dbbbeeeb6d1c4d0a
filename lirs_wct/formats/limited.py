"""Compiled readers of untrusted files in a process with time and memory limits."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import Timer
from time import monotonic
from typing import Any, TypeVar

from lirs_wct.errors import SourceError, reason_of

T = TypeVar("T")
SECONDS, SECONDS_PER_BYTE = 30.0, 5e-6
"""Time limit of a file: a constant and 5 s per megabyte."""
MEMORY, MEMORY_PER_BYTE = 512 << 20, 200
"""Memory limit of a file in bytes; a LAZ file unpacks to some ten times its size, seldom to fifty times."""
THREADS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "RAYON_NUM_THREADS": "4"}
"""Each thread's stack counts as memory."""
PROGRAM = "import sys; sys.path[:] = {path!r}; from lirs_wct.formats.limited import _serve; _serve()"
"""Program of the process. Those of multiprocessing rerun the caller's script, which then needs a guard."""


def run_limited(
    path: Path,
    read: Callable[..., T],
    *arguments: Any,
    size: int = 0,
    memory: int = 0,
    environment: Mapping[str, str] | None = None,
) -> T:
    """Call `read(*arguments)` in a process with time and memory limits; return its result.

    Args:
        path: file that is read; its size scales the limits.
        read: function of a module, which can be pickled, as must its arguments and result.
        *arguments: of the function.
        size: bytes of other files that are read.
        memory: additional bytes that are allowed.
        environment: variables of the process, set before its libraries load.

    Raises:
        SourceError: the function raised one, or any other exception, or exceeded a limit.
    """
    size += path.stat().st_size
    seconds = SECONDS + SECONDS_PER_BYTE * size
    memory += MEMORY + MEMORY_PER_BYTE * size
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(path=sys.path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, **THREADS, **(environment or {})},
    )
    timer = Timer(seconds, process.kill)
    began = monotonic()
    timer.start()
    try:
        with process:
            answer = _ask(process, (read, arguments, int(seconds) + 1, memory))
    finally:
        timer.cancel()
        process.kill()
    if answer is None:
        late = monotonic() - began >= seconds
        reason = f"takes more than {seconds:.0f} s" if late else _ending(process.returncode)
        raise SourceError(f"{path}: cannot be read: its reader {reason}")
    value, fault = answer
    if fault is not None:
        raise SourceError(fault if fault.startswith(f"{path}:") else f"{path}: cannot be read: {fault}")
    result: T = value
    return result


def _ask(process: subprocess.Popen[bytes], question: Any) -> tuple[Any, str | None] | None:
    """Return the answer of a process; None where it ended without one."""
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        with process.stdin as pipe:
            pickle.dump(question, pipe, 5)
        answer: tuple[Any, str | None] = pickle.load(process.stdout)
    except (OSError, EOFError, pickle.UnpicklingError):
        return None
    return answer


def _ending(code: int) -> str:
    return f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"


def _serve() -> None:
    """Answer the question on stdin with a value or the text of an error."""
    with os.fdopen(os.dup(1), "wb") as out:
        # Output that a library prints must not mix with the answer.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        read, arguments, seconds, memory = pickle.load(sys.stdin.buffer)
        _limit(seconds, memory)
        value, fault = None, None
        try:
            value = read(*arguments)
        except MemoryError:
            fault = f"needs more than {memory >> 20} MiB of memory"
        except BaseException as error:  # a reader in Rust panics with an exception that is none of Python's
            fault = str(error) if isinstance(error, SourceError) else reason_of(error)
        pickle.dump((value, fault), out, 5)


def _limit(seconds: int, memory: int) -> None:
    if sys.platform == "win32":
        return  # only the time limit applies
    import resource

    # Not the address space: allocators and threads reserve much that they never use.
    limits = {resource.RLIMIT_DATA: memory, resource.RLIMIT_CPU: 8 * seconds, resource.RLIMIT_CORE: 0}
    for kind, most in limits.items():
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
