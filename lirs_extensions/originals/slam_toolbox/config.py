"""Parameters of the original, by the names of its `mapper_params_online_sync.yaml`."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from lirs_wct.errors import Checked, limited, require_within

MOST_CELLS = 10_000
"""Largest number of cells along a range or along an edge of the search."""


@dataclass(frozen=True, kw_only=True)
class SlamToolboxOriginalConfig(Checked, of="slam_toolbox_original"):
    """Parameters of slam_toolbox with its defaults.

    `loop_search_space_*` are for the loop search what `correlation_search_space_*` are for the other matches.

    Attributes:
        resolution: Edge of a cell of the map that is drawn, meters.
        throttle_scans: Number N: only every Nth scan can pass the gate.
        minimum_time_interval: Least time since the last scan that passed the gate, seconds.
        minimum_travel_distance: Distance to drive before the next scan becomes a node, meters.
        minimum_travel_heading: Turn before the next scan becomes a node, radians. It acts only on scans that
            passed the gate, for which the robot must have moved 0.9 of the distance.
        min_laser_range: Nearer hits do not count for the center of a scan, meters.
        max_laser_range: Farther hits do not either, and the grid of the matcher ends there, meters; they are
            matched all the same.
        no_return_share: Ranges from this share of the lidar's largest on are beams without return.
        use_scan_matching: Whether scans are matched; without, the odometry stays.
        use_scan_barycenter: Whether distances of nodes are those of the centers of their hits.
        use_response_expansion: Whether a match without any response is repeated with larger turns.
        scan_buffer_size: Nodes that the next scan is matched with.
        scan_buffer_maximum_scan_distance: Largest distance between the first and the last of them, meters.
        link_match_minimum_response_fine: Response of a match with a chain of near nodes that links to it.
        link_scan_maximum_distance: Largest distance of linked nodes, meters.
        do_loop_closing: Whether loops are searched for.
        loop_search_maximum_distance: Distance up to which nodes may be the other end of a loop, meters.
        loop_match_minimum_chain_size: Least number of nodes of a chain.
        loop_match_maximum_variance_coarse: Largest standard deviation of a coarse match in x and y, meters.
        loop_match_minimum_response_coarse: Response of a coarse match from which on it is refined.
        loop_match_minimum_response_fine: Response of a refined match from which on it closes a loop.
        correlation_search_space_dimension: Edge of the square that is searched, meters.
        correlation_search_space_resolution: Edge of a cell of the matcher, meters.
        correlation_search_space_smear_deviation: Standard deviation of the blur of the hits, meters.
        distance_variance_penalty: Distance whose square scales the penalty of a shift, meters.
        angle_variance_penalty: Angle whose square scales the penalty of a turn, radians.
        fine_search_angle_offset: Step of the headings of the second stage, radians.
        coarse_search_angle_offset: Largest turn of the first stage, radians.
        coarse_angle_resolution: Step of the headings of the first stage, radians.
        minimum_angle_penalty: Smallest factor by which a turn lowers the response.
        minimum_distance_penalty: Smallest factor by which a shift lowers the response.

    Raises:
        ConfigError: a value is not legal, a grid would be too fine or too coarse for what it holds, or a step
            of the headings is larger than the turn that it divides.
    """

    resolution: float = limited(0.05, "(0, inf]", "m")
    throttle_scans: int = limited(1, "[1, inf]")
    minimum_time_interval: float = limited(0.5, "[0, inf]")
    minimum_travel_distance: float = limited(0.5, "[0, inf]")
    minimum_travel_heading: float = limited(0.5, "[0, inf]")
    min_laser_range: float = limited(0.0, "[0, inf)", "m")
    max_laser_range: float = limited(20.0, "(0, inf]", "m")
    no_return_share: float = limited(0.999, "(0, inf]")
    use_scan_matching: bool = True
    use_scan_barycenter: bool = True
    use_response_expansion: bool = True
    scan_buffer_size: int = limited(10, "[1, inf]")
    scan_buffer_maximum_scan_distance: float = limited(10.0, "(0, inf]", "m")
    link_match_minimum_response_fine: float = limited(0.1, "[0, 1]")
    link_scan_maximum_distance: float = limited(1.5, "(0, inf]", "m")
    do_loop_closing: bool = True
    loop_search_maximum_distance: float = limited(3.0, "(0, inf]", "m")
    loop_match_minimum_chain_size: int = limited(10, "[1, inf]")
    loop_match_maximum_variance_coarse: float = limited(3.0, "(0, inf]", "m")
    loop_match_minimum_response_coarse: float = limited(0.35, "[0, 1]")
    loop_match_minimum_response_fine: float = limited(0.45, "[0, 1]")
    correlation_search_space_dimension: float = limited(0.5, "(0, inf]", "m")
    correlation_search_space_resolution: float = limited(0.01, "(0, inf]", "m")
    correlation_search_space_smear_deviation: float = limited(0.1, "(0, inf]", "m")
    loop_search_space_dimension: float = limited(8.0, "(0, inf]", "m")
    loop_search_space_resolution: float = limited(0.05, "(0, inf]", "m")
    loop_search_space_smear_deviation: float = limited(0.03, "(0, inf]", "m")
    distance_variance_penalty: float = limited(0.5, "(0, inf]", "m")
    angle_variance_penalty: float = limited(1.0, "(0, inf]")
    fine_search_angle_offset: float = limited(0.00349, "(0, 1]")
    coarse_search_angle_offset: float = limited(0.349, "(0, 3.2]")
    coarse_angle_resolution: float = limited(0.0349, "(0, 1]")
    minimum_angle_penalty: float = limited(0.9, "[0, 1]")
    minimum_distance_penalty: float = limited(0.5, "[0, 1]")

    def __post_init__(self) -> None:
        super().__post_init__()
        for grid in ("correlation_search_space", "loop_search_space"):
            cell, of = getattr(self, f"{grid}_resolution"), f"the grid of {grid}"
            require_within(self, f"[{2 * cell}, {MOST_CELLS * cell}]", f"{grid}_dimension", of=of, unit="m")
            require_within(self, f"[{cell}, {MOST_CELLS * cell}]", "max_laser_range", of=of, unit="m")
            require_within(self, f"[{cell / 2}, {10 * cell}]", f"{grid}_smear_deviation", of=of, unit="m")
        steps = "fine_search_angle_offset", "coarse_angle_resolution", "coarse_search_angle_offset"
        for step, whole in pairwise(steps):
            require_within(self, f"(0, {getattr(self, whole)}]", step, of=f"{whole} {getattr(self, whole)}")
