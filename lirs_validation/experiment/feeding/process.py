"""A mapper in its own process: foreign code cannot reach the evaluation, and two threads drive faster."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections import deque
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, NoReturn
from weakref import finalize

from lirs_validation.config import MapConfig, RunConfig
from lirs_validation.experiment.cost import Cost
from lirs_validation.experiment.feeding.feeding import Answer, Place, update_arguments
from lirs_validation.experiment.feeding.packing import pack_updates, unpack_pose
from lirs_validation.experiment.mapper_loading import MapperSpec, MapperTraits
from lirs_wct.errors import MapperError
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.mapper import CLOUD_MAPPERS, MapperStats

if TYPE_CHECKING:
    from lirs_envs.sensing.sensors import Observation

BATCH = 8
"""Scans that are sent together; a message takes as long as a tenth of a tick."""
IDLE_END = 0.3
"""Seconds within which an idle process ends when its pipe is closed."""
PATIENCE = 1.0
"""Seconds that a mapper at work is given to tidy up before its process is killed."""
PROGRAM = (
    "import sys; sys.argv, sys.path[:] = {argv!r}, {path!r}; "
    "from lirs_validation.experiment.feeding.server import serve; serve({handle}, {parent})"
)
"""Of the process. Those of multiprocessing run the caller's script again, which then needs a guard."""


class MapperProcess:
    """Process that makes a mapper and is fed with scans; it ends with this object.

    It is a `Feeding` and a mapper. The methods of a mapper may be called only while every scan is answered.

    Attributes:
        reads_clouds: whether the mapper reads point clouds.
        requires_odometry: whether it needs odometry.
        compile_seconds: time of the compiler there, once the process is ready.

    Args:
        config: mapper, seed and attitude of a run or of a log's map.
        concurrent: whether the drive goes on while the mapper works.

    Raises:
        ConfigError: the mapper cannot be made.
        MapperError: the process cannot be started, or ended.
    """

    place: Place = "process"

    def __init__(self, config: RunConfig | MapConfig, *, concurrent: bool) -> None:
        self._concurrent, self.compile_seconds = concurrent, 0.0
        self._name = config.mapper
        self._pipe, far = Pipe()
        try:
            self._process = _start_process(far)
        except OSError as error:
            raise MapperError(f"mapper {config.mapper!r}: its process cannot be started ({error})") from error
        finally:
            far.close()
        self._end = finalize(self, _end, self._process, self._pipe)
        self._given: list[tuple[Any, ...]] = []
        self._answers: deque[Answer | Exception] = deque()
        self._sent = 0
        try:
            self._send("make", MapperSpec(config.mapper, config.seed, config.attitude))
            traits: MapperTraits = self._reply()
            self._send("warm_up")
        except BaseException:
            self._end()  # a traceback may keep this object for long
            raise
        self.reads_clouds, self.requires_odometry = traits.reads_clouds, traits.requires_odometry

    def wait_until_ready(self) -> None:
        """Wait until the mapper's kernels are compiled.

        Raises:
            MapperError: the process ended.
        """
        self.compile_seconds = self._reply()

    def begin(self) -> None:
        """Make a new mapper; its cost counts from now on."""
        self._request("begin")

    @property
    def ready(self) -> bool:
        """Whether to take the next answer now: it is there, none will come, or the drive waits for it."""
        if not self._concurrent or self._answers or self._pipe.closed:
            return True
        return self._sent > 0 and self._pipe.poll()

    def give(self, observation: Observation) -> None:
        """Hand over a scan (see `Feeding`)."""
        self._given.append(update_arguments(observation, clouds=self.reads_clouds))
        if len(self._given) >= BATCH:
            self._flush()

    def answer(self) -> Answer:
        """Wait for the mapper's next answer (see `Feeding`)."""
        if not self._answers:
            self._receive()
        found = self._answers[0]
        if isinstance(found, Exception):  # which it stays
            raise found
        self._answers.popleft()
        return found

    def close(self) -> None:
        """End the process; a mapper that is at work is interrupted."""
        self._end()

    def update(self, *update: Any) -> Any:
        """Feed the mapper; return its estimate (see `Mapper` and `CloudMapper`)."""
        self._given.append(update)
        return self.answer().estimate

    def map(self) -> OccupancyGrid:
        """Return the mapper's map."""
        return self._request("map")  # type: ignore[no-any-return]

    def trajectory(self) -> Trajectory:
        """Return the mapper's trajectory."""
        return self._request("trajectory")  # type: ignore[no-any-return]

    @property
    def stats(self) -> MapperStats:
        """Statistics of the mapper."""
        return self._request("stats")  # type: ignore[no-any-return]

    @property
    def lost(self) -> bool:
        """Whether the mapper does not know its place."""
        return self._request("lost")  # type: ignore[no-any-return]

    def cost(self) -> Cost:
        """Return the cost of the process since `begin`."""
        return self._request("cost")  # type: ignore[no-any-return]

    def _request(self, name: str) -> Any:
        assert self._idle, "a mapper at work is asked nothing"
        self._send(name)
        return self._reply()

    @property
    def _idle(self) -> bool:
        return not (self._given or self._sent or self._answers)

    def _flush(self) -> None:
        """Send the scans that were given."""
        self._send("update", pack_updates(self._given))
        self._sent += 1
        self._given.clear()

    def _receive(self) -> None:
        """Wait for the answers to a batch."""
        if not self._sent:
            self._flush()
        answers, error = self._reply()
        self._sent -= 1
        self._answers.extend(Answer(unpack_pose(pose), lost, seconds) for pose, lost, seconds in answers)
        if error is not None:
            self._answers.append(error)

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
        raise MapperError(f"mapper {self._name!r}: its process ended ({how}{memory})")


def needs_process(mapper: str) -> bool:
    """Whether a mapper is foreign code: `module:name`, or an adapter of a compiled system."""
    return ":" in mapper or mapper in CLOUD_MAPPERS


def start_mapper(config: RunConfig) -> MapperProcess | None:
    """Start the process of a run's mapper; None = it works in this one.

    Raises:
        ConfigError: the mapper cannot be made.
        MapperError: the process cannot be started.
    """
    if config.threads == 1 and not needs_process(config.mapper):
        return None
    return MapperProcess(config, concurrent=config.threads > 1)


def _start_process(far: Connection) -> subprocess.Popen[bytes]:
    """Start a process with one end of a pipe, protected from Ctrl-C."""
    handle = far.fileno()
    program = PROGRAM.format(argv=sys.argv, path=sys.path, handle=handle, parent=os.getpid())
    options: dict[str, Any] = {"pass_fds": (handle,), "start_new_session": True}
    if sys.platform == "win32":
        os.set_handle_inheritable(handle, True)
        inherited = subprocess.STARTUPINFO(lpAttributeList={"handle_list": [handle]})
        options = {"startupinfo": inherited, "creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.DEVNULL, **options)


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
