"""The tracking monitor: "lost" means the same in every mapper."""

from slam_baselines.monitors import MonitorConfig, TrackingMonitor

CONFIG = MonitorConfig(lost_score=0.3, known_ratio=0.3, lost_after=3)


def test_lost_after_so_many_in_a_row_and_back_with_the_first_that_fits() -> None:
    monitor = TrackingMonitor(CONFIG)
    assert monitor.observe(0.8)
    assert [(monitor.observe(0.1), monitor.lost) for _ in range(4)] == [
        (False, False),
        (False, False),
        (False, True),
        (False, True),
    ]
    assert monitor.observe(0.3)
    assert not monitor.lost


def test_a_map_that_holds_nothing_yet_cannot_be_contradicted() -> None:
    building, given = TrackingMonitor(CONFIG), TrackingMonitor(CONFIG, map_given=True)
    assert all(building.observe(0.1) for _ in range(5))
    assert not any(given.observe(0.1) for _ in range(5))
    assert (building.lost, given.lost) == (False, True)


def test_a_scan_on_unknown_ground_says_nothing() -> None:
    monitor = TrackingMonitor(CONFIG)
    monitor.observe(0.8)
    monitor.observe(0.1)
    assert monitor.observe(0.1, known=0.29)
    monitor.observe(0.1)
    assert monitor.observe(None)
    monitor.observe(0.1, known=0.3)
    monitor.observe(0.1)
    assert not monitor.lost
