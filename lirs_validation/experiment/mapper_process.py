"""A mapper in its own process: foreign code cannot reach the evaluation."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import traceback
from contextlib import suppress
from functools import partial
from multiprocessing import Pipe
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any, NoReturn
from weakref import finalize

from lirs_validation.experiment.cost import Cost, CostMeter, compile_timer
from lirs_validation.experiment.mapper_loading import interpreter_of, mapper_named, warm_up_mapper
from lirs_validation.experiment.mapper_under_test import METHODS, Estimate, MapperUnderTest, SensorReadings
from lirs_validation.interrupts import end_group, end_with
from lirs_wct.errors import MapperError, WctError
from slam_baselines.mapper import CLOUD_MAPPERS

if sys.platform == "win32":
    from multiprocessing.connection import PipeConnection as Connection
else:
    from multiprocessing.connection import Connection

if TYPE_CHECKING:
    from lirs_envs.sensing.sensors import Observation
    from lirs_validation.config import Attitude, RunConfig
    from lirs_validation.map_config import MapConfig

IDLE_END = 0.3
"""Seconds within which an idle process ends when its pipe is closed."""
PATIENCE = 1.0
"""Seconds that a mapper at work is given to tidy up before its process is killed."""
SERVE = "from lirs_validation.experiment.mapper_process import serve; serve({handle}, {parent})"
HERE = "import sys; sys.argv, sys.path[:] = {argv!r}, {path!r}; " + SERVE
ELSEWHERE = "import sys; sys.argv = {argv!r}; " + SERVE
"""Programs of the process, with this interpreter and with another one, which has modules of its own.

Those of multiprocessing run the caller's script again, which then needs a guard.
"""


def needs_process(mapper: str) -> bool:
    """Whether a mapper is foreign code: `module:name`, or an adapter of a compiled system."""
    return ":" in mapper or mapper in CLOUD_MAPPERS


def start_mapper(config: RunConfig) -> MapperUnderTest:
    """Return the mapper of a run.

    It has its own process if it is foreign code.

    Raises:
        ConfigError: the mapper cannot be made.
        MapperError: the process cannot be started.
    """
    if needs_process(config.mapper):
        return MapperProcess(config)
    make = partial(mapper_named, config.mapper, config.seed, config.parameters)
    return MapperUnderTest(make, config.mapper, config.attitude)


class MapperProcess(MapperUnderTest):
    """A mapper in another process, which ends with this object.

    Attributes:
        compile_seconds: time of the compiler there, once the process is ready.

    Args:
        config: mapper, seed and attitude of a run or of a log's map.

    Raises:
        ConfigError: the mapper cannot be made.
        MapperError: the process cannot be started, or ended.
    """

    in_process = True

    def __init__(self, config: RunConfig | MapConfig) -> None:
        self.name, self.compile_seconds = config.mapper, 0.0
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
        try:
            self._send("make", config.mapper, config.seed, config.parameters, config.attitude)
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
        o = observation
        scan, cloud = (None, o.cloud) if self.reads_clouds else (o.scan, None)
        inertial = o.inertial if self.reads_inertial else None
        estimate: Estimate = self._request(
            "observe", SensorReadings(scan, o.odometry, o.imu, cloud, inertial)
        )
        return estimate

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

    def _ask(self, part: str) -> Any:
        return self._request("ask", part)

    def _request(self, name: str, *arguments: Any) -> Any:
        self._send(name, *arguments)
        return self._reply()

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
    program = HERE if python is None else ELSEWHERE
    program = program.format(argv=sys.argv, path=sys.path, handle=handle, parent=os.getpid())
    options: dict[str, Any] = {"pass_fds": (handle,), "start_new_session": True}
    if sys.platform == "win32":
        os.set_handle_inheritable(handle, True)
        inherited = subprocess.STARTUPINFO(lpAttributeList={"handle_list": [handle]})
        options = {"startupinfo": inherited, "creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    if errors is not None:
        options |= {"stdout": subprocess.DEVNULL, "stderr": errors}
    command = [sys.executable] if python is None else [python, "-P"]  # without the current folder
    return subprocess.Popen([*command, "-c", program], stdin=subprocess.DEVNULL, **options)


def _end(process: subprocess.Popen[bytes], pipe: Connection) -> None:
    """End a process and those that it started.

    An idle one ends by itself; a working one is interrupted, and killed in the end.
    """
    pipe.close()
    for end, patience in ((process.terminate, IDLE_END), (process.kill, PATIENCE), (lambda: None, None)):
        with suppress(subprocess.TimeoutExpired):
            process.wait(patience)
            break
        end()
    end_group(process.pid)


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


class _Server:
    """A run's mapper; each method is a request."""

    def make(self, name: str, seed: int, parameters: str, attitude: Attitude) -> tuple[bool, bool, bool]:
        """Make the mapper; return whether it reads clouds, requires odometry, and reads all of the IMU."""
        self._name, self._meter = name, CostMeter()
        self._mapper = MapperUnderTest(partial(mapper_named, name, seed, parameters), name, attitude)
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

    def observe(self, readings: SensorReadings) -> Estimate:
        """Give the mapper some readings; return its estimate."""
        return self._mapper.observe(readings)

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
