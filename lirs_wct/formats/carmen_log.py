"""Reading of CARMEN logs (.clf, .log, also gzipped): laser scans with the robot's odometry.

A line is a message: `NAME contents ipc_stamp host logger_stamp`. The reader uses ODOM, PARAM and the messages
of one laser: FLASER, ROBOTLASER1 or RAWLASER1. A log of only the rear laser has RLASER, ROBOTLASER2 or
RAWLASER2. Other messages are counted, not kept.
"""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.files import read_gzipped
from lirs_wct.formats.laser_log import (
    MAX_DELAY,
    LaserConfig,
    LaserLog,
    LogTopic,
    Message,
    in_file_order,
    odometry_of,
)
from lirs_wct.formats.range_codes import NO_RETURN, RANGE_MIN, no_return, usual_reading
from lirs_wct.geometry import Float32Array, LaserScan, Pose2, Pose3


def read_carmen(path: Path, *, fov: float | None = None, range_max: float | None = None) -> LaserLog:
    """Read a CARMEN log; skip and count unusable lines.

    The order of the file stays. Stamps that go back or repeat while the robot moves are repaired; a warning
    states their number. Field of view, radians, and largest range, meters, are by default the log's.
    """
    lines = read_lines(path)
    skipped, repaired = Counter[str](), Counter[str]()
    for name in lines.keys() - PARSERS.keys() - {"PARAM"}:
        skipped[f"message {name[:20]}" if name.isidentifier() else "not a message"] += len(lines[name])
    odoms = messages_of("ODOM", lines.get("ODOM", ()), skipped)
    laser, read = _lasers(lines, skipped)
    if not read:
        reasons = ", ".join(f"{count} x {why}" for why, count in skipped.most_common(5))
        said = f"; skipped: {reasons}" if skipped else ""
        raise SourceError(f"{path}: no usable laser scan (FLASER, ROBOTLASER1, ...) in this CARMEN log{said}")
    scans, odoms, stamps = in_file_order(read, odoms)
    if back := int((np.diff(stamps.logged) < -MAX_DELAY).sum()):
        what = f"its clock goes back {back} times by more than {MAX_DELAY:g} s: its times are wrong"
        warnings.warn(f"{path}: {what}", stacklevel=2)
    if stamps.moved:
        warnings.warn(f"{path}: {stamps.summary()}", stacklevel=2)
    parameters = dict[str, float]()
    for _, line in lines.get("PARAM", ()):
        with suppress(ValueError):
            name, value = line.split()[1:3]
            parameters[name] = float(value)
    odometry, track = odometry_of(scans, odoms)
    try:
        decoded = scans_of(laser, scans, parameters, repaired, fov, range_max)
    except ConfigError as error:
        raise SourceError(f"{path}: {error}") from error
    return LaserLog(
        tuple(decoded),
        tuple(odometry),
        track,
        stamps,
        skipped=dict(skipped),
        late=int((stamps.logged < np.maximum.accumulate(stamps.logged)).sum()),
        repaired=dict(repaired),
        laser=laser,
        topics=(LogTopic(laser, (), np.array([m.stamp for m in read]), np.empty(0)),),
        left_out=len(lines[laser]) - len(decoded),
    )


def _lasers(lines: Lines, skipped: Counter[str]) -> tuple[str, list[Message]]:
    """Return the scans of one laser with the most frequent number of beams, and the name of its messages.

    Front lasers come before rear ones, messages with poses before those without, then the most frequent.
    """
    names = sorted(
        (name for name in lines if name in PARSERS and name != "ODOM"),
        key=lambda name: (name in REAR, name.startswith("RAW"), -len(lines[name])),
    )
    for k, name in enumerate(names):
        messages = messages_of(name, lines[name], skipped)
        if messages:
            for other in names[k + 1 :]:
                skipped[f"{other} beside {name}"] += len(lines[other])
            (beams, _), *others = Counter(len(m.ranges) for m in messages).most_common()
            for size, count in others:
                skipped[f"{name} of {size} beams where the log's have {beams}"] += count
            return name, [m for m in messages if len(m.ranges) == beams]
    return "", []


AFTER_STAMP = 2
"""Tokens that may follow a stamp: host and logger's stamp."""
Lines = dict[str, list[tuple[int, str]]]
"""Line numbers and lines by message name."""


