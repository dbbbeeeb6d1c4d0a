"""The tab where finished runs are looked at again."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import viser

from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.session.finished_run import FinishedRun, runs_in, unpacked_run
from lirs_validation.gui.session.uploads import Limits
from lirs_validation.gui.session.worker import Worker
from lirs_validation.gui.view.drive_scene import DriveScene
from lirs_validation.gui.view.drive_tab import SPEEDS
from lirs_validation.gui.view.guard import Guard
from lirs_validation.gui.view.player import PERIOD, Player
from lirs_validation.gui.view.scene import Scene
from lirs_validation.gui.view.widgets.drop_zone import add_drop_zone
from lirs_validation.gui.view.widgets.progress import ProgressLine

NONE = "choose a run"


class ReplayTab:
    """Controls of a replay.

    Attributes:
        run: that is shown; None = none yet.

    Args:
        client: the page.
        worker: does the page's work.
        guard: shows its errors.
        scene: shows its world.
        drive_scene: shows its drive.
        scenarios: the page's worlds.
        runs: folder of runs on the server, or of one; None = there is none.
        folder: of the page, for a run that it sends.
        limits: of the server.
        begun: called before another run is shown.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        worker: Worker,
        guard: Guard,
        scene: Scene,
        drive_scene: DriveScene,
        scenarios: ScenarioCache,
        runs: Path | None,
        folder: Path,
        limits: Limits,
        begun: Callable[[], None],
    ) -> None:
        self._worker, self._guard, self._scene = worker, guard, scene
        self._drive_scene, self._scenarios, self._runs = drive_scene, scenarios, runs
        self._folder, self._limits, self._begun = folder, limits, begun
        self.run: FinishedRun | None = None
        self._playing, self._clock = False, (0.0, 0.0)
        self._add_choice(client.gui)
        self._add_buttons(client.gui)
        self._progress = ProgressLine(client.gui)
        self._player = Player(client.gui, guard, drive_scene, self.pause, worker.submit)

    def _add_choice(self, gui: viser.GuiApi) -> None:
        self._choice = gui.add_dropdown("run", (NONE,), hint="Runs in the folder that --runs names.")
        self._choice.visible = self._runs is not None
        self._choice.on_update(self._guard(self._chosen))
        refresh = gui.add_button("Look for runs", icon=viser.Icon.REFRESH, visible=self._runs is not None)
        refresh.on_click(self._guard(lambda _: self._look()))
        upload = gui.add_upload_button(
            "Open a zipped run ...",
            icon=viser.Icon.UPLOAD,
            mime_type=".zip",
            hint="A run's folder as a zip archive, as Save the run gives it.",
        )
        upload.on_upload(self._guard(lambda _: self._open_archive(upload.value.content)))
        add_drop_zone(gui, "Open a zipped run")
        self._look()

    def _add_buttons(self, gui: viser.GuiApi) -> None:
        self._play = gui.add_button("Play", color="green", icon=viser.Icon.PLAYER_PLAY, disabled=True)
        self._play.on_click(self._guard(lambda _: self.pause() if self._playing else self.play()))
        self._speed = gui.add_dropdown("speed", tuple(SPEEDS)[:-1], initial_value="5 x")
        self._speed.on_update(self._guard(lambda _: self._wind()))
        follow = gui.add_checkbox("follow robot", True)
        follow.on_update(self._guard(lambda _: setattr(self._drive_scene, "follow", follow.value)))
        self._follow = follow

    def _look(self) -> None:
        found = () if self._runs is None else tuple(runs_in(self._runs))
        self._choice.options = (NONE, *found)

    def _chosen(self, event: Any) -> None:
        name = self._choice.value
        if event.client_id is None or name == NONE or self._runs is None:
            return
        folder = runs_in(self._runs)[name]
        self._worker.submit("replay", lambda: self._show(folder, uploaded=False))

    def _open_archive(self, content: bytes) -> None:
        self._worker.submit("replay", lambda: self._unpack(content))

    def _unpack(self, content: bytes) -> None:
        self._show(unpacked_run(content, self._folder, self._limits), uploaded=True)

    def _show(self, folder: Path, *, uploaded: bool) -> None:
        self.pause()
        self._begun()
        with self._progress.shown("run") as progress:
            progress("read", 0.0)
            run = FinishedRun(folder, self._scenarios, uploaded=uploaded)
            if run.world is not None:
                self._scene.show_world(run.world, coarse=False)
            else:
                self._scene.clear()
        self.run = run
        self._drive_scene.follow = self._follow.value
        self._player.begin(run, run.moment(run.scans - 1).time)
        self._drive_scene.approach(run.moment(0).T_world_base.position)
        if run.world is None:
            self._guard.note(f"The run is shown without its world: {run.missing}")
        self._guard.done()
        self._play.disabled = False

    def play(self) -> None:
        """Go on from the moment that is shown; from the start, after the last."""
        if self.run is None:
            return
        if self._player.scan >= self.run.scans - 1:
            self._player.scan = 0
        self._playing = True
        self._wind()
        self._play.label, self._play.icon = "Pause", viser.Icon.PLAYER_PAUSE
        self._worker.repeat(self._play_slice)

    def pause(self) -> None:
        """Stand still at the moment that is shown."""
        self._playing = False
        self._worker.repeat(None)
        self._play.label, self._play.icon = "Play", viser.Icon.PLAYER_PLAY

    def forget(self) -> None:
        """Drop the run: the page shows something else."""
        self.pause()
        self.run = None
        self._play.disabled = True
        self._player.end()

    def _play_slice(self) -> None:
        run = self.run
        if run is None or not self._playing:
            return
        wall, begun = self._clock
        wanted = begun + SPEEDS[self._speed.value] * (time.monotonic() - wall)
        scan = run.scan_at(wanted)
        self._player.show(scan)
        if scan >= run.scans - 1:
            self.pause()
        else:
            time.sleep(PERIOD)

    def _wind(self) -> None:
        if self.run is not None:
            self._clock = time.monotonic(), self.run.moment(self._player.scan).time
