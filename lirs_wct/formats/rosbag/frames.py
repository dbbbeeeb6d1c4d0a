"""Frames of a bag: the tree of fixed and moving transforms, and trajectories."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from lirs_wct.errors import SourceError
from lirs_wct.formats.rosbag.messages import BASE, MAP
from lirs_wct.formats.rosbag.open_bag import Bag, open_bag
from lirs_wct.formats.rosbag.topics import PATH, POSES, TRANSFORMS, list_topics, of_kinds, require_topic
from lirs_wct.geometry import FloatArray, Pose3, Trajectory

MAX_JITTER = 1e-6
"""Largest change of a constant transform on /tf: meters, and components of the quaternion."""
BASES = (BASE, "base_footprint")
"""Names of a robot's base frame, the preferred one first."""
MIN_ZIGZAG = 0.02
"""Smallest step from one source's pose to another's, meters."""
MIN_POSE_RATIO = 1.2
"""Ratio of the poses of two sources from which on the later one counts."""
MIN_RETURN_SHARE, MIN_LENGTH_RATIO = 0.005, 2.0
"""Of poses from two sources: share of steps that lead back at once, and ratio of the length of all steps to
that of the two paths, at least; poses with noise only lead back, too."""

Step = tuple[int, float, Pose3]
"""Line in the bag, stamp in seconds, and pose of a frame in its parent."""


def pose_of(position: Any, rotation: Any) -> Pose3:
    """Return the pose of a message's position and quaternion; zeros mean no rotation."""
    p, q = position, rotation
    n = math.sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z)
    if n == 0.0:
        return Pose3(p.x, p.y, p.z)
    return Pose3(p.x, p.y, p.z, q.w / n, q.x / n, q.y / n, q.z / n)


def planar_covariance(pose: Any) -> FloatArray:
    """Return a message's covariance (3, 3) of x, y, yaw; NaN for none or zeros."""
    given = np.reshape(getattr(pose, "covariance", np.zeros(36)), (6, 6))[np.ix_((0, 1, 5), (0, 1, 5))]
    return np.asarray(given if given.any() else np.full((3, 3), np.nan), dtype=np.float64)


def is_finite(T: Pose3) -> bool:
    """Return whether all numbers of a pose are finite."""
    return math.isfinite(T.x + T.y + T.z + T.qw + T.qx + T.qy + T.qz)


def seconds(stamp: Any) -> float:
    """Return a message's stamp in seconds."""
    return float((stamp.sec * 1_000_000_000 + stamp.nanosec) / 1e9)


def is_named(frame: str, *names: str) -> bool:
    """Return whether a frame has one of the names, with or without a robot's prefix."""
    return frame.rpartition("/")[2] in names


