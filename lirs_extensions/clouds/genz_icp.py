"""GenZ-ICP, which extends KISS-ICP, in the authors' package.

Lee et al., "GenZ-ICP: Generalizable and Degeneracy-Robust LiDAR Odometry Using an Adaptive Weighting" (RA-L
2025).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.checks import Checked, limited
from slam_baselines.kiss_icp import CloudOdometry


@dataclass(frozen=True, kw_only=True)
class GenzIcpConfig(Checked, of="genz-icp"):
    """Configurable parameters of GenZ-ICP; the defaults are the authors'.

    Its native code sums in another order each time: two runs of the same clouds differ by millimeters.

    Attributes:
        max_range: points beyond are left out, meters.
        min_range: points nearer are left out, meters.
        voxel_size: edge of the map's voxels at the start, meters; the method adapts it.
    """

    max_range: float = limited(100.0, "(0, inf)", "m")
    min_range: float = limited(0.3, "[0, inf]", "m")
    voxel_size: float = limited(0.3, "(0, inf)", "m")


def make_genz_icp(config: GenzIcpConfig) -> CloudOdometry:
    """Return GenZ-ICP as a mapper; like the authors' program, it ignores times in a sweep."""
    from genz_icp.config import GenZConfig
    from genz_icp.genz_icp import GenZICP

    settings = GenZConfig()
    settings.data.max_range, settings.data.min_range = config.max_range, config.min_range
    settings.mapping.voxel_size = config.voxel_size
    odometry = GenZICP(settings)

    def register(points: FloatArray, times: FloatArray) -> FloatArray:
        odometry.register_frame(points, np.empty(0))
        pose: FloatArray = odometry.last_pose.copy()
        return pose

    return CloudOdometry(register)
