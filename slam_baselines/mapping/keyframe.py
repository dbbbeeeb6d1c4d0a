"""Keyframes: the scans that entered a map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from lirs_wct.arrays import ByteArray
from lirs_wct.geometry.pose import Pose2
from slam_baselines.scan.leveling import LeveledScan

Motion = TypeVar("Motion")


@dataclass(frozen=True, slots=True)
class Keyframe(Generic[Motion]):
    """A scan that entered the map.

    Attributes:
        scan: leveled.
        pose: `T_map_base`.
        height: of the base in the map frame, meters.
        min_slopes: (n,) minimum slopes of its hits, SLOPE_STEP.
        motion: from the keyframe before, as the method measures it.
    """

    scan: LeveledScan
    pose: Pose2
    height: float
    min_slopes: ByteArray
    motion: Motion