class Frames:
    """Transforms by child frame; names without ROS 1's leading slash.

    Attributes:
        skipped: Number of transforms that are not finite.
        disputed: Frames whose static transforms differ.
    """

    def __init__(self) -> None:
        self.skipped, self.disputed = 0, set[str]()
        self._fixed: dict[str, tuple[str, Pose3]] = {}
        self._moving: dict[str, dict[str, list[Step]]] = {}
        self._edges: dict[str, tuple[FloatArray, list[Pose3]]] = {}

    def add(self, line: int, message: Any, *, static: bool, received: float | None = None) -> None:
        """Add a TFMessage, the line-th message of the bag; `received` replaces its stamps."""
        self._edges.clear()
        for t in message.transforms:
            parent, child = t.header.frame_id.lstrip("/"), t.child_frame_id.lstrip("/")
            T = pose_of(t.transform.translation, t.transform.rotation)
            if not is_finite(T):
                self.skipped += 1
            elif static:
                above, before = self._fixed.get(child, (parent, T))
                turned = abs(float(before.quaternion @ T.quaternion)) < 1.0 - 1e-6
                if above != parent or turned or math.dist(before.position, T.position) > 1e-3:
                    self.disputed.add(child)
                self._fixed[child] = (parent, T)
            else:
                stamp = seconds(t.header.stamp) if received is None else received
                self._moving.setdefault(child, {}).setdefault(parent, []).append((line, stamp, T))

    @property
    def names(self) -> set[str]:
        """Frames of both kinds, parents and children."""
        fixed = {name for child, (parent, _) in self._fixed.items() for name in (child, parent)}
        return fixed.union(self._moving, *self._moving.values())

    def base(self, frame: str) -> str:
        """Return the robot's base above a sensor's frame; empty without one.

        It is a frame with the usual name, else the frame that moves in `odom`, else the nearest moving one,
        or for a robot at rest the nearest frame on /tf.
        """
        chain = self.chain(frame.lstrip("/"))
        steps = list(pairwise(chain))
        named = [name for name in chain if is_named(name, *BASES)]
        # A footprint to which the base is fixed moves on the ground as the base does.
        for name, above in steps:
            if name in named[:1] and is_named(above, *BASES) and self._constant(name):
                named = [above]
        on_tf = [name for name in chain if name in self._moving]
        moving = [name for name in on_tf if not self._constant(name)]
        in_odom = [name for name, above in steps if _is_odom(above)]
        elsewhere = [name for name in self._moving if _is_odom(self._above(name))]
        return next(iter((*named, *in_odom, *moving, *on_tf, *elsewhere)), "")

    def odometry(self, base: str) -> tuple[list[Step], str]:
        """Return a base's poses in the odometry frame or the topmost one, and that frame."""
        chain = self.chain(base)
        top = next((k for k, name in enumerate(chain) if _is_odom(name)), len(chain) - 1)
        names = chain[:top]
        moving = [name for name in names if not self._constant(name)]
        if not moving:
            return [], chain[top]
        lowest = names.index(moving[0])
        below, above = names[:lowest], names[lowest + 1 :]
        return [
            (line, t, self._pose(above, t) @ T @ self._pose(below, t))
            for line, t, T in self._steps(moving[0])
        ], chain[top]

    def mounts(self, base: str, frame: str, stamps: Sequence[float]) -> list[Pose3] | None:
        """Return `T_base_frame` at each stamp, interpolated; None if no transforms connect the two."""
        up, down = self.chain(frame.lstrip("/")), self.chain(base)
        common = next((name for name in up if name in down), None)
        if common is None:
            return None
        up, down = up[: up.index(common)], down[: down.index(common)]
        if all(self._constant(name) for name in (*up, *down)):
            return [self._pose(down, 0.0).inverse() @ self._pose(up, 0.0)] * len(stamps)
        return [self._pose(down, t).inverse() @ self._pose(up, t) for t in stamps]

    def chain(self, frame: str) -> list[str]:
        """Return a frame and its ancestors, the topmost last."""
        names = [frame]
        while (above := self._above(names[-1])) and above not in names:
            names.append(above)
        return names

    def trajectory(self, frame: str) -> Trajectory:
        """Return `T_top_frame` at the stamps of the lowest moving frame; others interpolated as in tf2."""
        chain = self.chain(frame)[:-1]
        moving = [stamps for stamps, _ in map(self._edge, chain) if len(stamps) > 1]
        if not moving:
            return Trajectory.from_poses([], list[Pose3]())
        first, last = max(s[0] for s in moving), min(s[-1] for s in moving)
        stamps = moving[0][(moving[0] >= first) & (moving[0] <= last)].tolist()
        return Trajectory.from_poses(stamps, [self._pose(chain, t) for t in stamps])

    def _pose(self, chain: Sequence[str], t: float) -> Pose3:
        """Return the pose of a chain's first frame in the last one's parent at a stamp."""
        T = Pose3()
        for name in chain:
            T = _interpolate(*self._edge(name), t) @ T
        return T

    def _steps(self, name: str) -> list[Step]:
        """Return the transforms of a frame on /tf, those to its most frequent parent."""
        return max(self._moving.get(name, {"": []}).values(), key=len)

    def _edge(self, name: str) -> tuple[FloatArray, list[Pose3]]:
        """Return rising stamps and poses in the parent; a fixed frame has one pose."""
        if name not in self._edges:
            poses = {stamp: T for _, stamp, T in self._steps(name)}
            if name in self._fixed and name not in self._moving:
                poses = {0.0: self._fixed[name][1]}
            stamps = sorted(poses)
            self._edges[name] = np.array(stamps), [poses[t] for t in stamps]
        return self._edges[name]

    def _above(self, name: str) -> str:
        parents = self._moving.get(name)
        if parents:
            return max(parents, key=lambda parent: len(parents[parent]))
        return self._fixed.get(name, ("",))[0]

    def _constant(self, name: str) -> bool:
        """Whether a frame never moves in its parent, also one that is published repeatedly."""
        if name in self._fixed and name not in self._moving:
            return True
        steps = self._steps(name)
        if len(steps) < 2:
            return False
        values = np.array([(*T.position, *T.quaternion) for _, _, T in steps])
        return bool((np.ptp(values, axis=0) <= MAX_JITTER).all())


def _is_odom(frame: str) -> bool:
    return frame.rpartition("/")[2].startswith("odom")


def _interpolate(stamps: FloatArray, poses: list[Pose3], t: float) -> Pose3:
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


