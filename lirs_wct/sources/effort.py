"""Memory and processor time that a world of a large picture takes, for refusals."""

from __future__ import annotations

import sys
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from lirs_wct.errors import TooLargeError
from lirs_wct.sources.options import BuildOptions, SourceKind


@dataclass(frozen=True)
class Effort:
    """Effort of `lirs-wct build` with its default formats, linear in the pixels.

    Fitted to `benchmarks/world.py --only large` on one core of an AMD EPYC.

    Attributes:
        memory: peak without pixels, bytes.
        memory_per_pixel: further bytes of each pixel.
        seconds: processor time without pixels.
        seconds_per_pixel: further processor time of each pixel.
    """

    memory: float
    memory_per_pixel: float
    seconds: float
    seconds_per_pixel: float

    def __call__(self, pixels: int) -> tuple[float, float]:
        """Return bytes and seconds of a picture."""
        return self.memory + self.memory_per_pixel * pixels, self.seconds + self.seconds_per_pixel * pixels


UNLIMITED = 1e18
"""Bytes where the free memory is unknown."""
TERRAIN = Effort(0.27e9, 12.1, 2.0, 0.14e-6)
MAP = Effort(0.32e9, 18.7, 4.0, 0.19e-6)
FULL_GRID = Effort(0.30e9, 213.0, 3.0, 2.5e-6)
ROUGH = Effort(0.27e9, 220.0, 2.0, 10e-6)
"""Effort of terrain that keeps nearly all pixels at the default largest error."""
SMALLER = {TERRAIN: "--crop or --resize", MAP: "--window", FULL_GRID: "--max-error above 0, or --crop"}
"""Options by which a source of each effort takes less."""


def effort_of(kind: SourceKind, options: BuildOptions) -> Effort:
    """Return the effort of a kind of source."""
    if kind in (SourceKind.MAP, SourceKind.MAP_PICTURE):
        return MAP
    return FULL_GRID if options.max_error == 0 else TERRAIN


def free_memory() -> float:
    """Return the available bytes of memory; Linux only."""
    free = UNLIMITED
    if sys.platform != "linux":
        return free
    with suppress(OSError, ValueError, IndexError):
        text = Path("/proc/meminfo").read_text(encoding="ascii")
        free = 1024.0 * int(text.split("MemAvailable:")[1].split()[0])
    with suppress(OSError, ValueError):  # "max" = no limit
        free = min(free, float(int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii"))))
    return free


def limit_to_memory(kind: SourceKind, options: BuildOptions) -> BuildOptions:
    """Return the options with pixels limited by the free memory.

    A part of a picture and a smaller copy take less than the estimate, and keep the limit.
    """
    if options.window or options.crop or options.resize:
        return options
    most = int(free_memory() / effort_of(kind, options).memory_per_pixel)
    return replace(options, max_pixels=max(1, min(options.max_pixels, most)))


def explain_refusal(error: TooLargeError, kind: SourceKind, options: BuildOptions) -> TooLargeError:
    """Return a refusal with the effort of the picture, and the option that helps."""
    effort = effort_of(kind, options)
    memory, seconds = effort(error.pixels)
    takes = f"about {memory / 1e9:.2g} GB of memory and {seconds:.0f} s of processor time"
    if effort is TERRAIN:
        memory, seconds = ROUGH(error.pixels)
        takes += f", up to {memory / 1e9:.2g} GB and {seconds:.0f} s if it is rough or has 8 bits"
    free = f"{free_memory() / 1e9:.2g} GB are free"
    if error.pixels > options.max_pixels:
        reason = f"{error.reason}; --max-pixels {error.pixels} allows it and takes {takes} ({free})"
    else:
        reason = f"which take {takes}, but {free}: give {SMALLER[effort]}"
    return TooLargeError(error.size, error.pixels, reason)
