"""Each third-party system that is installed follows a short drive."""

import pytest

from lirs_validation import validate
from slam_baselines.mapper import CLOUD_MAPPERS

INSTALLED = [name for name, method in CLOUD_MAPPERS.items() if method.installed]
LARGE = {"kiss-icp": 0.2, "evalio:kiss": 0.2, "rko-lio": 0.15, "evalio:loam": 1.0}
"""Largest ATE of systems with voxels of a meter or without a map, meters."""
SMALL = 0.04


@pytest.mark.slow
@pytest.mark.parametrize("name", INSTALLED)
def test_a_system_follows_a_drive(name: str) -> None:
    """Standing still would be wrong by 1.5 m; another frame, mount or stamp by more than the bounds."""
    config = {"robot": "jackal", "lidar": "vlp16", "scan_time": "rolling", "stand": 3.0, "seconds": 13.0}
    record = validate("medium", mapper=name, **config).record
    assert record.status == "ok"
    assert record.trajectory["length"] > 6
    assert record.trajectory["ate_rmse_3d"] < LARGE.get(name, SMALL)
    assert set(record.versions) >= {CLOUD_MAPPERS[name].distribution}
