"""Metrics of a run: errors of the trajectory, agreement of the map."""

from lirs_validation.metrics.agreement import Agreement, CellDistance, agreement, cell_distance, map_ssim
from lirs_validation.metrics.alignment import (
    StartAlignment,
    associated,
    rigid_alignment,
    scan_coverage,
    start_alignment,
)
from lirs_validation.metrics.map import MapScores, false_occupied, iou, map_scores, unknown_share
from lirs_validation.metrics.relative_pose_error import ConstraintErrorSummary, RelativePoseError
from lirs_validation.metrics.trajectory import TrajectoryErrors, trajectory_errors

__all__ = [
    "Agreement",
    "CellDistance",
    "ConstraintErrorSummary",
    "MapScores",
    "RelativePoseError",
    "StartAlignment",
    "TrajectoryErrors",
    "agreement",
    "associated",
    "cell_distance",
    "false_occupied",
    "iou",
    "map_scores",
    "map_ssim",
    "rigid_alignment",
    "scan_coverage",
    "start_alignment",
    "trajectory_errors",
    "unknown_share",
]
