"""The tab where a robot drives and maps, by itself or by hand."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import viser

from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.session.construction import Shown, zipped
from lirs_validation.gui.session.live_drive import LiveDrive
from lirs_validation.gui.session.worker import Worker
from lirs_validation.gui.view.drive_scene import DriveScene
from lirs_validation.gui.view.guard import Guard
from lirs_validation.gui.view.player import Player
from lirs_validation.gui.view.scene import Scene
from lirs_validation.gui.view.widgets.progress import ProgressLine
from lirs_validation.gui.view.widgets.run_controls import RunControls
from lirs_validation.gui.view.widgets.stick import Stick
from lirs_wct.errors import ConfigError

SPEEDS = {"1 x real time": 1.0, "2 x": 2.0, "5 x": 5.0, "10 x": 10.0, "as fast as it goes": float("inf")}
SLICE = 0.05
"""Wall seconds of driving between two looks at what else there is to do."""


class DriveTab:
    """Controls of a drive.

    Args:
        client: the page.
        worker: does the page's work.
        guard: shows its errors.
        scene: shows its world.
        drive_scene: shows its drive.
        scenarios: the page's worlds.
        out: folder for saved runs.
        world: returns the world that the page shows.
        begun: called before another drive starts.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        worker: Worker,
        guard: Guard,
        scene: Scene,
        drive_scene: DriveScene,
        scenarios: ScenarioCache,
        out: Path,
        world: Callable[[], Shown | None],
        begun: Callable[[], None],
    ) -> None:
        self._client, self._worker, self._guard = client, worker, guard
        self._scene, self._drive_scene, self._scenarios = scene, drive_scene, scenarios
        self._out, self._world, self._begun = out, world, begun
        self.drive: LiveDrive | None = None
        self._running = False
        self._clock = 0.0, 0.0
        gui = client.gui
        self._controls = RunControls(gui)
        self._add_buttons(gui)
        self._progress = ProgressLine(gui)
        self._player = Player(gui, guard, drive_scene, self.pause, worker.submit)
        self._add_by_hand(gui)

    def _add_buttons(self, gui: viser.GuiApi) -> None:
        start = gui.add_button(
            "Start", color="green", icon=viser.Icon.PLAYER_PLAY, hint="From the start pose."
        )
        start.on_click(self._guard(lambda _: self.start()))
        self._go = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE, disabled=True)
        self._go.on_click(self._guard(lambda _: self.pause() if self._running else self.go_on()))
        self._step = gui.add_button("Step one scan", icon=viser.Icon.PLAYER_SKIP_FORWARD, disabled=True)
        self._step.on_click(self._guard(lambda _: self._step_one()))
        self._save = gui.add_button("Save the run", icon=viser.Icon.DOWNLOAD, disabled=True)
        self._save.on_click(self._guard(lambda _: self._worker.submit("save", self._save_now)))

    def _add_by_hand(self, gui: viser.GuiApi) -> None:
        self._speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="2 x")
        self._speed.on_update(self._guard(lambda _: self._wind()))
        self._follow = gui.add_checkbox("follow robot", True)
        self._follow.on_update(self._guard(lambda _: self._apply()))
        self._by_hand = gui.add_checkbox("drive by hand", False)
        self._by_hand.on_update(self._guard(lambda _: self._apply()))
        self._stick = Stick(gui, self._guard, self._steer)

    def start(self) -> None:
        """Set the robot down at its start, and drive."""
        self.pause()
        self._worker.submit("start", self._start_now)

    def pause(self) -> None:
        """Stand still until `go_on`."""
        self._running = False
        self._worker.repeat(None)
        self._show_state()

    def go_on(self) -> None:
        """Drive on from where the drive is, wherever the timeline was."""
        if self.drive is None or self.drive.over:
            return
        self._running = True
        self._wind()
        self._show_state()
        self._worker.repeat(self._drive_slice)

    def forget(self) -> None:
        """Drop the drive: the page shows something else."""
        self.pause()
        self.drive = None
        self._player.end()
        self._show_state()

    def _start_now(self) -> None:
        shown = self._world()
        if shown is None:
            raise ConfigError("there is no world to drive in: choose one first")
        config = self._controls.config(shown.source, shown.options)
        self._begun()
        self.drive = None
        with self._progress.shown(config.robot) as progress:
            drive = LiveDrive(config, self._scenarios, progress)
            self._scene.show_world(drive.world, coarse=False)
        self.drive = drive
        self._apply()
        self._player.begin(drive, config.seconds)
        self._drive_scene.approach(drive.moment(0).T_world_base.position)
        self._guard.done()
        self.go_on()

    def _drive_slice(self) -> None:
        drive = self.drive
        if drive is None or not self._running:
            return
        until = time.monotonic() + SLICE
        ahead = drive.go_on(until, self._allowed())
        if drive.over or self._player.due:
            self._player.show(drive.scans - 1)
        if drive.over:
            self.pause()
        elif ahead:
            time.sleep(max(0.0, min(SLICE, until - time.monotonic())))

    def _step_one(self) -> None:
        self.pause()
        self._worker.submit("step", self._step_now)

    def _step_now(self) -> None:
        if self.drive is not None:
            self.drive.step()
            self._player.show(self.drive.scans - 1)
            self._show_state()

    def _save_now(self) -> None:
        if self.drive is None:
            return
        with self._progress.shown("run") as progress:
            folder = self.drive.save(self._out, progress).folder
        if folder is not None:
            self._client.send_file_download(f"{folder.name}.zip", zipped(folder), save_immediately=True)
        self._wind()

    def _steer(self, forward: float, left: float) -> None:
        if self.drive is not None:
            self.drive.driver.steer(forward, left)

    def _apply(self) -> None:
        """Give the drive what the switches say."""
        self._drive_scene.follow = self._follow.value
        if self._stick.visible != self._by_hand.value:
            self._stick.visible = self._by_hand.value
        if self.drive is not None:
            self.drive.driver.by_hand = self._by_hand.value

    def _wind(self) -> None:
        """Let the pace begin at this moment."""
        self._clock = time.monotonic(), 0.0 if self.drive is None else self.drive.time

    def _allowed(self) -> float:
        """Return the simulated time until which the pace allows to drive now, seconds."""
        wall, simulated = self._clock
        return simulated + SPEEDS[self._speed.value] * (time.monotonic() - wall + SLICE)

    def _show_state(self) -> None:
        drive = self.drive
        idle: Any = drive is None or drive.over
        self._go.label = "Pause" if self._running else "Go on"
        self._go.icon = viser.Icon.PLAYER_PAUSE if self._running else viser.Icon.PLAYER_PLAY
        self._go.disabled = self._step.disabled = idle
        self._save.disabled = drive is None
