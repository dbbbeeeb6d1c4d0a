"""CARMEN logs of a room that can be computed on paper."""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lirs_wct.geometry.pose import Pose2
from tests.slam_baselines.synthetic import ROOM, loop, ranges_to

START = 1.0e9
PERIOD = 0.2


def flaser(ranges: NDArray[np.float64], odometry: Pose2, stamp: float, name: str = "FLASER") -> str:
    """One line; the laser sits on the base's origin."""
    beams = " ".join(f"{r:.2f}" for r in ranges)
    pose = f"{odometry.x:.6f} {odometry.y:.6f} {odometry.yaw:.6f}"
    return f"{name} {len(ranges)} {beams} {pose} {pose} {stamp:.6f} nohost {stamp - START:.6f}"


def room_lines(
    n: int = 60, beams: int = 181, *, drifting: bool = True, seed: int = 1, most: float | None = None
) -> tuple[list[str], list[Pose2]]:
    """Return the lines of a drive once around the room, and the true poses in the room.

    Args:
        n: scans.
        beams: over 180 deg.
        drifting: whether the odometry errs, by 3 % and 1 deg a meter; else it stays at the origin.
        seed: of the noise (1 cm).
        most: the laser's largest range, which it gives for all beyond; None = it sees all of the room.
    """
    rng, truth, lines = np.random.default_rng(seed), loop(n), []
    angles = -math.pi / 2 + math.pi / (beams - 1) * np.arange(beams)
    odometry = Pose2()
    for k, pose in enumerate(truth):
        if k and drifting:
            step = truth[k - 1].inverse() @ pose
            odometry = odometry @ Pose2(1.03 * step.x, step.y, step.yaw + math.radians(1.0) * step.x)
        r = ranges_to(ROOM, pose, angles) + rng.normal(0, 0.01, beams)
        r = r if most is None else np.where(r > most, most, r)
        lines.append(flaser(np.where(np.isfinite(r), r, 81.83), odometry, START + PERIOD * k))
    return lines, truth


def write_log(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join(("# a log", *lines)) + "\n")
    return path
