"""Verification of loops that would move the map far: they wait for a second one that agrees.

One corridor looks like the next: a single match in a wide window is no proof. Two nodes of the same
stretch of the path, matched independently, must agree on how that stretch is to be moved.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from lirs_wct.geometry.pose import Pose2, wrap_angle
from slam_baselines.cartographer.loop_closure.constraint_builder import LoopConstraint
from slam_baselines.cartographer.loop_closure_config import LoopVerificationConfig


class LoopVerification:
    """Loops that wait for a second one."""

    def __init__(self, config: LoopVerificationConfig) -> None:
        self._config = config
        self._pending: deque[tuple[LoopConstraint, float]] = deque(maxlen=config.max_pending)

    def __len__(self) -> int:
        return len(self._pending)

    def verify_loop(
        self, loop: LoopConstraint, distance_traveled: float, submaps: Sequence[Pose2], nodes: Sequence[Pose2]
    ) -> list[LoopConstraint]:
        """Return the loops that are accepted now: none, the given one, or it and those that agree with it.

        Args:
            loop: new.
            distance_traveled: distance traveled until its node, meters.
            submaps: `T_map_submap` of all submaps at present.
            nodes: `T_map_base` of all nodes at present.
        """
        c = self._config
        here = nodes[loop.node]
        there = submaps[loop.submap] @ loop.T_submap_node
        turn = abs(wrap_angle(there.yaw - here.yaw))
        if there.distance(here) <= c.max_translation and turn <= c.max_rotation:
            return [loop]
        agreeing = []
        for other, other_distance in self._pending:
            if c.min_separation <= abs(distance_traveled - other_distance) <= c.max_separation:
                correction = submaps[other.submap] @ other.T_submap_node @ nodes[other.node].inverse()
                expected = correction @ here
                turn = abs(wrap_angle(expected.yaw - there.yaw))
                if expected.distance(there) <= c.linear_tolerance and turn <= c.angular_tolerance:
                    agreeing.append(other)
        if not agreeing:
            self._pending.append((loop, distance_traveled))
            return []
        accepted = {(o.node, o.submap) for o in agreeing}
        self._pending = deque(
            (p for p in self._pending if (p[0].node, p[0].submap) not in accepted), maxlen=c.max_pending
        )
        return [*agreeing, loop]
