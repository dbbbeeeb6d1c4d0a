"""The timeline of a drive, without a browser."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

viser = pytest.importorskip("viser")

from lirs_validation.gui.session.playback import Moment, Playback  # noqa: E402
from lirs_validation.gui.view.playback_tabs import Player  # noqa: E402
from lirs_wct import LaserScan, Pose3  # noqa: E402


def drive() -> Playback:
    """Return five seconds of standing, ten scans a second."""
    standing = Playback("husky", None, 5.0)
    for k in range(51):
        scan = LaserScan(np.ones(3, np.float32), -0.1, 0.1, 0.1, 10.0, stamp=k * 0.1)
        standing.add(scan, Pose3(), (0.0, 0.0))
    return standing


class _Scene:
    def __init__(self) -> None:
        self.times: list[float] = []

    def begin(self, robot: str, world: Any) -> None:
        pass

    def show(self, moment: Moment) -> None:
        self.times.append(moment.time)

    def show_course(self, curve: np.ndarray, marks: Any) -> None:
        pass


@dataclass
class _Event:
    client_id: int | None


@pytest.fixture
def gui() -> Iterator[Any]:
    server = viser.ViserServer(port=0, verbose=False)
    yield server.gui
    server.stop()


def test_a_drag_keeps_its_time_while_another_moment_is_shown(gui: Any) -> None:
    jobs: list[Callable[[], None]] = []
    scene: Any = _Scene()
    guard: Any = lambda callback: callback  # noqa: E731
    player = Player(gui, guard, scene, lambda: None, lambda kind, job: jobs.append(job))
    player.begin(drive())
    slider: Any = player._slider
    slider.value = 1.0
    player._go_to_slider(_Event(client_id=1))
    player.show(50)
    jobs.pop()()
    assert player.time == pytest.approx(1.0)
    assert scene.times == pytest.approx([0.0, 5.0, 1.0])
