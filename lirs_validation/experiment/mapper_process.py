"""A mapper in its own process: foreign code cannot reach the evaluation.

This module imports NumPy and our light modules only, so that another interpreter can serve a mapper.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from multiprocessing import Pipe
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any, NoReturn
from weakref import finalize

from lirs_validation.experiment.cost import Cost, CostMeter, compile_timer
from lirs_validation.experiment.mapper_loading import MapperSpec, interpreter_of, mapper_named, warm_up_mapper
from lirs_validation.experiment.mapper_under_test import METHODS, Estimate, MapperUnderTest, SensorReadings
from lirs_validation.interrupts import end_with, is_interrupt
from lirs_wct.errors import MapperError, WctError
from slam_baselines.mapper import CLOUD_MAPPERS

if sys.platform == "win32":
    from multiprocessing.connection import PipeConnection as Connection
else:
    from multiprocessing.connection import Connection

if TYPE_CHECKING:
    from lirs_envs.sensing.sensors import Observation
    from lirs_validation.config import RunConfig
    from lirs_validation.experiment.drive_log import Place, Tick
    from lirs_validation.map_config import MapConfig

BATCH = 8
"""Observations that are sent together; a message takes as long as a tenth of a tick."""
IDLE_END = 0.3
"""Seconds within which an idle process ends when its pipe is closed."""
PATIENCE = 1.0
"""Seconds that a mapper at work is given to tidy up before its process is killed."""
OURS = ("lirs_wct", "slam_baselines", "lirs_validation")
SERVE = "from lirs_validation.experiment.mapper_process import serve; serve({handle}, {parent})"
PROGRAM = "import sys; sys.argv, sys.path[:] = {argv!r}, {path!r}; " + SERVE
"""Of the process. Those of multiprocessing run the caller's script again, which then needs a guard."""
ELSEWHERE = """
import sys
from importlib.machinery import PathFinder

class Ours:
    find_spec = staticmethod(
        lambda name, path=None, target=None: PathFinder.find_spec(name, {folders!r}.get(name, ()))
    )

sys.argv, sys.path[:] = {argv!r}, [entry for entry in sys.path if entry]
sys.meta_path.insert(0, Ours)
"""
"""Of a process with another interpreter, which takes our packages from here and all others from there."""

ATTENTION, NAP = 0.1, 2e-4
"""Seconds for which a message is looked out for, and between two looks."""


def needs_process(mapper: str) -> bool:
    """Whether a mapper is foreign code: `module:name`, or an adapter of a compiled system."""
    return ":" in mapper or mapper in CLOUD_MAPPERS


def start_mapper(config: RunConfig) -> MapperUnderTest:
    """Return the mapper of a run.

    It has its own process if it is foreign code or a second thread is used.

    Raises:
        ConfigError: the mapper cannot be made.
        MapperError: the process cannot be started.
    """
    if config.threads > 1 or needs_process(config.mapper):
        return MapperProcess(config, look_ahead=config.threads > 1)
    make = partial(mapper_named, config.mapper, config.seed, config.parameters)
    return MapperUnderTest(make, config.mapper, config.attitude)


