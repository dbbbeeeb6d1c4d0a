"""The odometry of a CARMEN log: of the laser's own messages, else of ODOM lines, else none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lirs_wct.formats.carmen_lines import Message
from lirs_wct.pose import Pose2
from lirs_wct.trajectory import Trajectory

JUMP, JUMP_SPEED = 5.0, 30.0
"""A step of more metres, and more metres a second, is no motion of a robot: its odometry was set anew."""
AGREEMENT = 1.0
"""Metres within which two sources tell of one frame."""

Array = NDArray[np.float64]


def odometry_of(
    stamps: Sequence[float], lasers: Sequence[Message], odoms: Sequence[Message], repaired: Counter[str]
) -> tuple[list[Pose2 | None], Trajectory]:
    """Return `T_odom_base` of each scan, and every pose that the odometry gives.

    Odometry that never changes says nothing, so it is taken for none: the robot may have moved or not.

    Args:
        stamps: of the scans, increasing.
        lasers: the scans' messages.
        odoms: ODOM messages, by stamp.
        repaired: receives how often the odometry was set anew.
    """
    own, wheels = _track(lasers), _track(odoms)
    if _moves(own) or (len(lasers) == 1 and len(own)):
        steady, jumps = without_jumps(own)
        if jumps == 0:
            return [m.base for m in lasers], _merged(own, wheels)
        _note(repaired, jumps)
        return [steady.pose2(i) for i in range(len(steady))], steady
    if _moves(wheels):
        steady, jumps = without_jumps(wheels)
        _note(repaired, jumps)
        at = steady.planar_at(np.asarray(stamps))
        return [Pose2(*row) for row in at.tolist()], steady
    return [None] * len(stamps), Trajectory.from_poses([], [])


def without_jumps(track: Trajectory) -> tuple[Trajectory, int]:
    """Return a track that stands still where the given one jumps, and how often it does."""
    xy, stamps = track.xy, track.stamps
    step = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    jump = (step > JUMP) & (step > JUMP_SPEED * np.diff(stamps))
    if not jump.any():
        return track, 0
    poses = [track.pose2(0)]
    for i, jumped in enumerate(jump.tolist()):
        motion = Pose2() if jumped else track.pose2(i).inverse() @ track.pose2(i + 1)
        poses.append(poses[-1] @ motion)
    return Trajectory.from_poses(stamps.tolist(), poses), int(jump.sum())


def _note(repaired: Counter[str], jumps: int) -> None:
    if jumps:
        repaired["jumps of the odometry, taken for standing still"] = jumps


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
    """Add the poses between scans, where ODOM lines tell of the same frame."""
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