def one_source(steps: list[Step]) -> tuple[list[Step], int]:
    """Return the poses of one source, and the number of sources, 1 or 2.

    Poses of two publishers alternate: steps lead from one path to the other and back. Before and after the
    longest such step, each pose belongs to the path whose pose is nearer. The path of more poses is returned.
    """
    merged = _step_lengths(steps, 1)
    back = (merged[:-1] > MIN_ZIGZAG) & (_step_lengths(steps, 2) < merged[:-1] / 2)
    if back.sum() <= MIN_RETURN_SHARE * len(steps):
        return steps, 1
    apart = int(np.argmax(np.where(back, merged[:-1], 0.0)))
    seeds = steps[apart : apart + 2]
    before, after = _two_paths(seeds, steps[:apart][::-1]), _two_paths(seeds, steps[apart + 2 :])
    paths = [[*early[:0:-1], *late] for early, late in zip(before, after, strict=True)]
    if merged.sum() < MIN_LENGTH_RATIO * sum(_step_lengths(path, 1).sum() for path in paths):
        return steps, 1
    first, second = sorted(paths, key=lambda path: path[-1][0])
    return (second if len(second) > MIN_POSE_RATIO * len(first) else first), 2


def _two_paths(seeds: list[Step], steps: list[Step]) -> list[list[Step]]:
    """Return two paths that begin with a seed each and continue with the steps."""
    paths = [[seed] for seed in seeds]
    for each in steps:
        steps_to = [path[-1][2].to_pose2().inverse() @ each[2].to_pose2() for path in paths]
        apart = [math.hypot(step.x, step.y) + abs(step.yaw) for step in steps_to]
        for path, distance in zip(paths, apart, strict=True):
            if distance <= min(apart) + MIN_ZIGZAG / 2:  # of both paths at rest
                path.append(each)
    return paths


def _step_lengths(steps: list[Step], over: int) -> FloatArray:
    """Return the distances from each pose to the one `over` steps later, meters."""
    xy = np.array([(T.x, T.y) for _, _, T in steps]).reshape(-1, 2)
    lengths: FloatArray = np.hypot(*(xy[over:] - xy[:-over]).T)
    return lengths


def read_poses(path: Path, topic: str | None = None) -> Trajectory:
    """Read the trajectory that a bag holds.

    Its topic is of odometry, stamped poses or paths (the last counts), or of transforms (map -> base_link is
    taken); by default it is transforms that lead to a frame `map`, else the only topic of poses.
    """
    with open_bag(path) as bag:
        topics = of_kinds(bag.kinds, POSES)
        if topic is not None:
            legal = *POSES, *TRANSFORMS
            topics = [require_topic(path, "BAG:/TOPIC", topic, legal, bag.kinds)]
        trajectory = None
        if topic is None or bag.kinds[topic] in TRANSFORMS:
            trajectory = _follow_transforms(bag, required=topic is not None or not topics)
        if trajectory is None:
            if len(topics) != 1:
                raise SourceError(
                    f"{path}: BAG:/TOPIC must say where its poses are; {list_topics(bag.kinds)}"
                )
            trajectory = _read_topic(bag, topics[0])
    if bag.faults:
        said = f"{len(trajectory)} poses could be read"
        warnings.warn(f"{path}: damaged ({'; '.join(bag.faults)}): {said}", stacklevel=2)
    if len(trajectory) == 0:
        raise SourceError(f"{path}: {topic or 'it'} holds no pose")
    return trajectory


def _follow_transforms(bag: Bag, *, required: bool) -> Trajectory | None:
    """Return `T_map_base` along the bag's transforms; None if they do not connect the two."""
    frames = Frames()
    topics = of_kinds(bag.kinds, TRANSFORMS)
    for line, (topic, _, message) in enumerate(bag.messages(topics)):
        frames.add(line, message, static=topic.endswith("tf_static"))
    for base in (name for wanted in BASES for name in sorted(frames.names) if is_named(name, wanted)):
        if is_named(frames.chain(base)[-1], MAP):
            return frames.trajectory(base)
    if required:
        names = ", ".join(sorted(frames.names)) or "none"
        raise SourceError(
            f"{bag.path}: its transforms do not lead from {MAP} to {' or '.join(BASES)}: its frames are "
            f"{names}; {list_topics(bag.kinds)}"
        )
    return None


def _read_topic(bag: Bag, topic: str) -> Trajectory:
    """Return the poses of a topic by stamp; of equal stamps, the later one."""
    poses: dict[float, tuple[Pose3, FloatArray]] = {}
    for _, _, message in bag.messages((topic,)):
        if bag.kinds[topic] == PATH:
            poses = {}
        for each in message.poses if bag.kinds[topic] == PATH else (message,):
            pose = getattr(each.pose, "pose", each.pose)  # a covariance lies around some poses
            T = pose_of(pose.position, pose.orientation)
            poses[seconds(each.header.stamp)] = T, planar_covariance(each.pose)
    stamps = sorted(poses)
    trajectory = Trajectory.from_poses(stamps, [poses[t][0] for t in stamps])
    covariances = np.array([poses[t][1] for t in stamps])
    return trajectory if np.isnan(covariances).all() else replace(trajectory, covariances=covariances)
