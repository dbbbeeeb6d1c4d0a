"""Program of a mapper's process: make the mapper, feed it, answer requests."""

from __future__ import annotations

import os
import pickle
import signal
import sys
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, cast

from lirs_validation.experiment.cost import Cost, CostMeter, compile_timer
from lirs_validation.experiment.feeding.feeding import update_mapper
from lirs_validation.experiment.feeding.packing import ScanBatch, pack_pose, unpack_updates
from lirs_validation.experiment.mapper_guard import guard_mapper
from lirs_validation.experiment.mapper_loading import MapperSpec, MapperTraits, mapper_named, warm_up_mapper
from lirs_validation.interrupts import end_with
from lirs_wct.errors import MapperError, WctError
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.mapper import Mapper, MapperStats, reads_clouds, requires_odometry

if sys.platform == "win32":
    from multiprocessing.connection import PipeConnection as Connection
else:
    from multiprocessing.connection import Connection

ATTENTION, NAP = 0.1, 2e-4
"""Seconds for which a message is looked out for, and between two looks."""
PackedAnswer = tuple[tuple[float, ...], bool, float]
"""A pose, whether the mapper is lost, seconds."""


def serve(handle: int, parent: int) -> None:
    """Serve requests from a pipe until it closes or the parent ends it.

    Args:
        handle: of this process's end of the pipe.
        parent: process id.
    """
    with suppress(KeyboardInterrupt, EOFError, OSError):
        end_with(parent)
        pipe, server = Connection(handle), _Server()
        while True:
            _await(pipe)
            name, *arguments = pickle.loads(pipe.recv_bytes())
            pipe.send_bytes(pickle.dumps(_outcome(server, name, arguments), 5))
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends already
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # taking the interpreter down in order takes long


def _await(pipe: Connection) -> None:
    """Look out for a message for a moment.

    Waiting for it instead has Linux wake this process on the sender's core, where it takes the sender's
    place, although the other core is free.
    """
    until = time.monotonic() + ATTENTION
    while not pipe.poll() and time.monotonic() < until:
        time.sleep(NAP)


def _outcome(server: _Server, name: str, arguments: Sequence[Any]) -> tuple[Any, Exception | None]:
    try:
        return getattr(server, name)(*arguments), None
    except Exception as error:
        return None, _sendable(error)


class _Server:
    """A run's mapper; each method is a request."""

    def make(self, spec: MapperSpec) -> MapperTraits:
        """Make the mapper; return its traits."""
        self._spec = spec
        self.begin()
        mapper = self._mapper
        return MapperTraits(reads_clouds(mapper), requires_odometry(cast("Mapper", mapper)))

    def warm_up(self) -> float:
        """Compile the mapper's kernels; return the seconds that the compiler took."""
        with compile_timer() as compile_seconds:
            warm_up_mapper(self._spec.mapper)
        return compile_seconds()

    def begin(self) -> None:
        """Make a new mapper."""
        self._mapper = guard_mapper(mapper_named(self._spec.mapper, self._spec.seed), self._spec)
        self._meter = CostMeter()

    def update(
        self, batch: ScanBatch | Sequence[tuple[Any, ...]]
    ) -> tuple[list[PackedAnswer], Exception | None]:
        """Feed the mapper; return its answers and the error that stopped it.

        An answer is pose, lost and seconds of a scan.
        """
        answers: list[PackedAnswer] = []
        for update in unpack_updates(batch):
            try:
                answer = update_mapper(self._mapper, update)
            except Exception as error:
                return answers, _sendable(error)
            answers.append((pack_pose(answer.estimate), answer.lost, answer.seconds))
        return answers, None

    def map(self) -> OccupancyGrid:
        """Return the mapper's map."""
        return self._mapper.map()  # type: ignore[union-attr]  # of clouds: is not asked

    def trajectory(self) -> Trajectory:
        """Return the mapper's trajectory."""
        return self._mapper.trajectory()

    def stats(self) -> MapperStats:
        """Return the mapper's statistics."""
        return self._mapper.stats

    def lost(self) -> bool:
        """Return whether the mapper does not know its place."""
        return self._mapper.lost

    def cost(self) -> Cost:
        """Return the cost of this process since the mapper was made."""
        return self._meter.cost()


def _sendable(error: Exception) -> Exception:
    """Return a serializable error, with a note of its origin."""
    note = f"In the mapper's process:\n{''.join(traceback.format_exception(error))}"
    if type(error).__module__ != WctError.__module__:
        error = MapperError(str(error))
    error.add_note(note)
    return error
