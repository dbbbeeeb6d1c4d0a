"""The monitors: lost mappers, walls that are believed, hillsides that are not."""

from hypothesis import given, strategies as st

from slam_baselines.monitors import LocalizabilityMonitor, MonitorConfig, TrackingMonitor

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


STEP = 0.04
"""Meters between two scans."""


def observed(*scores: float | None, step: float = STEP) -> LocalizabilityMonitor:
    """A monitor that saw these scores."""
    monitor = LocalizabilityMonitor(MonitorConfig())
    for score in scores:
        monitor.observe(score, step)
    return monitor


def test_walls_hold() -> None:
    monitor = observed(*[0.9] * 80)
    assert monitor.localizable
    assert monitor.steady
    assert monitor.proven
    assert monitor.draws(20.0)


def test_hillsides_do_not() -> None:
    monitor = observed(*[0.3, 0.4, 0.65] * 60)
    assert not monitor.localizable
    assert not monitor.believed
    assert not monitor.draws(20.0)


def test_a_robot_that_stands_proves_nothing() -> None:
    """A hillside fits, too, from the same place."""
    assert not observed(*[0.9] * 500, step=0.0).localizable
    assert observed(*[0.9] * 50).localizable


def test_what_held_is_believed_on_while_some_scans_fit() -> None:
    """Less is asked to go on than to begin: a poor stretch between walls is no reason to let go."""
    stretch = [0.3, 0.3, 0.9] * 40
    assert observed(*[0.9] * 60, *stretch).localizable
    assert not observed(*stretch).localizable
    assert not observed(*[0.9] * 60, *[0.3] * 200).localizable


def test_scans_with_nothing_to_match_end_the_trust_until_some_fit_again() -> None:
    monitor = observed(*[0.9] * 60, *[None] * 200)
    assert not monitor.localizable
    assert not monitor.draws(20.0)
    assert not observed(*[0.9] * 60, *[None] * 200, 0.9).localizable
    assert observed(*[0.9] * 60, *[None] * 200, *[0.9] * 12).localizable


def test_walls_that_came_late_are_drawn_once_they_are_sure() -> None:
    """Of a start on a slope few scans fit; a short drive would have no map else."""
    poor_start = [0.3] * 100
    assert not observed(*poor_start, *[0.9] * 30).draws(10.0)
    assert observed(*poor_start, *[0.9] * 220).draws(10.0)
    assert observed(*poor_start * 2, *[0.9] * 260).draws(10.0)
    assert not observed(*poor_start * 5, *[0.9] * 180).draws(10.0)


def test_the_first_meters_are_drawn_until_enough_scans_were_matched() -> None:
    assert observed(*[0.3] * 20).draws(4.0)
    assert not observed(*[0.3] * 20).draws(6.0)
    assert not observed(*[0.3] * 80).draws(4.0)


def test_a_slow_robots_first_faint_walls_are_drawn_while_the_latest_fit() -> None:
    """While it creeps, a map of few scans is faint: they score low, and walls are there all the same."""
    slow = observed(*[0.51] * 20, *[0.7] * 35)
    assert not slow.localizable
    assert slow.draws(1.4)
    assert not slow.draws(6.0)
    assert not observed(*[0.51] * 20, *[0.7] * 35, *[0.3] * 30).draws(2.0)


@given(st.lists(st.none() | st.floats(0.0, 1.0), max_size=200))
def test_no_more_is_proven_than_was_held(scores: list[float | None]) -> None:
    monitor = observed(*scores)
    assert monitor.scans == len(scores)
    assert monitor.localizable or not monitor.steady
    assert not monitor.proven or len(scores) >= MonitorConfig().localizable_memory
