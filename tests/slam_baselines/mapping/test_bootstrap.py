"""The schedule of the start-up refinement."""

import numpy as np

from lirs_wct.geometry.pose import Pose2
from slam_baselines.front_end import FrontEndConfig, Keyframe, StartUp
from slam_baselines.leveling import LeveledScan

NOTHING = np.empty((0, 3))
SCAN = LeveledScan(np.zeros(3), NOTHING, NOTHING, (0.0, 0.0), True, 0.0)


def refined_at(first: float, last: float, ready: float) -> list[float]:
    """Distances of the refinements of a drive over 30 m, each done when it is due and `ready` is reached."""
    start = StartUp[Keyframe](FrontEndConfig(bootstrap_first=first, bootstrap_last=last))
    found = []
    for k in range(61):
        keyframe = Keyframe(SCAN, Pose2(0.5 * k), 0.0, np.empty(0, np.uint8))
        if start.add(keyframe, 0.5 * k) and 0.5 * k >= ready:
            start.replace(start.keyframes)
            found.append(0.5 * k)
    assert start.refinements == len(found)
    return found


def test_refinements_come_at_twice_the_distance() -> None:
    assert refined_at(2.0, 40.0, ready=0.0) == [2.0, 4.0, 8.0, 16.0]
    assert refined_at(2.0, 10.0, ready=0.0) == [2.0, 4.0, 8.0]


def test_a_late_refinement_is_not_repeated_at_once() -> None:
    assert refined_at(2.0, 40.0, ready=6.5) == [6.5, 8.0, 16.0]
