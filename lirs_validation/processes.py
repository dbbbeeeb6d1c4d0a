"""Processes: our own, their cost, and Ctrl-C, also where compiled kernels wrap it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from multiprocessing import Pipe
from pathlib import Path
from types import FrameType
from typing import Any
from weakref import finalize

if sys.platform == "win32":
    from multiprocessing.connection import PipeConnection as Connection
else:
    import resource
    from multiprocessing.connection import Connection

IDLE_END = 0.3
"""Seconds within which an idle process ends when its pipe is closed."""
SERVE = "from lirs_validation.processes import serve; serve({function!r}, {handle}, {parent})"
HERE = "import sys; sys.argv, sys.path[:] = {argv!r}, {path!r}; " + SERVE
ELSEWHERE = "import sys; sys.argv = {argv!r}; " + SERVE
"""Programs of a process, with this interpreter and with another one, which has modules of its own.

Those of multiprocessing run the caller's script again, which then needs a guard.
"""
CALLBACKS, LATER = ("_raw_object_cache", "__del__"), 0.05
"""Prefixes of LLVM's callbacks and destructors, which drop an exception; seconds until Ctrl-C comes again."""


class ChildProcess:
    """Process that serves a pipe, protected from Ctrl-C; it ends with this object.

    Args:
        function: `module:name`; called in the process with its end of the pipe.
        patience: seconds that it has to tidy up before it is killed.
        python: path of another interpreter; None = this one.
    """

    def __init__(self, function: str, patience: float, python: str | None = None, **options: Any) -> None:
        self.pipe, far = Pipe()
        try:
            self.process = _start(far, function, python, options)
        finally:
            far.close()
        self.end = finalize(self, _end, self.process, self.pipe, patience)

    def cause_of_death(self) -> str:
        """Return how the process ended, by itself or by `end`."""
        self.end()
        code = self.process.returncode
        return f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


def _start(
    far: Connection, function: str, python: str | None, options: dict[str, Any]
) -> subprocess.Popen[bytes]:
    handle = far.fileno()
    program = (HERE if python is None else ELSEWHERE).format(
        argv=sys.argv, path=sys.path, function=function, handle=handle, parent=os.getpid()
    )
    if sys.platform == "win32":
        os.set_handle_inheritable(handle, True)
        inherited = subprocess.STARTUPINFO(lpAttributeList={"handle_list": [handle]})
        options |= {"startupinfo": inherited, "creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    else:
        options |= {"pass_fds": (handle,), "start_new_session": True}
    command = [sys.executable] if python is None else [python, "-P"]  # without the current folder
    return subprocess.Popen([*command, "-c", program], stdin=subprocess.DEVNULL, **options)


def _end(process: subprocess.Popen[bytes], pipe: Connection, patience: float) -> None:
    """End a process and those that it started.

    An idle one ends by itself; a working one is interrupted, and killed in the end.
    """
    pipe.close()
    for end, seconds in ((process.terminate, IDLE_END), (process.kill, patience), (lambda: None, None)):
        with suppress(subprocess.TimeoutExpired):
            process.wait(seconds)
            break
        end()
    end_group(process.pid)


def serve(function: str, handle: int, parent: int) -> None:
    """Call a function with a pipe until it closes or the parent ends this process."""
    with suppress(KeyboardInterrupt, EOFError, OSError):
        end_with(parent)
        module, _, name = function.partition(":")
        getattr(import_module(module), name)(Connection(handle))
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends already
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # taking the interpreter down in order takes long


def is_interrupt(error: BaseException) -> bool:
    """Whether an error is a Ctrl-C. A compiled kernel wraps it in a SystemError."""
    cause: BaseException | None = error if isinstance(error, (KeyboardInterrupt, SystemError)) else None
    while cause is not None and not isinstance(cause, KeyboardInterrupt):
        cause = cause.__cause__ or cause.__context__
    return cause is not None


def end_with(parent: int) -> None:
    """End this process on SIGTERM, as by Ctrl-C, and when its parent was killed.

    The parent handles Ctrl-C itself.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _interrupt)  # a mapper's own `sys.exit` ends nothing but its run
    if sys.platform != "win32":
        # Python drops a signal that a child gets before it handles signals itself, unless it is blocked.
        block = partial(signal.pthread_sigmask, signal.SIG_BLOCK, {signal.SIGTERM})
        os.register_at_fork(before=block, after_in_parent=_unblock, after_in_child=_handle_as_usual)

    def die_with_parent() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        if sys.platform != "win32" and os.getpgrp() == os.getpid():
            end_group(os.getpid())
        os._exit(1)

    threading.Thread(target=die_with_parent, daemon=True).start()


def _handle_as_usual() -> None:
    """Handle signals as Python does: a pool of processes ends its own by SIGTERM."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _unblock()


def _unblock() -> None:
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})


