"""Frames of a bag: fixed and moving transforms, and what hangs on what."""

from __future__ import annotations

from typing import Any

from lirs_wct.geometry.pose import Pose3


def pose_of(position: Any, rotation: Any) -> Pose3:
    """Return the pose of a message's position and quaternion."""
    p, q = position, rotation
    return Pose3.from_arrays((p.x, p.y, p.z), (q.w, q.x, q.y, q.z))


class Frames:
    """Transforms by child frame; names without ROS 1's leading slash."""

    def __init__(self) -> None:
        self._fixed: dict[str, tuple[str, Pose3]] = {}
        self._moving: dict[str, list[tuple[int, float, Pose3]]] = {}

    def add(self, line: int, message: Any, *, static: bool) -> None:
        """Take in a TFMessage, the line-th message of the bag."""
        for t in message.transforms:
            child, T = t.child_frame_id.lstrip("/"), pose_of(t.transform.translation, t.transform.rotation)
            if static:
                self._fixed[child] = (t.header.frame_id.lstrip("/"), T)
            else:
                stamp = t.header.stamp
                seconds = (stamp.sec * 1_000_000_000 + stamp.nanosec) / 1e9
                self._moving.setdefault(child, []).append((line, seconds, T))

    def moving_base(self, frame: str) -> str:
        """Return the nearest frame above a sensor's that moves in another; empty where none does."""
        name = frame.lstrip("/")
        while name not in self._moving and name in self._fixed:
            name = self._fixed[name][0]
        return name if name in self._moving else ""

    def odometry(self, base: str) -> list[tuple[int, float, Pose3]]:
        """Return line, stamp and pose of a moving frame in its parent; empty where it does not move."""
        return self._moving.get(base, [])

    def mount(self, base: str, frame: str) -> Pose3 | None:
        """Return `T_base_frame` along fixed transforms; None where they do not lead there."""
        name, T = frame.lstrip("/"), Pose3()
        for _ in range(len(self._fixed) + 1):
            if name == base:
                return T
            if name not in self._fixed:
                return None
            name, step = self._fixed[name]
            T = step @ T
        return None
