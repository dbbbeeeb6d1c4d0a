"""The lines of a CARMEN log, one message each: `NAME contents ipc_stamp host logger_stamp`."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lirs_wct.arrays import Float32Array
from lirs_wct.errors import SourceError
from lirs_wct.files import read_gzipped
from lirs_wct.geometry.pose import Pose2

BINARY_TEST = 65_536
"""Bytes that are searched for a zero byte, which text does not contain."""
AFTER_STAMP = 2
"""Tokens that may follow a stamp: host and logger's stamp."""


@dataclass(frozen=True, slots=True)
class LaserConfig:
    """Beams of a laser message: first angle and increment, radians; largest range, meters."""

    start: float
    step: float
    most: float


@dataclass(frozen=True, slots=True)
class Message:
    """A usable line.

    Attributes:
        line: line number, from 0.
        stamp: `ipc_stamp`, seconds.
        base: `T_odom_base`; None where the message holds none.
        laser: `T_odom_laser`; None where the message holds none.
        ranges: (n,) meters, as logged; empty where the message holds none.
        config: beams as the message states them; None where it states none.
    """

    line: int
    stamp: float
    base: Pose2 | None
    laser: Pose2 | None = None
    ranges: Float32Array = field(default_factory=lambda: np.empty(0, np.float32))
    config: LaserConfig | None = None


Lines = dict[str, list[tuple[int, str]]]
"""Line numbers and lines by message name."""


def read_lines(path: Path) -> Lines:
    """Read the lines of a log, gzipped or not, without empty lines and comments.

    Raises:
        SourceError: it cannot be read, is a damaged gzip file, or is not text.
    """
    data = read_gzipped(path)
    if b"\0" in data[:BINARY_TEST]:
        raise SourceError(f"{path}: not a text file, a CARMEN log is one")
    lines: Lines = {}
    # Comments may be in any encoding; numbers and names are ASCII in all of them.
    for number, line in enumerate(data.decode("latin-1").split("\n")):
        name = line.split(None, 1)[:1]
        if name and not name[0].startswith("#"):
            lines.setdefault(name[0], []).append((number, line))
    return lines


def messages_of(name: str, lines: Sequence[tuple[int, str]], skipped: Counter[str]) -> list[Message]:
    """Parse the lines of one message name; count unusable lines by reason."""
    parse, found = PARSERS[name], []
    for number, line in lines:
        try:
            message = parse(line.split(), number)
        except (ValueError, IndexError):
            skipped[f"{name} cut off or malformed"] += 1
            continue
        if _finite(message):
            found.append(message)
        else:
            skipped[f"{name} whose stamp or pose is not finite"] += 1
    return found


def parameters_of(lines: Sequence[tuple[int, str]]) -> dict[str, float]:
    """Return the numeric values of `PARAM name value` lines."""
    found = {}
    for _, line in lines:
        try:
            name, value = line.split()[1:3]
            found[name] = float(value)
        except ValueError:
            continue
    return found


def _odom(tokens: list[str], line: int) -> Message:
    """`ODOM x y theta tv rv accel stamp`."""
    return Message(line, _stamp(tokens, 7), _pose(tokens[1:4]))


def _old_laser(tokens: list[str], line: int) -> Message:
    """`FLASER n r... x y theta odom_x odom_y odom_theta stamp`: the laser's pose and the base's."""
    n = _count(tokens[1])
    rest = tokens[2 + n :]
    return Message(line, _stamp(rest, 6), _pose(rest[3:6]), _pose(rest[:3]), _ranges(tokens[2 : 2 + n]))


def _raw_laser(tokens: list[str], line: int) -> Message:
    """`RAWLASER1 type start fov step max accuracy remission n r... m rem... stamp`."""
    ranges, config, rest = _new_laser(tokens, 1)
    return Message(line, _stamp(rest, 0), None, None, ranges, config)


def _robot_laser(tokens: list[str], line: int) -> Message:
    """`ROBOTLASER1 (as RAWLASER1) laser_x y theta robot_x y theta tv rv forward side turn stamp`."""
    ranges, config, rest = _new_laser(tokens, 12)
    return Message(line, _stamp(rest, 11), _pose(rest[3:6]), _pose(rest[:3]), ranges, config)


def _new_laser(tokens: list[str], tail: int) -> tuple[Float32Array, LaserConfig, list[str]]:
    """Return ranges, config and the tokens after the remissions (`tail` or a few more)."""
    start, fov, step, most = map(float, tokens[2:6])
    n = _count(tokens[8])
    rest = tokens[9 + n :]
    if not tail <= len(rest) <= tail + AFTER_STAMP:  # else the remissions were left out with their number
        rest = rest[1 + _count(rest[0], least=0) :]
    if not (math.isfinite(start) and step > 0 and most > 0 and (n - 1) * step < math.tau + 1e-3):
        raise ValueError
    # Programs disagree whether the field of view ends at the last beam or one step behind it.
    if fov > 0 and abs(fov / step - n) > 1.5:
        raise ValueError
    return _ranges(tokens[9 : 9 + n]), LaserConfig(start, step, most), rest


def _stamp(rest: list[str], at: int) -> float:
    """Return the stamp; raise ValueError unless 0 to 2 tokens follow it."""
    if not 0 <= len(rest) - at - 1 <= AFTER_STAMP:
        raise ValueError
    return float(rest[at])


def _count(word: str, least: int = 1) -> int:
    n = int(word)
    if n < least:
        raise ValueError
    return n


def _pose(tokens: list[str]) -> Pose2:
    x, y, yaw = map(float, tokens)
    return Pose2(x, y, yaw)


def _ranges(tokens: list[str]) -> Float32Array:
    with np.errstate(over="ignore"):  # a range beyond float32 becomes infinite
        return np.array([*map(float, tokens)]).astype(np.float32)


def _finite(message: Message) -> bool:
    poses = [p for p in (message.base, message.laser) if p is not None]
    return math.isfinite(message.stamp) and all(
        math.isfinite(v) for pose in poses for v in (pose.x, pose.y, pose.yaw)
    )


PARSERS: dict[str, Callable[[list[str], int], Message]] = {
    "ODOM": _odom,
    "FLASER": _old_laser,
    "RLASER": _old_laser,
    "ROBOTLASER1": _robot_laser,
    "ROBOTLASER2": _robot_laser,
    "RAWLASER1": _raw_laser,
    "RAWLASER2": _raw_laser,
}
"""Parser of each message name."""
