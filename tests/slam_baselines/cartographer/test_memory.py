"""Memory on a large site: it goes with what matching needs, not with the area that each submap saw."""

from slam_baselines.mapper import make_mapper
from tests.slam_baselines.large_site import drive_site


def test_a_large_site_fits_into_600_megabytes():
    drive, mapper, most = drive_site(), make_mapper("cartographer"), 0
    for k, (scan, odometry) in enumerate(zip(drive.scans, drive.odometry, strict=True)):
        pose = mapper.update(scan, odometry, None)
        if k % 20 == 0 or k == len(drive.scans) - 1:
            most = max(most, mapper.stats.memory)
    assert mapper.stats.counts["submaps"] > 60
    assert mapper.stats.counts["loops"] > 50
    assert mapper.stats.counts["submaps_trimmed"] < 10, "what was forgotten needs no memory"
    assert pose.distance(drive.truth[0].inverse() @ drive.truth[-1]) < 3.0
    assert 50e6 < most < 600e6
