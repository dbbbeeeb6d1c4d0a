"""How fast a drive goes on under a person's eyes, whether it goes on, and whether the view follows."""

from __future__ import annotations

import time
from collections.abc import Callable

import viser

from lirs_validation.gui.view.drive_scene import DriveScene
from lirs_validation.gui.view.guard import Guard

SPEEDS = {"1 x real time": 1.0, "2 x": 2.0, "5 x": 5.0, "10 x": 10.0, "as fast as it goes": float("inf")}


class Pace:
    """A dropdown of speeds, and the simulated time that the chosen one leads to.

    Args:
        gui: of the page.
        guard: of its callbacks.
        speeds: names to choose from, of SPEEDS.
        initial: name of the first.
        now: returns the simulated time that is shown, seconds.
    """

    def __init__(
        self, gui: viser.GuiApi, guard: Guard, speeds: tuple[str, ...], initial: str, now: Callable[[], float]
    ) -> None:
        self._now, self._clock = now, (0.0, 0.0)
        self._speed = gui.add_dropdown("speed", speeds, initial_value=initial)
        self._speed.on_update(guard(lambda _: self.wind()))

    def wind(self) -> None:
        """Let the pace begin at this moment."""
        self._clock = time.monotonic(), self._now()

    def time(self, ahead: float = 0.0) -> float:
        """Return the simulated time to which the pace leads, so many wall seconds from now."""
        wall, simulated = self._clock
        return simulated + SPEEDS[self._speed.value] * (time.monotonic() - wall + ahead)


class PlayButton:
    """Starts and pauses; says which of both it would do.

    Args:
        gui: of the page.
        guard: of its callbacks.
        label: while it would start.
        play: called to start.
        pause: called to pause.
        color: of the button.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        guard: Guard,
        label: str,
        play: Callable[[], None],
        pause: Callable[[], None],
        color: str | None = None,
    ) -> None:
        self._label, self.running = label, False
        self._button = gui.add_button(label, color=color, icon=viser.Icon.PLAYER_PLAY, disabled=True)  # type: ignore[arg-type]
        self._button.on_click(guard(lambda _: pause() if self.running else play()))

    def show(self, running: bool) -> None:
        """Show whether the drive goes on."""
        self.running = running
        self._button.label = "Pause" if running else self._label
        self._button.icon = viser.Icon.PLAYER_PAUSE if running else viser.Icon.PLAYER_PLAY

    def enable(self, enabled: bool) -> None:
        """Let it be clicked, or not."""
        self._button.disabled = not enabled


def add_follow(gui: viser.GuiApi, guard: Guard, scene: DriveScene) -> Callable[[], None]:
    """Add the choice whether the view follows the robot; return what tells it to the scene anew."""
    box = gui.add_checkbox("follow robot", True)

    def apply() -> None:
        scene.follow = box.value

    box.on_update(guard(lambda _: apply()))
    return apply
