"""Loops that would move the map far wait for a second one that says the same.

One corridor looks like the next: a single match in a wide window is no proof. Two nodes of the same
stretch of way, found independently, must agree on how that stretch is to be moved.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2, wrap_angle
from slam_baselines.cartographer.constraints.builder import Constraint


@dataclass(frozen=True, kw_only=True)
class ConfirmationConfig:
    """Which loops need a second one, and what agreement is.

    Attributes:
        linear: loops that move a node farther than this need a second one, metres ...
        angular: ... or that turn it by more, radians.
        reach: the second node is at most so far along the way from the first, metres ...
        apart: ... and at least this far, so that it sees something else.
        linear_tolerance: the two may differ in how they move the node by this, metres ...
        angular_tolerance: ... and this, radians.
        waiting: so many loops may wait.

    Raises:
        ConfigError: a value that is not above 0.
    """

    linear: float = 0.4
    angular: float = 0.06
    reach: float = 25.0
    apart: float = 0.5
    linear_tolerance: float = 0.3
    angular_tolerance: float = 0.04
    waiting: int = 50

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} of the confirmation must be above 0, got {getattr(self, name)}")


class Confirmation:
    """The loops that wait for a second one."""

    def __init__(self, config: ConfirmationConfig) -> None:
        self._config = config
        self._waiting: deque[tuple[Constraint, float]] = deque(maxlen=config.waiting)

    def __len__(self) -> int:
        return len(self._waiting)

    def admit(
        self, loop: Constraint, way: float, submaps: Sequence[Pose2], nodes: Sequence[Pose2]
    ) -> list[Constraint]:
        """Return the loops that may be believed now: none, the given one, or it and those that it confirms.

        Args:
            loop: new.
            way: driven until its node, metres.
            submaps: `T_map_submap` of all submaps at present.
            nodes: `T_map_base` of all nodes at present.
        """
        c = self._config
        here = nodes[loop.node]
        there = submaps[loop.submap] @ loop.T_submap_node
        if there.distance(here) <= c.linear and abs(wrap_angle(there.yaw - here.yaw)) <= c.angular:
            return [loop]
        agreeing = []
        for other, other_way in self._waiting:
            if c.apart <= abs(way - other_way) <= c.reach:
                move = submaps[other.submap] @ other.T_submap_node @ nodes[other.node].inverse()
                expected = move @ here
                turn = abs(wrap_angle(expected.yaw - there.yaw))
                if expected.distance(there) <= c.linear_tolerance and turn <= c.angular_tolerance:
                    agreeing.append(other)
        if not agreeing:
            self._waiting.append((loop, way))
            return []
        confirmed = {(o.node, o.submap) for o in agreeing}
        self._waiting = deque(
            (w for w in self._waiting if (w[0].node, w[0].submap) not in confirmed), maxlen=c.waiting
        )
        return [*agreeing, loop]