def read_lines(path: Path) -> Lines:
    """Read the lines of a log, gzipped or not, without empty lines and comments."""
    data = read_gzipped(path)
    if b"\0" in data[:65_536]:
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
    parse, messages = PARSERS[name], []
    for number, line in lines:
        try:
            message = parse(line.split(), number)
        except (ValueError, IndexError):
            skipped[f"{name} cut off or malformed"] += 1
            continue
        poses = [pose for pose in (message.base, message.laser) if pose is not None]
        if all(map(math.isfinite, (message.stamp, *(v for p in poses for v in (p.x, p.y, p.yaw))))):
            messages.append(message)
        else:
            skipped[f"{name} whose stamp or pose is not finite"] += 1
    return messages


def _old_laser(tokens: list[str], line: int) -> Message:
    """`FLASER n r... x y theta odom_x odom_y odom_theta stamp`: the laser's pose and the base's."""
    n = _count(tokens[1])
    rest = tokens[2 + n :]
    return Message(line, _stamp(rest, 6), _pose(rest[3:6]), _pose(rest[:3]), _ranges(tokens[2 : 2 + n]))


def _new_laser(tokens: list[str], line: int) -> Message:
    """`RAWLASER1 type start fov step max accuracy remission n r... m rem... stamp`.

    `ROBOTLASER1` has laser_x y theta robot_x y theta tv rv forward side turn before the stamp.
    """
    start, fov, step, most = map(float, tokens[2:6])
    n, tail = _count(tokens[8]), 12 if tokens[0].startswith("ROBOT") else 1
    rest = tokens[9 + n :]
    if not tail <= len(rest) <= tail + AFTER_STAMP:  # else the remissions were left out with their number
        rest = rest[1 + _count(rest[0], least=0) :]
    if not (math.isfinite(start) and step > 0 and most > 0 and (n - 1) * step < math.tau + 1e-3):
        raise ValueError
    # Programs disagree whether the field of view ends at the last beam or one step behind it.
    if fov > 0 and abs(fov / step - n) > 1.5:
        raise ValueError
    base, laser = (_pose(rest[3:6]), _pose(rest[:3])) if tail > 1 else (None, None)
    config = LaserConfig(start, step, most)
    return Message(line, _stamp(rest, tail - 1), base, laser, _ranges(tokens[9 : 9 + n]), config)


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


PARSERS: dict[str, Callable[[list[str], int], Message]] = {
    # ODOM x y theta tv rv accel stamp
    "ODOM": lambda tokens, line: Message(line, _stamp(tokens, 7), _pose(tokens[1:4])),
    "FLASER": _old_laser,
    "RLASER": _old_laser,
    **dict.fromkeys(("ROBOTLASER1", "ROBOTLASER2", "RAWLASER1", "RAWLASER2"), _new_laser),
}
"""Parser of each message name."""


SICK_INVALID = (81.87, 81.88, 81.89, 81.90, 81.91)
"""Codes of the SICK LMS for "no valid measurement" (dazzled, too noisy), read as NaN, meters."""
FIELDS = {
    **dict.fromkeys((180, 181, 360, 361), 180.0),
    **dict.fromkeys((101, 201, 401), 100.0),
    **dict.fromkeys((540, 541, 1080, 1081), 270.0),
}
"""Field of view of the usual lasers by their number of beams, degrees."""
REAR = ("RLASER", "ROBOTLASER2", "RAWLASER2")
"""Messages of the rear laser."""
MOUNT_SPREAD = 0.05
"""Largest deviation of the mounts from their median, meters and radians."""
MOUNT_REACH = 3.0
"""Largest distance of a laser from its base, meters."""


