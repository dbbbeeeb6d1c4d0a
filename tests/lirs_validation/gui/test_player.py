"""The timeline of a drive, without a browser."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

viser = pytest.importorskip("viser")

from lirs_validation.gui.session.playback import Moment  # noqa: E402
from lirs_validation.gui.view.playback_tabs import Player  # noqa: E402
from lirs_wct.geometry.pose import Pose3  # noqa: E402


class _Drive:
    robot, world, scans, marks = "husky", None, 51, ()

    def curve(self) -> np.ndarray:
        return np.empty((0, 3))

    def moment(self, scan: int) -> Moment:
        track = np.zeros((1, 3))
        scanned = np.zeros((0, 3), np.float32)
        return Moment(
            scan * 0.1, Pose3(), np.zeros(3), scanned, track, track[:, :2], None, (), "Verdict: none"
        )


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
    player.begin(_Drive(), 5.0)
    slider: Any = player._slider
    slider.value = 1.0
    player._go_to_slider(_Event(client_id=1))
    player.show(50)
    jobs.pop()()
    assert player.scan == 10
    assert scene.times == pytest.approx([0.0, 5.0, 1.0])
