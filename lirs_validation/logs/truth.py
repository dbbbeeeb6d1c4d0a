"""What is known to be true about a log, brought to the time of its repaired stamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lirs_validation.config import MapConfig
from lirs_validation.logs.reference import read_reference
from lirs_validation.metrics.log_accuracy import trajectory_accuracy
from lirs_validation.metrics.relative_pose_constraints import RelativePoseConstraint, read_constraints
from lirs_wct.formats.laser_log import LineStamps
from lirs_wct.geometry.trajectory import Trajectory


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
    """Return the accuracy of a log's raw odometry alone, as a record holds it; empty without odometry."""
    if len(odometry) == 0:
        return {}
    return trajectory_accuracy(odometry, odometry, relations, reference).metrics()


def relations_in_time(
    relations: Sequence[RelativePoseConstraint], lines: LineStamps
) -> tuple[RelativePoseConstraint, ...]:
    """Return relations, which name poses by their logged stamps, by the stamps as repaired."""
    if not lines.moved:
        return tuple(relations)
    logged = np.array([(r.stamp_a, r.stamp_b) for r in relations])
    return tuple(
        replace(relation, stamp_a=a, stamp_b=b)
        for relation, (a, b) in zip(relations, lines.repaired_at(logged).tolist(), strict=True)
    )


def reference_in_time(reference: Trajectory, lines: LineStamps) -> Trajectory:
    """Return a reference trajectory by the stamps as repaired; of poses that meet in time the first stays."""
    if not lines.moved:
        return reference
    stamps, first = np.unique(lines.repaired_at(reference.stamps), return_index=True)
    return Trajectory(stamps, reference.positions[first], reference.quaternions[first])
