"""CARMEN logs (.clf, .log, also gzipped): laser scans with the robot's odometry.

The reader uses ODOM, PARAM and the messages of one laser: FLASER, ROBOTLASER1 or RAWLASER1. A log of only the
rear laser has RLASER, ROBOTLASER2 or RAWLASER2. Other messages are counted, not kept.
"""

from __future__ import annotations

import warnings
from collections import Counter
from pathlib import Path

import numpy as np

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.carmen.laser import REAR, scans_of
from lirs_wct.formats.carmen.lines import PARSERS, Lines, Message, messages_of, parameters_of, read_lines
from lirs_wct.formats.carmen.repairs import LEAP, in_file_order, odometry_of
from lirs_wct.formats.laser_log import LaserLog, LogTopic

REASONS = 5
"""Number of reasons that an error lists."""


def read_carmen(path: Path, *, fov: float | None = None, range_max: float | None = None) -> LaserLog:
    """Read a CARMEN log; skip and count unusable lines.

    The order of the file stays. Stamps that go back or repeat while the robot moves are repaired; a warning
    states their number.

    Args:
        path: of the log.
        fov: Field of view, radians, centered on the laser's x axis; None = from the log.
        range_max: Ranges from here on are no return, meters; None = from the log.

    Raises:
        SourceError: the file cannot be read, is not text, or holds no usable laser scan.
    """
    lines = read_lines(path)
    skipped, repaired = Counter[str](), Counter[str]()
    for name in lines.keys() - PARSERS.keys() - {"PARAM"}:
        skipped[f"message {name[:20]}" if name.isidentifier() else "not a message"] += len(lines[name])
    odoms = messages_of("ODOM", lines.get("ODOM", ()), skipped)
    laser, read = _lasers(lines, skipped)
    if not read:
        raise SourceError(
            f"{path}: no usable laser scan (FLASER, ROBOTLASER1, ...) in this CARMEN log{_reasons(skipped)}"
        )
    scans, odoms, stamps = in_file_order(read, odoms)
    if back := int((np.diff(stamps.logged) < -LEAP).sum()):
        what = f"its clock goes back {back} times by more than {LEAP:g} s: its times are wrong"
        warnings.warn(f"{path}: {what}", stacklevel=2)
    if stamps.moved:
        warnings.warn(f"{path}: {stamps.summary()}", stacklevel=2)
    parameters = parameters_of(lines.get("PARAM", ()))
    odometry, track = odometry_of([m.stamp for m in scans], scans, odoms)
    try:
        found = scans_of(laser, scans, parameters, repaired, fov, range_max)
    except ConfigError as error:
        raise SourceError(f"{path}: {error}") from error
    return LaserLog(
        tuple(found),
        tuple(odometry),
        track,
        stamps,
        skipped=dict(skipped),
        late=int((stamps.logged < np.maximum.accumulate(stamps.logged)).sum()),
        repaired=dict(repaired),
        laser=laser,
        topics=(LogTopic(laser, (), np.array([m.stamp for m in read]), np.empty(0)),),
        left_out=len(lines[laser]) - len(found),
    )


def _lasers(lines: Lines, skipped: Counter[str]) -> tuple[str, list[Message]]:
    """Return the messages of one laser: front before rear, with poses before without, most frequent."""
    names = sorted(
        (name for name in lines if name in PARSERS and name != "ODOM"),
        key=lambda name: (name in REAR, name.startswith("RAW"), -len(lines[name])),
    )
    for k, name in enumerate(names):
        messages = messages_of(name, lines[name], skipped)
        if messages:
            for other in names[k + 1 :]:
                skipped[f"{other} beside {name}"] += len(lines[other])
            return name, _of_one_size(name, messages, skipped)
    return "", []


def _of_one_size(name: str, messages: list[Message], skipped: Counter[str]) -> list[Message]:
    """Keep the scans with the most frequent number of beams."""
    sizes = Counter(len(m.ranges) for m in messages)
    usual = sizes.most_common(1)[0][0]
    for size, count in sizes.items():
        if size != usual:
            skipped[f"{name} of {size} beams where the log's have {usual}"] += count
    return [m for m in messages if len(m.ranges) == usual]


def _reasons(skipped: Counter[str]) -> str:
    if not skipped:
        return ""
    listed = ", ".join(f"{n} x {why}" for why, n in skipped.most_common(REASONS))
    more = len(skipped) - REASONS
    return f"; skipped: {listed}" + (f" and {more} other reasons" if more > 0 else "")