class MapperProcess(MapperUnderTest):
    """A mapper in another process, which ends with this object.

    Its parts may be read only while every observation is answered.

    Attributes:
        compile_seconds: time of the compiler there, once the process is ready.

    Args:
        config: mapper, seed and attitude of a run or of a log's map.
        look_ahead: whether a drive goes on while the mapper works.

    Raises:
        ConfigError: the mapper cannot be made.
        MapperError: the process cannot be started, or ended.
    """

    place: Place = "process"

    def __init__(self, config: RunConfig | MapConfig, *, look_ahead: bool = False) -> None:
        self.name, self._look_ahead, self.compile_seconds = config.mapper, look_ahead, 0.0
        self._pipe, far = Pipe()
        third_party = config.mapper in CLOUD_MAPPERS
        self._errors = TemporaryFile() if third_party else None  # noqa: SIM115 (it outlives this method)
        try:
            python = interpreter_of(config.mapper, config.mapper_python)
            self._process = _start_process(far, python, self._errors)
        except OSError as error:
            raise MapperError(f"mapper {config.mapper!r}: its process cannot be started ({error})") from error
        finally:
            far.close()
        self._end = finalize(self, _end, self._process, self._pipe)
        self._given: list[SensorReadings] = []
        self._answers: deque[Estimate | Exception] = deque()
        self._sent = 0
        try:
            self._send("make", MapperSpec(config.mapper, config.seed, config.attitude, config.parameters))
            self.reads_clouds, self.requires_odometry, self.reads_inertial = self._reply()
            self._send("warm_up")
        except BaseException:
            self._end()  # a traceback may keep this object for long
            raise

    def wait_until_ready(self) -> None:
        """Wait until the mapper's kernels are compiled.

        Raises:
            MapperError: the process ended.
        """
        self.compile_seconds = self._reply()

    def observe(self, observation: Observation | SensorReadings) -> Estimate:
        """Give the mapper an observation; wait for its estimate (see `MapperUnderTest`)."""
        self._give(observation)
        return self._answer()

    def follow(
        self, ticks: Iterator[Tick], may_go_ahead: Callable[[Sequence[Tick]], bool]
    ) -> Iterator[tuple[Tick, Estimate]]:
        """Yield each tick with its estimate; drive the simulation ahead while the mapper works."""
        if not self._look_ahead:
            yield from super().follow(ticks, may_go_ahead)
            return
        pending: deque[Tick] = deque()
        failure: Exception | None = None
        while True:
            if not pending and failure is not None:
                raise failure
            if not pending:
                pending.append(next(ticks))
                self._give(pending[-1].observation)
            while failure is None and not self._answered and may_go_ahead(pending):
                try:
                    pending.append(next(ticks))
                    self._give(pending[-1].observation)
                except Exception as error:
                    if is_interrupt(error):
                        raise
                    failure = error  # is raised when its turn comes
            begun = time.perf_counter()
            estimate = self._answer()
            yield pending.popleft(), replace(estimate, waited=time.perf_counter() - begun)

    def restart(self) -> None:
        """Make a new mapper; its cost counts from now on."""
        self._request("restart")

    def cost(self) -> Cost:
        """Return the cost of the process since `restart`."""
        cost: Cost = self._request("cost")
        return cost

    def close(self) -> None:
        """End the process; a mapper that is at work is interrupted."""
        self._end()

    @property
    def _answered(self) -> bool:
        """Whether the next answer is there, or none will come."""
        return bool(self._answers) or self._pipe.closed or (self._sent > 0 and self._pipe.poll())

    def _ask(self, part: str) -> Any:
        return self._request("ask", part)

    def _request(self, name: str, *arguments: Any) -> Any:
        at_work = self._given or self._sent or self._answers
        assert not at_work, "a mapper at work is asked nothing"
        self._send(name, *arguments)
        return self._reply()

    def _give(self, observation: Observation | SensorReadings) -> None:
        """Queue the readings that the mapper takes; send a full batch."""
        o = observation
        scan, cloud = (None, o.cloud) if self.reads_clouds else (o.scan, None)
        inertial = o.inertial if self.reads_inertial else None
        self._given.append(SensorReadings(scan, o.odometry, o.imu, cloud, inertial))
        if len(self._given) >= BATCH:
            self._flush()

    def _flush(self) -> None:
        """Send the queued readings."""
        self._send("observe", self._given)
        self._sent += 1
        self._given.clear()

    def _answer(self) -> Estimate:
        """Wait for the mapper's next answer.

        Raises:
            MapperError: the mapper failed, or its process ended.
        """
        if not self._answers:
            if not self._sent:
                self._flush()
            estimates, error = self._reply()
            self._sent -= 1
            self._answers.extend(estimates if error is None else [*estimates, error])
        found = self._answers[0]
        if isinstance(found, Exception):  # which it stays
            raise found
        self._answers.popleft()
        return found

    def _send(self, name: str, *arguments: Any) -> None:
        try:
            self._pipe.send_bytes(pickle.dumps((name, *arguments), 5))
        except OSError:
            self._raise_end()

    def _reply(self) -> Any:
        try:
            value, error = pickle.loads(self._pipe.recv_bytes())
        except (EOFError, OSError):
            self._raise_end()
        if error is not None:
            raise error
        return value

    def _raise_end(self) -> NoReturn:
        """Raise the error of a process that has ended."""
        self._end()
        code = self._process.returncode
        how = f"signal {signal.Signals(-code).name}" if code is not None and code < 0 else f"exit code {code}"
        memory = "; the system may have lacked memory" if how.endswith("SIGKILL") else ""
        raise MapperError(f"mapper {self.name!r}: its process ended ({how}{memory}){self._last_words()}")

    def _last_words(self) -> str:
        """Return the last line that a third-party system wrote to its standard error."""
        if self._errors is None:
            return ""
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").split("\n")
        written = [line.strip() for line in lines if line.strip()]
        return f": {written[-1]}" if written else ""


