"""Mapper in its own thread, for mappers that cannot run in another process."""

from __future__ import annotations

import ctypes
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from queue import SimpleQueue
from typing import Any
from weakref import finalize

from lirs_envs.sensing.sensors import Observation
from lirs_validation.experiment.feeding.feeding import (
    Answer,
    AnyMapper,
    Place,
    update_arguments,
    update_mapper,
)
from lirs_validation.experiment.mapper_guard import GuardedCloudMapper

SWITCH_INTERVAL = 2e-4
"""Seconds after which a thread in Python lets the other one have its turn; Python's own 5 ms are 7 ticks."""
PATIENCE = 1.0
"""Seconds that a mapper's thread is waited for at its end."""


@contextmanager
def short_turns() -> Iterator[None]:
    """Shorten the waiting time of threads for Python's lock in a block."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(min(usual, SWITCH_INTERVAL))
    try:
        yield
    finally:
        sys.setswitchinterval(usual)


class ThreadFeeding:
    """Feeding of a mapper in its own thread, which ends with this object.

    The mapper's kernels, MuJoCo's step and the lidar's rays release Python's lock, so that they run beside
    each other; Python code of the threads runs in turns.
    """

    place: Place = "thread"

    def __init__(self, mapper: AnyMapper) -> None:
        self._mail, self._clouds = _Mail(), isinstance(mapper, GuardedCloudMapper)
        # Daemon: a mapper that hangs does not keep the program from its end.
        self._thread = threading.Thread(target=_feed, args=(mapper, self._mail), name="mapper", daemon=True)
        self._thread.start()
        self._end = finalize(self, self._mail.end)
        self._unanswered = 0

    @property
    def ready(self) -> bool:
        """Whether the next answer is there."""
        return not self._mail.answers.empty()

    def give(self, observation: Observation) -> None:
        """Hand a scan to the mapper's thread (see `Feeding`)."""
        self._mail.scans.put(update_arguments(observation, clouds=self._clouds))
        self._unanswered += 1

    def answer(self) -> Answer:
        """Wait for the mapper's next answer (see `Feeding`)."""
        found = self._mail.answers.get()
        self._unanswered -= 1
        if isinstance(found, BaseException):
            raise found
        return found

    def close(self) -> None:
        """End the thread; a mapper that is at work is interrupted as by Ctrl-C."""
        self._end()
        if self._unanswered and self._thread.ident is not None:
            thread, interrupt = ctypes.c_ulong(self._thread.ident), ctypes.py_object(KeyboardInterrupt)
            ctypes.pythonapi.PyThreadState_SetAsyncExc(thread, interrupt)
        self._thread.join(PATIENCE)


class _Mail:
    """Messages between the threads of a drive and of its mapper."""

    def __init__(self) -> None:
        self.scans: SimpleQueue[tuple[Any, ...] | None] = SimpleQueue()
        self.answers: SimpleQueue[Answer | BaseException] = SimpleQueue()
        self.ended = False

    def end(self) -> None:
        """Let the mapper's thread end, whatever scans there are."""
        self.ended = True
        self.scans.put(None)


def _feed(mapper: AnyMapper, mail: _Mail) -> None:
    """Answer the scans of a drive until it ends, or the mapper fails."""
    with suppress(KeyboardInterrupt):
        while (update := mail.scans.get()) is not None and not mail.ended:
            try:
                mail.answers.put(update_mapper(mapper, update))
            except BaseException as error:  # the drive's thread raises it
                mail.answers.put(error)
                return
