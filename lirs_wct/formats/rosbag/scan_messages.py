"""Laser scans of bags: the geometry of their beams, as single numbers and with several echoes a beam."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import Float32Array

SAME_ANGLE = 1e-4
"""Radians within which angle_max agrees with the increment, both float32."""
FULL_TURN = math.tau * 1.01
"""Radians that the beams of a scan span at most; some drivers let the last beam meet the first."""


class Beams(NamedTuple):
    """The geometry of a scan's beams, as float32 hold it."""

    first: float
    step: float
    last: float
    range_min: float
    range_max: float
    time_increment: float


def ranges_of(message: Any) -> Float32Array:
    """Return the range of each beam; of a `MultiEchoLaserScan` the first echo, NaN of a beam without."""
    if len(message.ranges) and hasattr(message.ranges[0], "echoes"):
        first = [beam.echoes[0] if len(beam.echoes) else np.nan for beam in message.ranges]
        return np.array(first, np.float32)
    return np.asarray(message.ranges, np.float32)


def beams_of(message: Any, n: int) -> Beams | None:
    """Return the geometry of n beams; None where neither the increment nor angle_max gives one.

    An increment of 0, or of more than a turn, is replaced by that from angle_min to angle_max.
    """
    m = message
    step = m.angle_increment if _legal(m.angle_increment, n) else (m.angle_max - m.angle_min) / max(1, n - 1)
    if not (math.isfinite(m.angle_min) and _legal(step, n)):
        return None
    return Beams(m.angle_min, step, m.angle_max, m.range_min, m.range_max, m.time_increment)


@lru_cache
def geometry(beams: Beams, n: int) -> tuple[float, float, float, float]:
    """Return the first angle, the increment, and the limits of ranges, as n beams were made."""
    first, step, last = _angle(beams.first), _angle(beams.step), _angle(beams.last)
    if n > 1 and abs(first + step * (n - 1) - last) < SAME_ANGLE:
        # Rounding of the increment would add up over the beams.
        step = (last - first) / (n - 1)
    return first, step, _decimal(beams.range_min), _decimal(beams.range_max)


def _legal(step: float, n: int) -> bool:
    """Whether n beams may be this far apart; a single beam may be so at any angle."""
    return n == 1 or (math.isfinite(step) and step != 0.0 and abs(step) * (n - 1) <= FULL_TURN)


def _decimal(value: float) -> float:
    """Return the shortest decimal that a float32 may have been made of: 0.1 for 0.10000000149."""
    return float(str(np.float32(value)))


def _angle(value: float) -> float:
    """Return the angle of whole ten-thousandths of a degree that a float32 was made of; else the float32.

    Mappers tell trajectories apart by less than what the messages round away.
    """
    if not math.isfinite(value):
        return float(value)
    exact = math.radians(round(math.degrees(value), 4))
    return exact if np.float32(exact) == np.float32(value) else float(value)
