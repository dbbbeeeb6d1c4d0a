"""The memory of many maps on a site that is seen from afar."""

import numpy as np
import pytest

from slam_baselines.gmapping.copy_on_write_map import PatchMaps
from slam_baselines.gmapping.mapper import GmappingConfig, GmappingMapper
from slam_baselines.scan.leveling import ScanPoints
from tests.slam_baselines.large_site import drive_site

LIMIT = 1.5e9
"""Bytes; before free space was kept apart from hits it were over 3e9."""


@pytest.mark.slow
def test_thirty_particles_on_a_large_site_fit_in_memory() -> None:
    drive, mapper = drive_site(), GmappingMapper(GmappingConfig(particles=30, seed=1))
    for k, (scan, odometry) in enumerate(zip(drive.scans, drive.odometry, strict=True)):
        pose = mapper.update(scan, odometry, None)
        if k % 50 == 0:
            assert mapper.stats.memory <= LIMIT
    assert mapper.stats.memory <= LIMIT
    assert (drive.truth[0] @ pose).distance(drive.truth[-1]) < 5


def test_free_space_costs_a_byte_a_cell() -> None:
    """A beam over open ground takes patches, and one record where it ends."""
    maps = PatchMaps(1, 0.05)
    hits = np.array(((60.0, 0.02, 0.0),))
    scan = ScanPoints(np.zeros(3), hits, np.zeros((0, 3)))
    maps.draw_scan(np.zeros((1, 3)), scan, np.zeros(1, np.uint8), 0)
    records = len(maps.patches.hits) - int(maps.patches.free_records[0])
    assert (maps.in_use, records) == (76, 1)


def test_records_of_the_dead_are_used_again() -> None:
    maps = PatchMaps(3, 0.05)
    angle = np.linspace(0, 2 * np.pi, 200)
    hits = np.stack((3 * np.cos(angle), 3 * np.sin(angle), np.zeros(200)), axis=1)
    scan, poses = ScanPoints(np.zeros(3), hits, np.zeros((0, 3))), np.zeros((3, 3))
    for k in range(30):
        poses[:, 0] = 0.01 * k * np.arange(3)
        maps.draw_scan(poses, scan, np.zeros(200, np.uint8), 0)
        maps.descend(np.array([1, 1, 1]))
        used = maps.patches.record[maps.patches.owners > 0]
        used = used[used >= 0]
        assert len(np.unique(used)) == len(used)
        assert len(maps.patches.hits) - int(maps.patches.free_records[0]) == len(used)
    assert len(maps.patches.hits) < 2000
