"""The timeline of a drive, without a browser."""

import asyncio
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

viser = pytest.importorskip("viser")

from lirs_envs.sensing.sensors import Observation  # noqa: E402
from lirs_validation.experiment.drive import DriveLog  # noqa: E402
from lirs_validation.gui.playback import Moment, Playback  # noqa: E402
from lirs_validation.gui.tabs import ReplayTab  # noqa: E402
from lirs_wct.geometry import Imu, LaserScan, Pose2, Pose3  # noqa: E402


def drive() -> Playback:
    """Return five seconds of standing, ten scans a second."""
    log = DriveLog()
    for k in range(51):
        scan = LaserScan(np.ones(3, np.float32), -0.1, 0.1, 0.1, 10.0, stamp=k * 0.1)
        log.add(Observation(scan, Pose2(), Imu()), Pose3(), Pose2())
    return Playback("husky", None, 5.0, log)


class _Scene:
    def __init__(self) -> None:
        self.times: list[float] = []
        self.follow = False

    def begin(self, robot: str, world: Any) -> None:
        pass

    def approach(self, position: np.ndarray) -> None:
        pass

    def show(self, moment: Moment) -> None:
        self.times.append(moment.time)

    def show_course(self, curve: np.ndarray, marks: Any) -> None:
        assert curve.shape == (5, 3)


@pytest.fixture
def gui() -> Iterator[Any]:
    server = viser.ViserServer(port=0, verbose=False)
    yield server.gui
    server.stop()


def replay(gui: Any) -> tuple[Any, _Scene, list[Callable[[], None]]]:
    """Return a tab, its scene and the jobs that it submits."""
    jobs: list[Callable[[], None]] = []
    scene = _Scene()
    worker = SimpleNamespace(
        submit=lambda kind, job: jobs.append(job), repeat=lambda job: job and jobs.append(job)
    )
    client, guard = SimpleNamespace(gui=gui), lambda callback: callback
    page: Any = SimpleNamespace(client=client, guard=guard, drive_scene=scene, worker=worker)
    return ReplayTab(page, None, lambda: None), scene, jobs


def test_a_drag_keeps_its_time_while_another_moment_is_shown(gui: Any) -> None:
    tab, scene, jobs = replay(gui)
    tab._begin(drive())
    tab._slider.value = 1.0
    asyncio.run(tab._go_to_slider(SimpleNamespace(client_id=1)))
    tab._show_scan(50)
    jobs.pop()()
    assert scene.times == pytest.approx([0.0, 5.0, 1.0])


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that only sleeping advances."""
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr("time.monotonic", lambda: clock.now)
    monkeypatch.setattr("time.sleep", lambda seconds: setattr(clock, "now", clock.now + seconds))


@pytest.mark.usefixtures("clock")
def test_a_run_plays_to_its_end_and_again_from_its_start(gui: Any) -> None:
    tab, scene, jobs = replay(gui)
    tab._begin(drive())
    for _ in range(2):
        scene.times.clear()
        tab.press_play()
        play = jobs.pop()
        while tab.running:
            play()
        assert scene.times[0] < 3.0
        assert scene.times == sorted(scene.times)
        assert scene.times[-1] == pytest.approx(5.0)
        assert len(scene.times) == pytest.approx(5.0 / 10 / 0.15, abs=2)  # 10 x, a picture each 0.12 s


@pytest.mark.usefixtures("clock")
def test_a_drive_that_was_slow_does_not_make_up_for_it(gui: Any) -> None:
    tab, _, _ = replay(gui)
    slow = SimpleNamespace(over=False, time=0.0, speed=4.0)

    def drive_on(until: float, time_limit: float) -> None:
        slow.time = min(time_limit, slow.time + slow.speed * 0.05)

    slow.drive_on = drive_on
    tab.playback, tab.running, tab._shown_at = slow, True, np.inf
    tab._restart_clock()
    for _ in range(40):
        tab._play_slice()
    assert slow.time == pytest.approx(2 * 4.0)
    slow.speed = 1000.0
    for _ in range(40):
        tab._play_slice()
    assert slow.time == pytest.approx(2 * 4.0 + 2 * 10.0)
