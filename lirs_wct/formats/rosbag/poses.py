"""Trajectories of a ROS bag: topics of poses, or transforms as SLAM systems publish them."""

from __future__ import annotations

import warnings
from pathlib import Path

from lirs_wct.errors import SourceError
from lirs_wct.formats.rosbag.frames import BASES, Frames, is_named, pose_of, seconds
from lirs_wct.formats.rosbag.messages import MAP
from lirs_wct.formats.rosbag.open_bag import Bag, open_bag
from lirs_wct.formats.rosbag.topics import PATH, POSES, TRANSFORMS, list_topics, of_kinds, require_topic
from lirs_wct.geometry.pose import Pose3, Trajectory


def read_poses(path: Path, topic: str | None = None) -> Trajectory:
    """Read the trajectory that a bag holds.

    Args:
        path: of the bag.
        topic: of odometry, stamped poses or paths, of which the last counts, or of transforms, whose map ->
            base_link is taken; None = transforms if they lead to a frame `map`, else the only topic of poses.

    Raises:
        SourceError: the bag cannot be read, or has no such topic, or several could be meant.
    """
    with open_bag(path) as bag:
        trajectory = _poses(bag, topic)
    if bag.faults:
        said = f"{len(trajectory)} poses could be read"
        warnings.warn(f"{path}: damaged ({'; '.join(bag.faults)}): {said}", stacklevel=2)
    if len(trajectory) == 0:
        raise SourceError(f"{path}: {topic or 'it'} holds no pose")
    return trajectory


def _poses(bag: Bag, topic: str | None) -> Trajectory:
    if topic is not None:
        require_topic(bag.path, "BAG:/TOPIC", topic, (*POSES, *TRANSFORMS), bag.kinds)
    found = of_kinds(bag.kinds, POSES) if topic is None else [topic]
    if topic is None or bag.kinds[topic] in TRANSFORMS:
        in_map = _follow_transforms(bag, required=topic is not None or not found)
        if in_map is not None:
            return in_map
    if len(found) != 1:
        raise SourceError(f"{bag.path}: BAG:/TOPIC must say where its poses are; {list_topics(bag.kinds)}")
    return _read_topic(bag, found[0])


def _follow_transforms(bag: Bag, *, required: bool) -> Trajectory | None:
    """Return `T_map_base` along the bag's transforms; None if they do not connect the two.

    Raises:
        SourceError: they do not connect the two although this is required.
    """
    frames = Frames()
    topics = of_kinds(bag.kinds, TRANSFORMS)
    for line, (topic, _, message) in enumerate(bag.messages(topics)):
        frames.add(line, message, static=topic.endswith("tf_static"))
    for base in (name for wanted in BASES for name in sorted(frames.names) if is_named(name, wanted)):
        if is_named(frames.chain(base)[-1], MAP):
            return frames.trajectory(base)
    if required:
        held = ", ".join(sorted(frames.names)) or "none"
        raise SourceError(
            f"{bag.path}: its transforms do not lead from {MAP} to {' or '.join(BASES)}: its frames are "
            f"{held}; {list_topics(bag.kinds)}"
        )
    return None


def _read_topic(bag: Bag, topic: str) -> Trajectory:
    """Return the poses of a topic by stamp; of equal stamps, the later one."""
    found: dict[float, Pose3] = {}
    for _, _, message in bag.messages((topic,)):
        if bag.kinds[topic] == PATH:
            found = {}
        for each in message.poses if bag.kinds[topic] == PATH else (message,):
            pose = getattr(each.pose, "pose", each.pose)  # a covariance lies around some poses
            found[seconds(each.header.stamp)] = pose_of(pose.position, pose.orientation)
    stamps = sorted(found)
    return Trajectory.from_poses(stamps, [found[t] for t in stamps])
