"""Trajectories made elsewhere: reference, relations, another program's estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lirs_validation.map_config import MapConfig
from lirs_validation.metrics.log_accuracy import trajectory_accuracy
from lirs_validation.metrics.relative_pose_error import RelativePoseConstraint, read_constraints
from lirs_wct import ConfigError, SourceError, Trajectory
from lirs_wct.files import readable_lines
from lirs_wct.formats.carmen.log import read_carmen
from lirs_wct.formats.laser_log import LineStamps
from lirs_wct.formats.tum import read_tum
from lirs_wct.sources.source import is_bag


def read_trajectory(path: Path, topic: str | None = None, flag: str = "--topic") -> Trajectory:
    """Read a trajectory from a TUM file or a bag.

    A bag holds transforms from map to base_link, or a topic of poses.

    Args:
        path: of file or bag.
        topic: of a bag, which holds the poses; None = see `read_poses`.
        flag: option of the topic, for messages.

    Raises:
        SourceError: it is neither, or has no such topic, or holds no poses.
        ConfigError: a topic is given, and it is no bag.
    """
    if is_bag(path):
        from lirs_wct.formats.rosbag.poses import read_poses

        return read_poses(path, topic, flag)
    if topic is not None:
        raise ConfigError(f"{path}: {flag} can be given for a ROS bag only, this is none")
    return read_tum(path)


def read_reference(path: Path, topic: str | None = None) -> Trajectory:
    """Read a reference trajectory.

    The file is a TUM file, a bag, or a CARMEN log with corrected poses (as of a pose graph's nodes).

    Raises:
        SourceError: it is none of these, or holds no poses.
        ConfigError: a topic is given, and it is no bag.
    """
    if is_bag(path) or topic is not None:
        return read_trajectory(path, topic, "--reference-topic")
    if _begins_with_a_number(path):
        return read_tum(path)
    track = read_carmen(path).track
    if len(track) == 0:
        raise SourceError(f"{path}: holds no poses that change, a reference trajectory does")
    return track


def _begins_with_a_number(path: Path) -> bool:
    """Return whether a file begins with a number, after comments."""
    for line in readable_lines(path):
        tokens = line.split(None, 1)
        if tokens and not tokens[0].startswith(b"#"):
            try:
                float(tokens[0])
            except ValueError:
                return False
            return True
    return False


def read_truth(config: MapConfig) -> tuple[tuple[RelativePoseConstraint, ...] | None, Trajectory | None]:
    """Read the relations and the reference trajectory, where they are given.

    Raises:
        SourceError: one of them cannot be used.
    """
    c = config
    return (
        None if c.relations is None else read_constraints(Path(c.relations)),
        None if c.reference is None else read_reference(Path(c.reference), c.reference_topic),
    )


def odometry_accuracy(
    odometry: Trajectory,
    relations: Sequence[RelativePoseConstraint] | None,
    reference: Trajectory | None,
) -> dict[str, Any]:
    """Return the accuracy of a log's raw odometry; empty without odometry."""
    if len(odometry) == 0:
        return {}
    return trajectory_accuracy(odometry, odometry, relations, reference).metrics()


def relations_in_time(
    relations: Sequence[RelativePoseConstraint], lines: LineStamps
) -> tuple[RelativePoseConstraint, ...]:
    """Return relations with repaired stamps instead of logged ones."""
    if not lines.moved:
        return tuple(relations)
    logged = np.array([(r.stamp_a, r.stamp_b) for r in relations])
    return tuple(
        replace(relation, stamp_a=a, stamp_b=b)
        for relation, (a, b) in zip(relations, lines.repaired_at(logged).tolist(), strict=True)
    )


def reference_in_time(reference: Trajectory, lines: LineStamps) -> Trajectory:
    """Return a reference trajectory with repaired stamps.

    Of poses with the same stamp, the first stays.
    """
    if not lines.moved:
        return reference
    stamps, first = np.unique(lines.repaired_at(reference.stamps), return_index=True)
    return Trajectory(stamps, reference.positions[first], reference.quaternions[first])
