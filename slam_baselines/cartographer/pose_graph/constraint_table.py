"""Constraints as a growing table: an optimization begins with its rows so far, without looking at each."""

from __future__ import annotations

from copy import copy, deepcopy

import numpy as np

from slam_baselines.cartographer.pose_graph.optimization import PoseConstraint, PoseConstraints

FIRST_ROWS = 256


class ConstraintTable:
    """Constraints in the order in which they were added; a row that was added does not change."""

    def __init__(self) -> None:
        self._rows = _empty(FIRST_ROWS)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, constraint: PoseConstraint) -> None:
        """Add a constraint."""
        if self._count == len(self._rows.a):
            larger = _empty(2 * self._count)
            for new, old in zip(larger.rows, self._rows.rows, strict=True):
                new[: self._count] = old
            self._rows = larger
        r, at = self._rows, self._count
        r.a[at], r.b[at], r.z[at] = constraint.a, constraint.b, constraint.z
        r.information[at], r.robust[at] = constraint.information, constraint.robust
        self._count += 1

    def constraints(self) -> PoseConstraints:
        """Return all constraints so far; what is added later is not among them."""
        n, r = self._count, self._rows
        return PoseConstraints(r.a[:n], r.b[:n], r.z[:n], r.information[:n], r.robust[:n])

    def copy(self) -> ConstraintTable:
        """Return a table that goes on alone."""
        same = copy(self)
        same._rows = deepcopy(self._rows)
        return same


def _empty(rows: int) -> PoseConstraints:
    return PoseConstraints(
        np.empty(rows, np.int64),
        np.empty(rows, np.int64),
        np.empty((rows, 3)),
        np.empty((rows, 3, 3)),
        np.empty(rows, np.bool_),
    )
