"""Every scan's pose between the nodes around it: when nodes move, the scans between them follow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.common.se2 import composed, relative_poses, wrap


class NodeTrajectory:
    """Poses of all scans in the frame of the last node before each."""

    def __init__(self) -> None:
        self._scans: dict[float, tuple[int, Pose2]] = {}

    def add(self, stamp: float, pose: Pose2, nodes: int, last: Pose2 | None) -> None:
        """Note a scan; a later scan of the same stamp takes the place of the earlier.

        Args:
            stamp: seconds.
            pose: `T_local_base`.
            nodes: how many there are so far, with the scan itself if it is one.
            last: `T_local_base` of the last of them.
        """
        self._scans[stamp] = nodes - 1, pose if last is None else last.inverse() @ pose

    def trajectory(self, local: Sequence[Pose2], final: Sequence[Pose2], T_map_local: Pose2) -> Trajectory:
        """Return the poses in the map frame, by stamp.

        Args:
            local: `T_local_base` of the nodes.
            final: `T_map_base` of the nodes.
            T_map_local: for scans before the first node.
        """
        stamps = sorted(self._scans)
        if not stamps or not local:
            return Trajectory.from_poses(stamps, [T_map_local @ self._scans[t][1] for t in stamps])
        scans = np.array([self._scans[t][1].as_array() for t in stamps])
        last = np.array([self._scans[t][0] for t in stamps])
        before, after = np.clip(last, 0, len(local) - 1), np.clip(last + 1, 0, len(local) - 1)
        L, G = (np.array([p.as_array() for p in poses]) for poses in (local, final))
        scans = np.where((last >= 0)[:, None], composed(L[before], scans), scans)
        a = composed(G[before], relative_poses(L[before], scans))
        b = composed(G[after], relative_poses(L[after], scans))
        near, far = (
            np.hypot(*(scans - L[k])[:, :2].T) + 0.5 * abs(wrap((scans - L[k])[:, 2]))
            for k in (before, after)
        )
        share = (near / np.maximum(near + far, 1e-12))[:, None]
        delta = b - a
        delta[:, 2] = wrap(delta[:, 2])
        poses = a + share * delta
        return Trajectory.from_poses(stamps, [Pose2(x, y, yaw) for x, y, yaw in poses.tolist()])
