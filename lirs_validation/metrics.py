"""What a run is judged by: errors of the trajectory, agreement of the map."""

from lirs_validation.association import associated
from lirs_validation.map_agreement import Agreement, CellDistance, agreement, cell_distance
from lirs_validation.map_metrics import (
    MapScores,
    false_occupied,
    iou,
    map_scores,
    unknown_share,
)
from lirs_validation.planar import rigid_alignment
from lirs_validation.relative_metrics import RelationError, RelativeError
from lirs_validation.ssim import map_ssim
from lirs_validation.trajectory_metrics import TrajectoryErrors, trajectory_errors

__all__ = [
    "Agreement",
    "CellDistance",
    "MapScores",
    "RelationError",
    "RelativeError",
    "TrajectoryErrors",
    "agreement",
    "associated",
    "cell_distance",
    "false_occupied",
    "iou",
    "map_scores",
    "map_ssim",
    "rigid_alignment",
    "trajectory_errors",
    "unknown_share",
]
