"""What a run is judged by: errors of the trajectory, agreement of the map."""

from lirs_validation.map_metrics import (
    Agreement,
    MapScores,
    agreement,
    false_occupied,
    iou,
    map_scores,
    unknown_share,
)
from lirs_validation.trajectory_metrics import (
    RelativeError,
    TrajectoryErrors,
    associated,
    rigid_alignment,
    trajectory_errors,
)

__all__ = [
    "Agreement",
    "MapScores",
    "RelativeError",
    "TrajectoryErrors",
    "agreement",
    "associated",
    "false_occupied",
    "iou",
    "map_scores",
    "rigid_alignment",
    "trajectory_errors",
    "unknown_share",
]
