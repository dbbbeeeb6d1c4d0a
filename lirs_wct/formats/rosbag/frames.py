"""Frames of a bag: the tree of fixed and moving transforms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lirs_wct.geometry.pose import Pose3, Trajectory

SAME = 1e-6
"""Largest change of a constant transform on /tf: meters, and components of the quaternion."""


def pose_of(position: Any, rotation: Any) -> Pose3:
    """Return the pose of a message's position and quaternion; zeros mean no rotation."""
    p, q = position, rotation
    n = math.sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z)
    if n == 0.0:
        return Pose3(p.x, p.y, p.z)
    return Pose3(p.x, p.y, p.z, q.w / n, q.x / n, q.y / n, q.z / n)


def seconds(stamp: Any) -> float:
    """Return a message's stamp in seconds."""
    return float((stamp.sec * 1_000_000_000 + stamp.nanosec) / 1e9)


class Frames:
    """Transforms by child frame; names without ROS 1's leading slash."""

    def __init__(self) -> None:
        self._fixed: dict[str, tuple[str, Pose3]] = {}
        self._moving: dict[str, list[tuple[int, float, Pose3]]] = {}
        self._parents: dict[str, str] = {}

    def add(self, line: int, message: Any, *, static: bool, received: float | None = None) -> None:
        """Add a TFMessage, the line-th message of the bag; `received` replaces its stamps."""
        for t in message.transforms:
            parent, child = t.header.frame_id.lstrip("/"), t.child_frame_id.lstrip("/")
            T = pose_of(t.transform.translation, t.transform.rotation)
            if static:
                self._fixed[child] = (parent, T)
            else:
                self._parents[child] = parent
                stamp = seconds(t.header.stamp) if received is None else received
                self._moving.setdefault(child, []).append((line, stamp, T))

    @property
    def names(self) -> set[str]:
        """Frames of both kinds, parents and children."""
        fixed = {name for child, (parent, _) in self._fixed.items() for name in (child, parent)}
        return fixed | set(self._parents) | set(self._parents.values())

    def moving_base(self, frame: str) -> str:
        """Return the nearest moving frame above a sensor's frame; empty without one.

        For a robot at rest, return the nearest frame on /tf.
        """
        on_tf = [name for name in self.chain(frame.lstrip("/")) if name in self._moving]
        return next((name for name in on_tf if not self._constant(name)), on_tf[0] if on_tf else "")

    def odometry(self, base: str) -> list[tuple[int, float, Pose3]]:
        """Return line, stamp and pose of a moving frame in its parent; empty for others."""
        return self._moving.get(base, [])

    def mount(self, base: str, frame: str) -> Pose3 | None:
        """Return `T_base_frame` along constant transforms; None if they do not connect the two."""
        top_of_base, T_top_base = self._climb(base)
        top, T_top_frame = self._climb(frame.lstrip("/"))
        return T_top_base.inverse() @ T_top_frame if top == top_of_base else None

    def chain(self, frame: str) -> list[str]:
        """Return a frame and its ancestors, the topmost last."""
        names = [frame]
        while (above := self._above(names[-1])) and above not in names:
            names.append(above)
        return names

    def trajectory(self, frame: str) -> Trajectory:
        """Return `T_top_frame` in the topmost ancestor at the stamps of the lowest moving frame.

        Poses of frames above it are interpolated, as in tf2.
        """
        chain = self.chain(frame)[:-1]
        edges = [self._edge(name) for name in chain]
        moving = [stamps for stamps, _ in edges if len(stamps) > 1]
        if not moving:
            return Trajectory.from_poses([], list[Pose3]())
        first, last = max(s[0] for s in moving), min(s[-1] for s in moving)
        stamps = moving[0][(moving[0] >= first) & (moving[0] <= last)]
        poses = []
        for t in stamps.tolist():
            T = Pose3()
            for held, steps in edges:
                T = _interpolate(held, steps, t) @ T
            poses.append(T)
        return Trajectory.from_poses(stamps.tolist(), poses)

    def _edge(self, name: str) -> tuple[np.ndarray[Any, np.dtype[np.float64]], list[Pose3]]:
        """Return rising stamps and poses of a frame in its parent; one if fixed."""
        if name in self._fixed and name not in self._moving:
            return np.zeros(1), [self._fixed[name][1]]
        found = {stamp: T for _, stamp, T in self._moving[name]}
        stamps = sorted(found)
        return np.array(stamps), [found[t] for t in stamps]

    def _above(self, name: str) -> str:
        return self._parents.get(name) or self._fixed.get(name, ("",))[0]

    def _climb(self, name: str) -> tuple[str, Pose3]:
        """Return the topmost frame along constant transforms, and the pose in it."""
        T, seen = Pose3(), {name}
        while True:
            if name in self._fixed:
                above, step = self._fixed[name]
            elif self._constant(name):
                above, step = self._parents[name], self._moving[name][0][2]
            else:
                return name, T
            if above in seen:
                return name, T
            seen.add(above)
            name, T = above, step @ T

    def _constant(self, name: str) -> bool:
        """Whether a frame of /tf never moves (a sensor's mount that is published repeatedly)."""
        held = self._moving.get(name, [])
        if len(held) < 2:
            return False
        values = np.array([(*T.position, *T.quaternion) for _, _, T in held])
        return bool((np.ptp(values, axis=0) <= SAME).all())


def _interpolate(stamps: np.ndarray[Any, np.dtype[np.float64]], poses: list[Pose3], t: float) -> Pose3:
    """Return the pose at a stamp, with linear position and quaternion."""
    k = int(np.searchsorted(stamps, t))
    if k == len(poses) or stamps[k] == t or k == 0:
        return poses[min(k, len(poses) - 1)]
    a, b = poses[k - 1], poses[k]
    share = float((t - stamps[k - 1]) / (stamps[k] - stamps[k - 1]))
    q = b.quaternion if float(a.quaternion @ b.quaternion) >= 0 else -b.quaternion
    return Pose3.from_arrays(
        a.position + share * (b.position - a.position), a.quaternion + share * (q - a.quaternion)
    )
