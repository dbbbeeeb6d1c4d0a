"""HectorSLAM as published: beside the C++ original on its own runs, and what it must not use."""

from pathlib import Path

import numpy as np
import pytest

from lirs_extensions.originals.hector import (
    HectorOriginalConfig,
    HectorOriginalMapper,
    OriginalMap,
    _interpolate,
)
from lirs_validation.metrics.trajectory import trajectory_errors
from lirs_wct import Pose2, Trajectory
from lirs_wct.errors import ConfigError
from lirs_wct.formats.carmen_log import read_carmen
from slam_baselines.mapper import make_mapper
from tests.lirs_extensions.originals.recorded import unpacked
from tests.slam_baselines.synthetic import room_scan


@pytest.mark.shared
@pytest.mark.slow
@pytest.mark.parametrize("run", ["simple-1", "willow-1", "advanced-1", "medium-1", "medium-2"])
def test_it_fails_and_holds_where_the_original_does(shared_data: Path, tmp_path: Path, run: str) -> None:
    """ATE within a factor of two of the original's, on the same side of the odometry's."""
    folder = shared_data / "fidelity" / run
    log, mapper = read_carmen(folder / "scans.clf.gz"), make_mapper("hector_original")
    for scan, odometry in zip(log.scans, log.odometry, strict=True):
        mapper.update(scan, odometry, None)
    truth = unpacked(folder / "truth.tum.gz", tmp_path)
    original = unpacked(folder / "original_hector.tum.gz", tmp_path)
    odometry_alone = Trajectory.from_poses(log.stamps.tolist(), list(log.odometry))
    ours, theirs, raw = (
        trajectory_errors(truth, path).ate_rmse for path in (mapper.trajectory(), original, odometry_alone)
    )
    assert theirs / 2 <= ours <= 2 * theirs
    assert (ours < raw) == (theirs < raw)


@pytest.mark.shared
@pytest.mark.parametrize("run", ["advanced-2", "medium-2", "willow-1"])
def test_the_first_scans_are_matched_as_the_original_matches_them(
    shared_data: Path, tmp_path: Path, run: str
) -> None:
    """Lattice of cells, range limit and steps are the original's.

    In the other runs its single precision puts the end of a beam into the next cell at once, and the poses
    differ by a millimeter from then on.
    """
    folder = shared_data / "fidelity" / run
    log, mapper = read_carmen(folder / "scans.clf.gz"), make_mapper("hector_original")
    original = unpacked(folder / "original_hector.tum.gz", tmp_path)
    for k in range(4):
        found = mapper.update(log.scans[k], log.odometry[k], None)
        assert found.distance(original.pose2(k)) < 2e-5
        assert abs(found.yaw - original.pose2(k).yaw) < 2e-5


def test_interpolation_is_exact_at_the_cells_centers() -> None:
    field = np.random.default_rng(1).random((6, 7)).astype(np.float32)
    for row in range(5):
        for col in range(6):
            assert _interpolate(field, float(col), float(row))[0] == pytest.approx(field[row, col])
    assert _interpolate(field, 6.0, 2.0) == (0.0, 0.0, 0.0)
    assert _interpolate(field, -0.1, 2.0) == (0.0, 0.0, 0.0)


def test_a_hit_wins_over_a_beam_that_passes() -> None:
    """Two beams of one scan: the longer passes the cell that the shorter hits, which stays a hit."""
    level = OriginalMap(0.1, 64, miss=-0.4, hit=2.2)
    level.draw(Pose2(), np.zeros(2), np.array(((1.0, 0.0), (2.0, 0.0))))
    grid = level.occupancy_grid()
    row = grid.log_odds[np.flatnonzero((grid.log_odds > 0).any(axis=1))[0]]
    np.testing.assert_allclose(row[[0, 5, 10, 15, 20]], (-0.4, -0.4, 2.2, -0.4, 2.2), atol=1e-6)


def test_beams_that_leave_the_map_are_not_drawn() -> None:
    """The map is 1.6 m long, from -0.85 to 0.75 m: one of the two beams ends inside."""
    level = OriginalMap(0.1, 16, miss=-0.4, hit=2.2)
    level.draw(Pose2(), np.zeros(2), np.array(((0.7, 0.0), (0.0, 0.8))))
    grid = level.occupancy_grid()
    assert (grid.log_odds.shape, grid.origin.x, grid.origin.y) == ((1, 8), -0.05, -0.05)
    assert grid.log_odds[0, -1] > 0
    level.draw(Pose2(1e300, -1e300), np.zeros(2), np.array(((0.7, 0.0),)))
    np.testing.assert_array_equal(level.occupancy_grid().log_odds, grid.log_odds)


def test_outside_its_map_it_follows_the_odometry() -> None:
    """Nothing is drawn and nothing allocated, however far the estimate is."""
    mapper = HectorOriginalMapper(HectorOriginalConfig(map_size=256))
    rng = np.random.default_rng(0)
    mapper.update(room_scan(Pose2(), 0.0, rng), Pose2(), None)
    drawn, memory = mapper.map().occupied.sum(), mapper.stats.memory
    assert drawn > 0
    for k, x in enumerate((1e2, 1e6, 1e15), start=1):
        assert mapper.update(room_scan(Pose2(), float(k), rng), Pose2(x), None) == Pose2(x)
    assert (mapper.map().occupied.sum(), mapper.stats.memory) == (drawn, memory)
    assert memory == 256**2 * (1 + 1 / 4 + 1 / 16) * 12


@pytest.mark.parametrize("size", [0, 2050])
def test_a_map_that_cannot_be_halved_is_refused(size: int) -> None:
    with pytest.raises(ConfigError, match="map_size must be a multiple of 8"):
        HectorOriginalConfig(map_size=size)


@pytest.mark.shared
def test_a_map_of_its_size_holds_a_sparse_log_of_a_campus(shared_data: Path, tmp_path: Path) -> None:
    """The drive leads 54 m away from its start; the original has an ATE of 0.73 m there."""
    folder = shared_data / "logs" / "edmonton"
    log, mapper = read_carmen(folder / "edmonton.clf.gz"), make_mapper("hector_original")
    for scan, odometry in zip(log.scans, log.odometry, strict=True):
        mapper.update(scan, odometry, None)
    truth = unpacked(folder / "reference_poses.tum.gz", tmp_path)
    assert 0.73 / 2 < trajectory_errors(truth, mapper.trajectory()).ate_rmse < 2 * 0.73
