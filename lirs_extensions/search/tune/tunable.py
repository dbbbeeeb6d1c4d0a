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
        name: field of the configuration, `part.field` of a part.
        low: smallest plausible value.
        high: largest plausible value.
        log: whether equal steps multiply the value.
        ros: name of the ROS parameter or path in Cartographer's Lua tables; empty = as `name`.
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
_INSERTER = f"{_BUILDER}.submaps.range_data_inserter.probability_grid_range_data_inserter"


def _lua(table: str, name: str, low: float, high: float, *, part: str = "", log: bool = True) -> Tunable:
    """Return a parameter whose path in the Lua table is that of its field."""
    return Tunable(f"{part}{name}", low, high, log, f"{table}.{name}")


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
        _lua(_BUILDER, "submaps.num_range_data", 20, 200, part="local."),
        _lua(_BUILDER, "motion_filter.max_distance_meters", 0.05, 0.5, part="local."),
        _lua(_BUILDER, "motion_filter.max_angle_radians", 0.01, 0.5, part="local."),
        Tunable("graph.optimize_every_n_nodes", 10, 200, ros=f"{_GRAPH}.optimize_every_n_nodes"),
    ),
    "cartographer_original": (
        _lua(_BUILDER, "max_range", 5.0, 60.0),
        _lua(_BUILDER, "voxel_filter_size", 0.01, 0.1),
        _lua(_BUILDER, "ceres_scan_matcher.translation_weight", 0.1, 100.0),
        _lua(_BUILDER, "ceres_scan_matcher.rotation_weight", 0.1, 400.0),
        Tunable("max_distance_meters", 0.05, 0.5, ros=f"{_BUILDER}.motion_filter.max_distance_meters"),
        Tunable("max_angle_radians", 0.005, 0.2, ros=f"{_BUILDER}.motion_filter.max_angle_radians"),
        Tunable("num_range_data", 20, 200, ros=f"{_BUILDER}.submaps.num_range_data"),
        Tunable("hit_probability", 0.51, 0.7, False, f"{_INSERTER}.hit_probability"),
        Tunable("miss_probability", 0.4, 0.49, False, f"{_INSERTER}.miss_probability"),
        _lua(_GRAPH, "constraint_builder.min_score", 0.4, 0.8, part="pose_graph.", log=False),
        Tunable(
            "pose_graph.odometry_translation_weight", 1e2, 1e6,
            ros=f"{_GRAPH}.optimization_problem.odometry_translation_weight",
        ),
        Tunable(
            "pose_graph.odometry_rotation_weight", 1e2, 1e6,
            ros=f"{_GRAPH}.optimization_problem.odometry_rotation_weight",
        ),
    ),
}  # fmt: skip
"""Parameters by mapper."""


def usual_values(mapper: str) -> dict[str, float]:
    """Return the default of each of a mapper's parameters by name."""
    found = {}
    for tunable in TUNABLE[mapper]:
        value = make_mapper(mapper).config  # type: ignore[attr-defined]
        for part in tunable.name.split("."):
            value = getattr(value, part)
        found[tunable.name] = value
    return found