def _start_process(far: Connection, python: str | None, errors: IO[bytes] | None) -> subprocess.Popen[bytes]:
    """Start a process with one end of a pipe, protected from Ctrl-C.

    Args:
        far: end of the pipe.
        python: path of another interpreter; None = this one.
        errors: receives the standard error of a third-party system, whose output is dropped; None = ours.
    """
    handle = far.fileno()
    program = PROGRAM if python is None else ELSEWHERE + SERVE
    folders = {name: [str(Path(str(sys.modules[name].__file__)).parents[1])] for name in OURS}
    program = program.format(argv=sys.argv, path=sys.path, handle=handle, parent=os.getpid(), folders=folders)
    options: dict[str, Any] = {"pass_fds": (handle,), "start_new_session": True}
    if sys.platform == "win32":
        os.set_handle_inheritable(handle, True)
        inherited = subprocess.STARTUPINFO(lpAttributeList={"handle_list": [handle]})
        options = {"startupinfo": inherited, "creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    if errors is not None:
        options |= {"stdout": subprocess.DEVNULL, "stderr": errors}
    command = [python or sys.executable, "-c", program]
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, **options)


def _end(process: subprocess.Popen[bytes], pipe: Connection) -> None:
    """End a process.

    An idle one ends by itself; a working one is interrupted, and killed in the end.
    """
    pipe.close()
    for end, patience in ((process.terminate, IDLE_END), (process.kill, PATIENCE)):
        with suppress(subprocess.TimeoutExpired):
            process.wait(patience)
            return
        end()
    process.wait()


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
            value, failure = None, None
            try:
                value = getattr(server, name)(*arguments)
            except Exception as error:
                failure = _sendable(error)
            pipe.send_bytes(pickle.dumps((value, failure), 5))
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


class _Server:
    """A run's mapper; each method is a request."""

    def make(self, spec: MapperSpec) -> tuple[bool, bool, bool]:
        """Make the mapper; return whether it reads clouds, requires odometry, and reads all of the IMU."""
        self._name, self._meter = spec.mapper, CostMeter()
        make = partial(mapper_named, spec.mapper, spec.seed, spec.parameters)
        self._mapper = MapperUnderTest(make, spec.mapper, spec.attitude)
        mapper = self._mapper
        return mapper.reads_clouds, mapper.requires_odometry, mapper.reads_inertial

    def warm_up(self) -> float:
        """Compile the mapper's kernels; return the seconds that the compiler took."""
        with compile_timer() as compile_seconds:
            warm_up_mapper(self._name)
        return compile_seconds()

    def restart(self) -> None:
        """Make a new mapper, and measure its cost."""
        self._mapper.restart()
        self._meter = CostMeter()

    def observe(self, batch: Sequence[SensorReadings]) -> tuple[list[Estimate], Exception | None]:
        """Give the mapper some readings; return its estimates and the error that stopped it."""
        estimates: list[Estimate] = []
        for readings in batch:
            try:
                estimates.append(self._mapper.observe(readings))
            except Exception as error:
                return estimates, _sendable(error)
        return estimates, None

    def ask(self, part: str) -> Any:
        """Return a part of the mapper (see `MapperUnderTest`)."""
        value = getattr(self._mapper, part)
        return value() if part in METHODS else value

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
