"""The odometry's error beside the mapper's: a mapper that is the worse of the two has cost accuracy."""

from __future__ import annotations

from collections.abc import Sequence

from lirs_validation.record.formatting import Entry, text_at, value_at

ATE, ODOMETRY_ATE = "trajectory.ate_rmse", "trajectory.odometry_ate_rmse"
"""Places of the mapper's and of the odometry's error in a record."""
WORSE = "worse than its odometry"
WORSE_MARK = "‡"
"""Marks an ATE that is worse than the odometry's, in tables that have no room for the words."""
VISIBLE = 0.0005
"""Meters that a difference needs in order to be seen in a table."""


def worse_than_odometry(entry: Entry) -> bool:
    """Whether a run's, a score's or a mapped log's ATE is larger than that of the odometry alone."""
    return is_worse(value_at(entry, ATE), value_at(entry, ODOMETRY_ATE))


def is_worse(ate: float | None, odometry: float | None) -> bool:
    """Whether an ATE is visibly larger than the odometry's; False where one of them does not exist."""
    return ate is not None and odometry is not None and ate > odometry + VISIBLE


def worse_lines(entries: Sequence[Entry]) -> list[str]:
    """Return a line for each run whose mapper is worse than its odometry."""
    lines = []
    for entry in filter(worse_than_odometry, entries):
        keys = ("world.name", "config.robot", "config.mapper")
        run = f"{', '.join(text_at(entry, key) for key in keys)}, seed {text_at(entry, 'config.seed')}"
        ate, odometry = value_at(entry, ATE), value_at(entry, ODOMETRY_ATE)
        lines.append(f"{run}: {WORSE} (ATE {ate:.3f} m, odometry {odometry:.3f} m)")
    return lines