def scans_of(
    name: str,
    messages: Sequence[Message],
    parameters: Mapping[str, float],
    repaired: Counter[str],
    fov: float | None,
    range_max: float | None,
) -> list[LaserScan]:
    """Return the scans of messages with equal numbers of beams.

    Their `range_max` is the laser's reading for no return (81.83 m of a SICK). Without such a reading, it is
    the largest range that the message or the user states.
    """
    n = len(messages[0].ranges)
    ranges = np.stack([m.ranges for m in messages])
    smallest_code = no_return(ranges)
    limit = range_max or smallest_code
    if range_max is None and limit < NO_RETURN:
        codes = int(((ranges >= limit) & (ranges < NO_RETURN)).sum())
        repaired[f"readings of {limit:.2f} m or more, a code for no return"] = codes
    mount = _mount(name, messages, parameters, repaired)
    field = None if fov is None else _config(n, fov)
    decoded = _decode_ranges(ranges)
    code = usual_reading(decoded[decoded >= max(smallest_code, limit)])
    scans = []
    for message, meant in zip(messages, decoded, strict=True):
        config = field or message.config or _usual_config(name, n, parameters)
        logged = NO_RETURN if message.config is None else message.config.range_max
        # A code within a centimeter of the largest range equals that range; shorter ranges are hits.
        most = logged if logged - limit <= 0.01 else limit
        r = np.where(meant >= most, np.float32(np.inf), meant)
        farthest = most if code is None else code
        scans.append(LaserScan(r, config.start, config.step, RANGE_MIN, farthest, message.stamp, mount))
    return scans


def _decode_ranges(ranges: Float32Array) -> Float32Array:
    """Convert codes to REP 117: NaN = invalid, -inf = too near."""
    invalid = np.zeros(ranges.shape, np.bool_)
    for code in SICK_INVALID:
        invalid |= np.abs(ranges - np.float32(code)) < 1e-3
    decoded = np.where(ranges < RANGE_MIN, np.float32(-np.inf), ranges)
    decoded[invalid] = np.nan
    return decoded


def _usual_config(name: str, n: int, parameters: Mapping[str, float]) -> LaserConfig:
    """Return the usual beam geometry for a number of beams, else that of PARAM lines."""
    if n in FIELDS:
        return _config(n, math.radians(FIELDS[n]))
    side = "rear" if name in REAR else "front"
    resolution = parameters.get(f"laser_{side}_laser_resolution", 0.0)
    fov = resolution * (n - n % 2)
    if not 0 < fov <= 360:
        raise ConfigError(
            f"{name} messages of {n} beams do not say how wide they see: give it (lirs-wct map --fov DEG)"
        )
    return _config(n, math.radians(fov))


def _config(n: int, fov: float) -> LaserConfig:
    """Spread beams over a field of view; an even number omits the last direction (180: -90..+89 deg)."""
    return LaserConfig(-fov / 2, fov / max(n - n % 2, 1), math.inf)


def _mount(
    name: str, messages: Sequence[Message], parameters: Mapping[str, float], repaired: Counter[str]
) -> Pose3:
    """Return `T_base_laser` from the two logged poses, which are rounded, else from PARAM lines."""
    mounts = [m.base.inverse() @ m.laser for m in messages if m.base is not None and m.laser is not None]
    mount = _steady_mount(mounts) if mounts else Pose2()
    if mount is None:
        why = "laser poses that do not follow the odometry: the laser is taken to be at the base"
        repaired[why] = len(mounts)
    elif max(abs(mount.x), abs(mount.y), abs(mount.yaw)) >= 1e-3:
        return Pose3.from_pose2(mount)
    side, yaw = ("rear", math.pi) if name in REAR else ("front", 0.0)
    offset = parameters.get(f"robot_{side}laser_offset", 0.0)
    usable = abs(offset) < MOUNT_REACH
    return Pose3.from_pose2(Pose2(offset if usable else 0.0, 0.0, yaw)) if offset or yaw else Pose3()


def _steady_mount(mounts: Sequence[Pose2]) -> Pose2 | None:
    """Return the median mount; None if most mounts differ from it (a corrected pose)."""
    x, y = (float(np.median([getattr(m, key) for m in mounts])) for key in ("x", "y"))
    yaws = np.array([m.yaw for m in mounts])
    yaw = float(math.atan2(np.median(np.sin(yaws)), np.median(np.cos(yaws))))
    off = [max(math.hypot(m.x - x, m.y - y), abs(math.remainder(m.yaw - yaw, math.tau))) for m in mounts]
    steady = float(np.median(off)) <= MOUNT_SPREAD and math.hypot(x, y) <= MOUNT_REACH
    return Pose2(x, y, yaw) if steady else None
