"""Parameters of the mappers that a search may change, limits and ROS names.

Number of particles, cell size and the like are choices of cost and are left out. Names: `slam_gmapping` and
`hector_mapping` call their ROS parameters like our fields, Cartographer's are paths in its Lua tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from slam_baselines.mapper import make_mapper


class Tunable(NamedTuple):
    """One parameter that a search may change.

    Attributes:
        name: Field of the configuration.
        low: Smallest plausible value.
        high: Largest plausible value.
        log: Whether equal steps multiply the value.
        ros: Name of the ROS parameter or path in Cartographer's Lua tables; empty = as `name`.
    """

    name: str
    low: float
    high: float
    log: bool = True
    ros: str = ""

    @property
    def ros_name(self) -> str:
        """Name for the ROS node."""
        return self.ros or self.name


_MOTION = tuple(Tunable(name, 0.01, 0.5) for name in ("srr", "srt", "str", "stt"))
_GMAPPING = (
    Tunable("linearUpdate", 0.1, 2.0),
    Tunable("angularUpdate", 0.1, 1.0),
    Tunable("resampleThreshold", 0.1, 1.0, log=False),
    *_MOTION,
)
_HECTOR = (
    Tunable("map_multi_res_levels", 1, 3, log=False),
    Tunable("map_update_distance_thresh", 0.05, 1.0),
    Tunable("map_update_angle_thresh", 0.05, 1.5),
)
_BUILDER, _GRAPH = "TRAJECTORY_BUILDER_2D", "POSE_GRAPH"
_MATCHER = f"{_BUILDER}.ceres_scan_matcher"
_INSERTER = f"{_BUILDER}.submaps.range_data_inserter.probability_grid_range_data_inserter"


def _lua(path: str, low: float, high: float, *, name: str = "", log: bool = True) -> Tunable:
    """Return a parameter of Cartographer, whose field is called as in Lua unless named."""
    return Tunable(name or path.rpartition(".")[2], low, high, log, path)


TUNABLE: Mapping[str, tuple[Tunable, ...]] = {
    "gmapping": (*_GMAPPING, Tunable("ogain", 0.1, 5.0)),
    "gmapping_original": (
        *_GMAPPING,
        Tunable("ogain", 0.5, 10.0),
        Tunable("sigma", 0.01, 0.2),
        Tunable("kernelSize", 1, 3, log=False),
        Tunable("lstep", 0.02, 0.2),
        Tunable("astep", 0.02, 0.2),
        Tunable("iterations", 2, 8, log=False),
        Tunable("lsigma", 0.02, 0.3),
        Tunable("maxUrange", 5.0, 80.0),
    ),
    "hector": _HECTOR,
    "hector_original": (
        *_HECTOR,
        Tunable("update_factor_free", 0.3, 0.49, log=False),
        Tunable("update_factor_occupied", 0.55, 0.95, log=False),
        Tunable("laser_min_dist", 0.1, 1.0),
        Tunable("laser_max_dist", 4.0, 30.0),
    ),
    "cartographer": (
        _lua(f"{_BUILDER}.submaps.num_range_data", 20, 200),
        _lua(f"{_BUILDER}.motion_filter.max_distance_meters", 0.05, 0.5),
        _lua(f"{_BUILDER}.motion_filter.max_angle_radians", 0.01, 0.5),
        _lua(f"{_GRAPH}.optimize_every_n_nodes", 10, 200),
    ),
    "cartographer_original": (
        _lua(f"{_BUILDER}.max_range", 5.0, 60.0),
        _lua(f"{_BUILDER}.voxel_filter_size", 0.01, 0.1),
        _lua(f"{_MATCHER}.translation_weight", 0.1, 100.0, name="ceres_translation_weight"),
        _lua(f"{_MATCHER}.rotation_weight", 0.1, 400.0, name="ceres_rotation_weight"),
        _lua(f"{_BUILDER}.motion_filter.max_distance_meters", 0.05, 0.5),
        _lua(f"{_BUILDER}.motion_filter.max_angle_radians", 0.005, 0.2),
        _lua(f"{_BUILDER}.submaps.num_range_data", 20, 200),
        _lua(f"{_INSERTER}.hit_probability", 0.51, 0.7, log=False),
        _lua(f"{_INSERTER}.miss_probability", 0.4, 0.49, log=False),
        _lua(f"{_GRAPH}.constraint_builder.min_score", 0.4, 0.8, log=False),
        _lua(f"{_GRAPH}.optimization_problem.odometry_translation_weight", 1e2, 1e6),
        _lua(f"{_GRAPH}.optimization_problem.odometry_rotation_weight", 1e2, 1e6),
    ),
}
"""Parameters by mapper."""


def default_parameters(mapper: str) -> dict[str, float]:
    """Return the default of each of a mapper's parameters by name."""
    config = make_mapper(mapper).config  # type: ignore[attr-defined]
    return {tunable.name: getattr(config, tunable.name) for tunable in TUNABLE[mapper]}