def end_group(leader: int) -> None:
    """Kill the processes that the leader of a group left behind."""
    if sys.platform != "win32":
        with suppress(OSError):  # there are none
            os.killpg(leader, signal.SIGKILL)


def raise_interrupts() -> None:
    """Make Ctrl-C a KeyboardInterrupt outside LLVM's callbacks, unless this process ignores it."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)


@contextmanager
def interrupt_after(seconds: float) -> Iterator[None]:
    """Raise KeyboardInterrupt in a block that lasts longer. Windows has no alarm."""
    if sys.platform == "win32":
        yield
        return
    before = signal.signal(signal.SIGALRM, _interrupt)
    signal.setitimer(signal.ITIMER_REAL, max(seconds, 1e-3))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _interrupt(number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if frame.f_code.co_name.startswith(CALLBACKS):
            again = threading.Timer(LATER, os.kill, (os.getpid(), number))
            again.daemon = True
            again.start()
            return
        frame = frame.f_back
    raise KeyboardInterrupt


_SELF = Path("/proc/self")


@dataclass(frozen=True, slots=True)
class Cost:
    """Cost of processes.

    Attributes:
        cpu_seconds: Processor time of all threads.
        peak_memory: Largest resident memory, bytes, shared memory counted in each process; None where the
            system has no such count.
    """

    cpu_seconds: float
    peak_memory: int | None

    def __add__(self, other: Cost) -> Cost:
        """Return the cost of two processes together; their peaks may not have come at the same time."""
        peaks = self.peak_memory, other.peak_memory
        peak = None if None in peaks else sum(filter(None, peaks))
        return Cost(self.cpu_seconds + other.cpu_seconds, peak)


class CostMeter:
    """Meter of processor time and peak memory of this process."""

    def __init__(self) -> None:
        self._begun = time.process_time()
        with suppress(OSError):
            # Linux forgets the peak so far; elsewhere the peak is the process's whole life's.
            (_SELF / "clear_refs").write_text("5", encoding="ascii")

    def cost(self) -> Cost:
        """Return the cost since the meter was created."""
        return Cost(time.process_time() - self._begun, _peak_memory())


def _peak_memory() -> int | None:
    """Return the peak resident memory, bytes; None if the system has no count."""
    with suppress(OSError):
        lines = (_SELF / "status").read_text(encoding="utf-8").splitlines()
        peaks = [line.split()[1] for line in lines if line.startswith("VmHWM:")]
        if peaks:
            return int(peaks[0]) * 1024
    if sys.platform == "win32":
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


@contextmanager
def compile_timer() -> Iterator[Callable[[], float]]:
    """Measure the time of Numba's compiler in a block, to compile kernels or load them from its cache.

    The yielded function returns the seconds so far.
    """
    from numba.core.event import TimingListener, install_listener

    timer = TimingListener()
    with install_listener("numba:compiler_lock", timer):
        yield lambda: float(timer.duration) if timer.done else 0.0


def load_average() -> float | None:
    """Return the mean number of running processes in the last minute; None without a count."""
    with suppress(AttributeError, OSError):  # Windows has none
        return os.getloadavg()[0]
    return None


def is_shared(load: float | None) -> bool:
    """Whether more processes than cores wanted to run."""
    return load is not None and load > (os.cpu_count() or 1)


@contextmanager
def importable(folder: Path) -> Iterator[None]:
    """Put a folder first on `sys.path` in a block, unless it is there already."""
    entry = str(folder)
    if entry in sys.path:
        yield
        return
    sys.path.insert(0, entry)
    try:
        yield
    finally:
        with suppress(ValueError):
            sys.path.remove(entry)
