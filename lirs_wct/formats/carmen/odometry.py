"""The odometry of a CARMEN log: of the laser's own messages, else of ODOM lines, else none."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from lirs_wct.formats.carmen.lines import Message
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.trajectory import Trajectory

JUMP, JUMP_SPEED = 5.0, 30.0
"""A step of more meters, and more meters a second, is no motion of a robot."""
LOOK = 5
"""Poses after a leap among which the track may have come back."""
AGREEMENT = 1.0
"""Meters within which two sources share one frame."""


def odometry_of(
    stamps: Sequence[float], lasers: Sequence[Message], odoms: Sequence[Message], repaired: Counter[str]
) -> tuple[list[Pose2 | None], Trajectory]:
    """Return `T_odom_base` of each scan, and every pose that the odometry gives.

    Odometry that never changes says nothing, so it is taken for none: the robot may have moved or not.

    Args:
        stamps: of the scans, increasing.
        lasers: the scans' messages.
        odoms: ODOM messages.
        repaired: receives what was put right, and how often.
    """
    own, wheels = _track(lasers), _track(odoms)
    if _moves(own) or (len(lasers) == 1 and len(own)):
        steady = without_jumps(own, repaired)
        if steady is own:
            return [m.base for m in lasers], _merged(own, wheels)
        return [steady.pose2(i) for i in range(len(steady))], steady
    if _moves(wheels):
        steady = without_jumps(wheels, repaired)
        at = steady.planar_at(np.asarray(stamps))
        return [Pose2(*row) for row in at.tolist()], steady
    return [None] * len(stamps), Trajectory.from_poses([], [])


def without_jumps(track: Trajectory, repaired: Counter[str]) -> Trajectory:
    """Return a track that no robot is too slow for; where it is sound, itself.

    A few poses far from those before and after are replaced by poses between these. Where the track does
    not come back, the odometry was set anew: it stands still for that step.
    """
    wrong, anew = _leaps(track)
    if not wrong and not anew:
        return track
    sound = np.setdiff1d(np.arange(len(track)), wrong)
    poses, last = [track.pose2(0)], 0
    for k in sound[1:].tolist():
        motion = Pose2() if k in anew else track.pose2(last).inverse() @ track.pose2(k)
        poses.append(poses[-1] @ motion)
        last = k
    kept = Trajectory.from_poses(track.stamps[sound].tolist(), poses)
    if wrong:
        repaired["odometry far from that before and after, taken from between"] = len(wrong)
    if anew:
        repaired["jumps of the odometry, taken for standing still"] = len(anew)
    filled = [Pose2(*row) for row in kept.planar_at(track.stamps).tolist()]
    return Trajectory.from_poses(track.stamps.tolist(), filled)


def _leaps(track: Trajectory) -> tuple[list[int], set[int]]:
    """Return which poses are far from those before and after, and at which the track goes on elsewhere."""
    xy, stamps = track.xy, track.stamps
    wrong: list[int] = []
    anew: set[int] = set()

    def reached(a: int, b: int) -> bool:
        meters = math.hypot(*(xy[b] - xy[a]))
        return meters <= max(JUMP, JUMP_SPEED * float(stamps[b] - stamps[a]))

    steps = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    if not (steps > JUMP).any():
        return wrong, anew
    last = 0
    for k in range(1, len(track)):
        if not reached(last, k):
            if any(reached(last, m) for m in range(k + 1, min(k + 1 + LOOK, len(track)))):
                wrong.append(k)
                continue
            anew.add(k)
        last = k
    return wrong, anew


def _track(messages: Sequence[Message]) -> Trajectory:
    """Return the poses by stamp; of two with one stamp, the later line's."""
    poses = {m.stamp: m.base for m in messages if m.base is not None}
    stamps = sorted(poses)
    return Trajectory.from_poses(stamps, [poses[t] for t in stamps])


def _moves(track: Trajectory) -> bool:
    if len(track) < 2:
        return False
    return bool(np.ptp(track.xy, axis=0).any() or np.ptp(track.quaternions, axis=0).any())


def _merged(own: Trajectory, wheels: Trajectory) -> Trajectory:
    """Add the poses between scans, where ODOM lines are of the same frame."""
    if len(wheels) == 0:
        return own
    far = np.linalg.norm(wheels.planar_at(own.stamps)[:, :2] - own.xy, axis=1)
    if len(own) > 1 and float(np.median(far)) > AGREEMENT:
        return own
    fresh = ~np.isin(wheels.stamps, own.stamps)
    stamps = np.concatenate((own.stamps, wheels.stamps[fresh]))
    order = np.argsort(stamps)
    return Trajectory(
        stamps[order],
        np.concatenate((own.positions, wheels.positions[fresh]))[order],
        np.concatenate((own.quaternions, wheels.quaternions[fresh]))[order],
    )
