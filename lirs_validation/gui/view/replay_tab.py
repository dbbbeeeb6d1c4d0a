"""The tab where finished runs are looked at again."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import viser

from lirs_validation.gui.session.finished_run import FinishedRun, runs_in, unpacked_run
from lirs_validation.gui.view.page_context import PageContext
from lirs_validation.gui.view.player import PERIOD, Player
from lirs_validation.gui.view.widgets import SPEEDS, Pace, PlayButton, ProgressLine, add_drop_zone, add_follow

NONE = "choose a run"


class ReplayTab:
    """Controls of a replay.

    Attributes:
        run: that is shown; None = none yet.

    Args:
        page: whose tab it is.
        runs: folder of runs on the server, or of one; None = there is none.
        begun: called before another run is shown.
    """

    def __init__(self, page: PageContext, runs: Path | None, begun: Callable[[], None]) -> None:
        self._page, self._runs, self._begun = page, runs, begun
        self.run: FinishedRun | None = None
        gui = page.client.gui
        self._add_choice(gui)
        self._play = PlayButton(gui, page.guard, "Play", self.play, self.pause, color="green")
        self._pace = Pace(gui, page.guard, tuple(SPEEDS)[:-1], "5 x", self._time)
        self._follow = add_follow(gui, page.guard, page.drive_scene)
        self._progress = ProgressLine(gui)
        self._player = Player(gui, page.guard, page.drive_scene, self.pause, page.worker.submit)

    def _add_choice(self, gui: viser.GuiApi) -> None:
        self._choice = gui.add_dropdown("run", (NONE,), hint="Runs in the folder that --runs names.")
        self._choice.visible = self._runs is not None
        self._choice.on_update(self._page.guard(self._chosen))
        refresh = gui.add_button("Look for runs", icon=viser.Icon.REFRESH, visible=self._runs is not None)
        refresh.on_click(self._page.guard(lambda _: self._look()))
        upload = gui.add_upload_button(
            "Open a zipped run ...",
            icon=viser.Icon.UPLOAD,
            mime_type=".zip",
            hint="A run's folder as a zip archive, as Save the run gives it.",
        )
        upload.on_upload(self._page.guard(lambda _: self._open_archive(upload.value.content)))
        add_drop_zone(gui, "Open a zipped run")
        self._look()

    def _look(self) -> None:
        found = () if self._runs is None else tuple(runs_in(self._runs))
        self._choice.options = (NONE, *found)

    def _chosen(self, event: Any) -> None:
        name = self._choice.value
        if event.client_id is None or name == NONE or self._runs is None:
            return
        folder = runs_in(self._runs)[name]
        self._page.worker.submit("replay", lambda: self._show(folder, uploaded=False))

    def _open_archive(self, content: bytes) -> None:
        self._page.worker.submit("replay", lambda: self._unpack(content))

    def _unpack(self, content: bytes) -> None:
        self._show(
            unpacked_run(content, self._page.uploads.folder / "replayed", self._page.limits), uploaded=True
        )

    def _show(self, folder: Path, *, uploaded: bool) -> None:
        self.pause()
        self._begun()
        with self._progress.show("run") as progress:
            progress("read", 0.0)
            run = FinishedRun(folder, self._page.scenarios, uploaded=uploaded)
            if run.world is not None:
                self._page.scene.show_world(run.world, coarse=False)
            else:
                self._page.scene.clear()
        self.run = run
        self._follow()
        self._player.begin(run, run.moment(run.scans - 1).time)
        self._page.drive_scene.approach(run.moment(0).T_world_base.position)
        if run.world is None:
            self._page.guard.note(f"The run is shown without its world: {run.missing}")
        self._page.guard.done()
        self._play.enable(True)

    def play(self) -> None:
        """Continue from the shown moment; after the last one, from the start."""
        if self.run is None:
            return
        if self._player.scan >= self.run.scans - 1:
            self._player.scan = 0
        self._pace.wind()
        self._play.show(running=True)
        self._page.worker.repeat(self._play_slice)

    def pause(self) -> None:
        """Stop at the shown moment."""
        self._page.worker.repeat(None)
        self._play.show(running=False)

    def forget(self) -> None:
        """Drop the run, since the page shows something else."""
        self.pause()
        self.run = None
        self._play.enable(False)
        self._player.end()

    def _play_slice(self) -> None:
        run = self.run
        if run is None or not self._play.running:
            return
        scan = run.scan_at(self._pace.time())
        self._player.show(scan)
        if scan >= run.scans - 1:
            self.pause()
        else:
            time.sleep(PERIOD)

    def _time(self) -> float:
        return 0.0 if self.run is None else self.run.moment(self._player.scan).time
