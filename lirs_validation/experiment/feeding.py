"""How a drive's mapper gets its scans: at once, or in a thread of its own while the drive goes on."""

from __future__ import annotations

import ctypes
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Protocol
from weakref import finalize

from lirs_envs.sensing.sensors import Observation
from lirs_validation.experiment.clouds.guard import GuardedCloudMapper
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2, Pose3
from slam_baselines.mapper import Mapper

AnyMapper = Mapper | GuardedCloudMapper
SWITCH_INTERVAL = 2e-4
"""Seconds after which a thread in Python lets the other one have its turn; Python's own 5 ms are 7 ticks."""
PATIENCE = 1.0
"""Seconds that a mapper's thread is waited for at its end."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What a mapper answered to a scan.

    Attributes:
        estimate: `T_map_base`, in the plane or in space.
        lost: whether it does not know its place.
        seconds: wall-clock time of its update.
    """

    estimate: Pose2 | Pose3
    lost: bool
    seconds: float


class Feeding(Protocol):
    """Feeds a mapper scan by scan; answers come in the order of the scans."""

    @property
    def ready(self) -> bool:
        """Whether nothing is gained by waiting for the next answer."""
        ...

    def give(self, observation: Observation) -> None:
        """Hand a scan to the mapper."""
        ...

    def answer(self) -> Answer:
        """Return what the mapper answered to the first scan that is not answered yet.

        Raises:
            MapperError: the mapper failed.
            ConfigError: it reads point clouds, and the lidar has no rings.
        """
        ...

    def close(self) -> None:
        """End what goes on; nothing is given afterwards."""
        ...


def feeding(mapper: AnyMapper, threads: int) -> Feeding:
    """Return what feeds a mapper in a drive of one thread or two."""
    return ThreadFeeding(mapper) if threads > 1 else DirectFeeding(mapper)


@contextmanager
def short_turns(threads: int) -> Iterator[None]:
    """Let threads that want to run Python in a block wait for each other less than they do usually."""
    usual = sys.getswitchinterval()
    if threads > 1:
        sys.setswitchinterval(min(usual, SWITCH_INTERVAL))
    try:
        yield
    finally:
        sys.setswitchinterval(usual)


class DirectFeeding:
    """Feeds a mapper when it is asked for its answer."""

    ready = True

    def __init__(self, mapper: AnyMapper) -> None:
        self._mapper = mapper

    def give(self, observation: Observation) -> None:
        """Keep the scan (see `Feeding`)."""
        self._observation = observation

    def answer(self) -> Answer:
        """Feed the mapper (see `Feeding`)."""
        return answered(self._mapper, self._observation)

    def close(self) -> None:
        """Nothing goes on."""


class ThreadFeeding:
    """Feeds a mapper in a thread of its own, which ends with this object.

    The mapper's kernels, MuJoCo's step and the lidar's rays release Python's lock, so that they run beside
    each other; what the threads do in Python they do in turns.
    """

    def __init__(self, mapper: AnyMapper) -> None:
        self._mail = _Mail()
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
        """Hand a scan to the mapper's thread."""
        self._unanswered += 1
        self._mail.scans.put(observation)

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
    """What the threads of a drive and of its mapper send each other."""

    def __init__(self) -> None:
        self.scans: SimpleQueue[Observation | None] = SimpleQueue()
        self.answers: SimpleQueue[Answer | BaseException] = SimpleQueue()
        self.ended = False

    def end(self) -> None:
        """Let the mapper's thread end, whatever scans there are."""
        self.ended = True
        self.scans.put(None)


def _feed(mapper: AnyMapper, mail: _Mail) -> None:
    """Answer the scans of a drive until it ends, or the mapper fails."""
    with suppress(KeyboardInterrupt):
        while (observation := mail.scans.get()) is not None and not mail.ended:
            try:
                mail.answers.put(answered(mapper, observation))
            except BaseException as error:  # the drive's thread raises it
                mail.answers.put(error)
                return


def answered(mapper: AnyMapper, observation: Observation) -> Answer:
    """Give a mapper what it reads of an observation; return its answer.

    Raises:
        MapperError: the mapper failed.
        ConfigError: it reads point clouds, and the lidar has no rings.
    """
    begun = time.perf_counter()
    if not isinstance(mapper, GuardedCloudMapper):
        estimate: Pose2 | Pose3 = mapper.update(observation.scan, observation.odometry, observation.imu)
    elif observation.cloud is None:
        raise ConfigError("a mapper of point clouds needs a lidar with rings")
    else:
        estimate = mapper.update(observation.cloud, observation.imu)
    seconds = time.perf_counter() - begun
    return Answer(estimate, mapper.lost, seconds)
