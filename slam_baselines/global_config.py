"""Parameters of global SLAM."""

from __future__ import annotations

from dataclasses import dataclass, field

from lirs_wct.errors import ConfigError
from slam_baselines.confirmation import ConfirmationConfig
from slam_baselines.constraint import ConstraintConfig
from slam_baselines.loop_queue import QueueConfig
from slam_baselines.pose_graph import OptimizationConfig
from slam_baselines.trimming import TrimmingConfig


@dataclass(frozen=True, kw_only=True)
class GlobalConfig:
    """Parameters of global SLAM; names as in Cartographer's pose_graph.

    Attributes:
        queue: which searches are made.
        constraints: how they are made.
        confirmation: which loops need a second one.
        optimization: of the graph.
        trimming: which submaps are forgotten.
        optimize_every_n_nodes: the graph is solved after so many new nodes, if there are new loops.
        searches_per_update: at most so many searches in one update.
        matcher_translation_error: standard deviation of a node's place in a submap that it entered, metres.
        matcher_rotation_error: likewise of its yaw, radians.

    Raises:
        ConfigError: a value that is not above 0.
    """

    queue: QueueConfig = field(default_factory=QueueConfig)
    constraints: ConstraintConfig = field(default_factory=ConstraintConfig)
    confirmation: ConfirmationConfig = field(default_factory=ConfirmationConfig)
    optimization: OptimizationConfig = field(default_factory=OptimizationConfig)
    trimming: TrimmingConfig = field(default_factory=TrimmingConfig)
    optimize_every_n_nodes: int = 40
    searches_per_update: int = 1
    matcher_translation_error: float = 0.03
    matcher_rotation_error: float = 0.01

    def __post_init__(self) -> None:
        if min(self.optimize_every_n_nodes, self.searches_per_update) < 1:
            raise ConfigError("optimize_every_n_nodes and searches_per_update must be at least 1")
        if not (self.matcher_translation_error > 0 and self.matcher_rotation_error > 0):
            raise ConfigError("matcher_translation_error and matcher_rotation_error must be above 0")
