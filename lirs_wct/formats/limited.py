"""Files that compiled libraries read: in a process with limits of time and memory."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from threading import Timer
from time import monotonic
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import SourceError

SECONDS, SECONDS_PER_BYTE, WAIT = 5.0, 4e-6, 4
"""Limit of CPU seconds in all threads: a constant, and per byte. The wall time may be WAIT times that."""
MEMORY, MEMORY_PER_BYTE = 512 << 20, 200
"""Memory limit of a file in bytes; a LAZ file unpacks to some ten times its size, seldom to fifty times."""
PIXEL_BYTES = 20
"""Memory per pixel, bytes: two 64-bit numbers and a mask."""
THREADS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "RAYON_NUM_THREADS": "4"}
"""Each thread's stack counts as memory."""
PROGRAM = Path(__file__).with_name("reader_process.py")


def read_limited(
    kind: Literal["raster", "las", "pcd"], path: Path, max_pixels: int = 0
) -> tuple[dict[str, Any], list[NDArray[Any]]]:
    """Return what the process reads: values by name, and arrays.

    Args:
        kind: of the reader.
        path: file that is there; its size scales the limits.
        max_pixels: a raster of more pixels is described without them.

    Raises:
        SourceError: the file cannot be read, or its reader exceeded a limit.
    """
    size = path.stat().st_size
    seconds = round(SECONDS + SECONDS_PER_BYTE * size)
    memory = MEMORY + MEMORY_PER_BYTE * size + PIXEL_BYTES * max_pixels
    process = subprocess.Popen(
        [sys.executable, str(PROGRAM), kind]
        + [str(value) for value in (path.resolve(), max_pixels, memory, seconds)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, **THREADS, "PYTHONSAFEPATH": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    timer, began = Timer(WAIT * seconds, process.kill), monotonic()
    timer.start()
    try:
        answer = _receive(process)
    finally:
        timer.cancel()
        process.kill()
    if answer is None:
        ending = _ending(process.returncode)
        late = monotonic() - began >= WAIT * seconds or ending.endswith("SIGXCPU")
        reason = f"takes more than {seconds} s" if late else ending
        raise SourceError(f"{path}: cannot be read: its reader {reason}")
    found, arrays = answer
    if "error" in found:
        raise SourceError(f"{path}: {found['error'].replace(str(path.resolve()), path.name)}")
    return found, arrays


def _receive(process: subprocess.Popen[bytes]) -> tuple[dict[str, Any], list[NDArray[Any]]] | None:
    """Return the answer of a process; None where it ended without one."""
    assert process.stdout is not None
    arrays: list[NDArray[Any]] = []
    with process, process.stdout as pipe:
        line = pipe.readline()
        if not line.endswith(b"\n"):
            return None
        found: dict[str, Any] = json.loads(line)
        for kind, shape in found.pop("arrays"):
            array: NDArray[Any] = np.empty(shape, kind)
            if pipe.readinto(array.reshape(-1).view(np.uint8).data) != array.nbytes:  # type: ignore[attr-defined]
                return None
            arrays.append(array)
    return found, arrays


def _ending(code: int) -> str:
    return f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
