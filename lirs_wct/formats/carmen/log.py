"""CARMEN logs (.clf, .log, also gzipped): laser scans with the odometry of the robot that made them.

Read are the messages of one laser (FLASER, ROBOTLASER1, RAWLASER1; RLASER, ROBOTLASER2, RAWLASER2 where
only the rear one was logged), ODOM and PARAM; what else the log holds is counted, not kept.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.carmen.laser import REAR, LaserFacts, scans_of
from lirs_wct.formats.carmen.lines import PARSERS, Lines, Message, messages_of, parameters_of, read_lines
from lirs_wct.formats.carmen.repairs import in_file_order, odometry_of
from lirs_wct.formats.laser_log import LaserLog

DAY = 86_400.0
"""A stamp farther than this from the log's middle is damaged, seconds ..."""
FEW = 0.01
"""... where no more than this share of all are."""
REPEATED = "scan that is in the log already"
REASONS = 5
"""Reasons that an error tells."""


def read_carmen(path: Path, facts: LaserFacts | None = None) -> LaserLog:
    """Read a CARMEN log; lines that cannot be used are skipped and counted.

    The order of the file is kept. Where stamps go back or repeat while the robot moves, they are repaired and
    a warning says how many.

    Args:
        path: of the log.
        facts: what the user knows about the laser better than the log.

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
    read, odoms = _in_time(_without_repeats(read, skipped), skipped), _in_time(odoms, skipped)
    scans, odoms, stamps = in_file_order(read, odoms)
    if stamps.moved:
        warnings.warn(f"{path}: {stamps.summary()}", stacklevel=2)
    parameters = parameters_of(lines.get("PARAM", ()))
    odometry, track = odometry_of([m.stamp for m in scans], scans, odoms, repaired)
    try:
        found = scans_of(laser, scans, parameters, facts or LaserFacts(), repaired)
    except ConfigError as error:
        raise SourceError(f"{path}: {error}") from error
    return LaserLog(
        tuple(found),
        tuple(odometry),
        track,
        stamps,
        skipped=dict(skipped),
        late=_late(stamps.logged),
        repaired=dict(repaired),
        laser=laser,
        left_out=len(lines[laser]) - skipped[REPEATED] - len(found),
    )


def _lasers(lines: Lines, skipped: Counter[str]) -> tuple[str, list[Message]]:
    """Return the messages of one laser: the front one, with poses if possible, of the commonest message."""
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
    """Keep the scans that have as many beams as most: a laser does not change."""
    sizes = Counter(len(m.ranges) for m in messages)
    usual = sizes.most_common(1)[0][0]
    for size, count in sizes.items():
        if size != usual:
            skipped[f"{name} of {size} beams where the log's have {usual}"] += count
    return [m for m in messages if len(m.ranges) == usual]


def _in_time(messages: list[Message], skipped: Counter[str]) -> list[Message]:
    """Leave out the few messages whose stamps lie more than a day from the others."""
    if not messages:
        return messages
    stamps = np.array([m.stamp for m in messages])
    away = np.abs(stamps - np.median(stamps)) > DAY
    if not 0 < away.mean() <= FEW:
        return messages
    skipped["stamp more than a day from the others"] += int(away.sum())
    return [m for m, far in zip(messages, away.tolist(), strict=True) if not far]


def _late(stamps: FloatArray) -> int:
    """Count the lines whose stamp is before that of an earlier line."""
    return int((stamps < np.maximum.accumulate(stamps)).sum())


def _without_repeats(messages: Sequence[Message], skipped: Counter[str]) -> list[Message]:
    """Leave out scans that are in the log already: the same stamp, ranges and poses."""
    first: dict[tuple[object, ...], Message] = {}
    for message in messages:
        first.setdefault((message.stamp, message.base, message.laser, message.ranges.tobytes()), message)
    if len(first) < len(messages):
        skipped[REPEATED] += len(messages) - len(first)
    return list(first.values())


def _reasons(skipped: Counter[str]) -> str:
    if not skipped:
        return ""
    listed = ", ".join(f"{n} x {why}" for why, n in skipped.most_common(REASONS))
    more = len(skipped) - REASONS
    return f"; skipped: {listed}" + (f" and {more} other reasons" if more > 0 else "")
