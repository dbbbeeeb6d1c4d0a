"""Ctrl-C, also wrapped by compiled kernels, and the end of a worker process."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from types import FrameType

CALLBACK, LATER = "_raw_object_cache", 0.05
"""Prefix of LLVM's callbacks, which drop an exception and crash; seconds until Ctrl-C comes again."""


def is_interrupt(error: BaseException) -> bool:
    """Whether an error is a Ctrl-C. A compiled kernel wraps it in a SystemError."""
    return isinstance(error, (KeyboardInterrupt, SystemError)) and any(
        isinstance(cause, KeyboardInterrupt) for cause in _causes(error)
    )


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def end_with(parent: int) -> None:
    """End this process on SIGTERM, as by Ctrl-C, and when its parent was killed.

    The parent handles Ctrl-C itself.

    Args:
        parent: process id; even a mapper that hangs does not outlive it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _interrupt)  # a mapper's own `sys.exit` ends nothing but its run
    if sys.platform != "win32":
        os.register_at_fork(after_in_child=_handle_as_usual)
    threading.Thread(target=_die_with, args=(parent,), daemon=True).start()


def _handle_as_usual() -> None:
    """Handle signals as Python does: a pool of processes ends its own by SIGTERM."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def end_group(leader: int) -> None:
    """Kill the processes that the leader of a group left behind."""
    if sys.platform != "win32":
        with suppress(OSError):  # there are none
            os.killpg(leader, signal.SIGKILL)


def raise_interrupts() -> None:
    """Make Ctrl-C a KeyboardInterrupt outside LLVM's callbacks, unless this process ignores it."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if frame.f_code.co_name.startswith(CALLBACK):
            again = threading.Timer(LATER, os.kill, (os.getpid(), number))
            again.daemon = True
            again.start()
            return
        frame = frame.f_back
    raise KeyboardInterrupt


def _die_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1.0)
    if sys.platform != "win32" and os.getpgrp() == os.getpid():
        end_group(os.getpid())
    os._exit(1)
