"""Tab in which a robot drives and maps, automatically or manually."""

from __future__ import annotations

import time
from collections.abc import Callable

import viser

from lirs_validation.config import RunConfig
from lirs_validation.gui.session.construction import Shown, zip_folder
from lirs_validation.gui.session.controls import read_run_controls
from lirs_validation.gui.session.live_drive import LiveDrive
from lirs_validation.gui.view.page_context import PageContext
from lirs_validation.gui.view.player import Player
from lirs_validation.gui.view.widgets import (
    SPEEDS,
    OptionControls,
    Pace,
    PlayButton,
    ProgressLine,
    Stick,
    add_follow,
)
from lirs_wct.errors import ConfigError

SLICE = 0.05
"""Wall seconds of driving between two checks of the job queue."""
FIRST = ("robot", "mapper", "lidar", "driver")
"""Options of a run above the folded ones."""


class DriveTab:
    """Controls of a drive.

    Attributes:
        drive: that goes on; None = none yet.

    Args:
        page: whose tab it is.
        world: returns the world that the page shows.
        begun: called before another drive starts.
    """

    def __init__(
        self, page: PageContext, world: Callable[[], Shown | None], begun: Callable[[], None]
    ) -> None:
        self._page, self._world, self._begun = page, world, begun
        self.drive: LiveDrive | None = None
        gui = page.client.gui
        self._controls = OptionControls(gui, page.guard, RunConfig, first=FIRST)
        self._add_buttons(gui)
        self._progress = ProgressLine(gui)
        self._player = Player(gui, page.guard, page.drive_scene, self.pause, page.worker.submit)
        self._add_by_hand(gui)

    def _add_buttons(self, gui: viser.GuiApi) -> None:
        start = gui.add_button(
            "Start", color="green", icon=viser.Icon.PLAYER_PLAY, hint="From the start pose."
        )
        start.on_click(self._page.guard(lambda _: self.start()))
        self._go = PlayButton(gui, self._page.guard, "Go on", self.go_on, self.pause)
        self._step = gui.add_button("Step one scan", icon=viser.Icon.PLAYER_SKIP_FORWARD, disabled=True)
        self._step.on_click(self._page.guard(lambda _: self._step_one()))
        self._save = gui.add_button("Save the run", icon=viser.Icon.DOWNLOAD, disabled=True)
        self._save.on_click(self._page.guard(lambda _: self._page.worker.submit("save", self._save_now)))

    def _add_by_hand(self, gui: viser.GuiApi) -> None:
        self._pace = Pace(gui, self._page.guard, tuple(SPEEDS), "2 x", self._time)
        self._follow = add_follow(gui, self._page.guard, self._page.drive_scene)
        self._by_hand = gui.add_checkbox("drive by hand", False)
        self._by_hand.on_update(self._page.guard(lambda _: self._apply()))
        self._stick = Stick(gui, self._page.guard, self._steer)

    def start(self) -> None:
        """Set the robot down at its start, and drive."""
        self.pause()
        self._page.worker.submit("start", self._start_now)

    def pause(self) -> None:
        """Stand still until `go_on`."""
        self._page.worker.repeat(None)
        self._show_state(running=False)

    def go_on(self) -> None:
        """Drive on from where the drive is, wherever the timeline was."""
        if self.drive is None or self.drive.over:
            return
        self._pace.wind()
        self._show_state(running=True)
        self._page.worker.repeat(self._drive_slice)

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
        config = read_run_controls(self._controls.values(), shown.source, shown.options)
        self._begun()
        self.drive = None
        with self._progress.show(config.robot) as progress:
            drive = LiveDrive(config, self._page.scenarios, progress)
            self._page.scene.show_world(drive.world, coarse=False)
        self.drive = drive
        self._apply()
        self._player.begin(drive, config.seconds)
        self._page.drive_scene.approach(drive.moment(0).T_world_base.position)
        self._page.guard.done()
        self.go_on()

    def _drive_slice(self) -> None:
        drive = self.drive
        if drive is None or not self._go.running:
            return
        until = time.monotonic() + SLICE
        ahead = drive.go_on(until, self._pace.time(SLICE))
        if drive.over or self._player.due:
            self._player.show(drive.scans - 1)
        if drive.over:
            self.pause()
        elif ahead:
            time.sleep(max(0.0, min(SLICE, until - time.monotonic())))

    def _step_one(self) -> None:
        self.pause()
        self._page.worker.submit("step", self._step_now)

    def _step_now(self) -> None:
        if self.drive is not None:
            self.drive.step()
            self._player.show(self.drive.scans - 1)
            self._show_state()

    def _save_now(self) -> None:
        if self.drive is None:
            return
        with self._progress.show("run") as progress:
            folder = self.drive.save(self._page.uploads.folder / "runs", progress).folder
        if folder is not None:
            self._page.client.send_file_download(
                f"{folder.name}.zip", zip_folder(folder), save_immediately=True
            )
        self._pace.wind()

    def _steer(self, forward: float, left: float) -> None:
        if self.drive is not None:
            self.drive.driver.steer(forward, left)

    def _apply(self) -> None:
        """Apply the switches to the drive."""
        self._follow()
        if self._stick.visible != self._by_hand.value:
            self._stick.visible = self._by_hand.value
        if self.drive is not None:
            self.drive.driver.by_hand = self._by_hand.value

    def _time(self) -> float:
        return 0.0 if self.drive is None else self.drive.time

    def _show_state(self, *, running: bool = False) -> None:
        drive = self.drive
        idle = drive is None or drive.over
        self._go.show(running)
        self._go.enable(not idle)
        self._step.disabled = idle
        self._save.disabled = drive is None
