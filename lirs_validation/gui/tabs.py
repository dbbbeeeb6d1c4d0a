"""Tabs of a page: the world, live drives and finished runs."""

from __future__ import annotations

import html
import time
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

import viser

from lirs_validation.config import LogOptions, MapConfig, RunConfig
from lirs_validation.gui.construction import Facts, Shown, build, preview
from lirs_validation.gui.controls import to_goal
from lirs_validation.gui.page import OptionControls, PageContext, Stick, as_table, asset, with_script
from lirs_validation.gui.playback import LiveDrive, Playback, read_playback, runs_in, unpacked_run
from lirs_validation.report.run_tables import command_of
from lirs_wct import BuildOptions, ConfigError
from lirs_wct.export.package import DEFAULT_FORMATS, FORMATS, GazeboTerrain
from lirs_wct.sources.bundled import RECIPES
from lirs_wct.sources.source import SourceKind, find_source

WORLD_OPTIONS = (
    *("size", "height", "invert", "smoothing", "z_scale", "wall_height", "unknown", "speckle"),
    *("resolution", "cloud_surface"),
)
"""Options above the folded ones; at most five of them have an effect on a kind of source."""
MAP_RESOLUTION = 0.05
"""Resolution of a map picture without YAML, meters a pixel; most maps have it."""
LOG, LOG_OPTIONS = "Laser log", ("mapper", *(field.name for field in fields(LogOptions)))
TERRAINS: tuple[GazeboTerrain, ...] = ("solid", "heightmap")
PERIOD = 0.12
"""Seconds between two pictures."""
SLICE = 0.05
"""Wall seconds of driving between two checks of the job queue."""
SPEEDS = {"1 x real time": 1.0, "2 x": 2.0, "5 x": 5.0, "10 x": 10.0, "no limit": float("inf")}
SPEED, SPEED_HINT = "10 x", "As fast as this computer can, up to this speed."
RUN_OPTIONS = ("robot", "mapper", "lidar", "driver", "seconds")
"""Options of a run above the folded ones."""
NONE = "choose a run"
MORE = "More options"
CLICK = "Click the ground twice: start and goal. Or press Start."
CLICK_GOAL = "Now click the goal."
NEXT = (
    "**The drive has ended.** Next: save the run and open it under Replay; copy the command below; change an "
    "option and press Start; or click another start and goal."
)
FAILED = "**The mapper failed.** Next: choose another mapper or change an option, and press Start."
Place = tuple[float, float]
"""x and y of a point on the ground, meters."""
AnyPlayback = TypeVar("AnyPlayback", bound=Playback)


class WorldTab:
    """Controls of the construction, and the world that they make and the page shows."""

    def __init__(self, page: PageContext, first: str | None, changed: Callable[[], None]) -> None:
        self._page, self._changed = page, changed
        self._sources = {} if first is None else {first if first in RECIPES else Path(first).name: first}
        self._sources |= {name: name for name in RECIPES if name not in self._sources}
        self._maps = set[str]()  # pictures that are read as laser maps
        self.shown: Shown | None = None
        gui, guard = page.client.gui, page.guard
        self._source = gui.add_dropdown(
            "source", tuple(self._sources), hint="A bundled world, or a file that was opened here."
        )
        self._source.on_update(guard(lambda event: None if event.client_id is None else self.preview()))
        upload = gui.add_upload_button(
            "Open files ...",
            icon=viser.Icon.UPLOAD,
            hint="Picture of heights, laser map with its picture, mesh, laser log or bag.",
        )
        upload.on_upload(guard(lambda _: self.open(upload.value.name, upload.value.content)))
        gui.add_html(with_script("drop", "Open files"))
        self._as_map = gui.add_button(
            "Read as a map", color="yellow", visible=False, hint=f"{MAP_RESOLUTION:g} m a pixel unless given."
        )
        self._as_map.on_click(guard(lambda _: self._read_as_map()))
        self._build = gui.add_button("Build", color="green", icon=viser.Icon.HAMMER)
        self._build.on_click(guard(lambda _: self.build()))
        self._download = gui.add_button("Download the package", icon=viser.Icon.DOWNLOAD, disabled=True)
        self._download.on_click(guard(lambda _: page.worker.submit("download", self._send)))
        self._facts = gui.add_markdown("")
        self._options = OptionControls(
            gui, guard, BuildOptions, changed=self.preview, keep_file=self._keep, first=WORLD_OPTIONS
        )
        kinds = (SourceKind.LOG,)
        self._mapping = OptionControls(
            gui, guard, MapConfig, changed=self.preview, first=(), more=LOG, only=LOG_OPTIONS, kinds=kinds
        )
        with gui.add_folder("Files of the package", expand_by_default=False):
            self._formats = {
                name: gui.add_checkbox(name, name in DEFAULT_FORMATS, hint="Written by Build.")
                for name in FORMATS
            }
            self._terrain = gui.add_dropdown(
                "Gazebo model", TERRAINS, hint="The solid mesh, or a heightmap (square, 2^n + 1 px, 8 bit)."
            )

    def preview(self) -> None:
        """Show a coarse preview for the present controls."""

        def show_chosen() -> None:
            name = self._source.value
            self._show_preview(self._sources[name], name)

        self._page.worker.submit("preview", show_chosen)

    def build(self) -> None:
        """Build the world of the present controls, show it and write its package."""
        self._build.disabled = True
        self._page.worker.submit("build", self._build_now)

    def _keep(self, name: str, content: bytes) -> Path:
        path = self._page.uploads.add(name, content)
        self._page.scenarios.clear()  # a new file may have the name of an old one
        return path

    def open(self, name: str, content: bytes) -> None:
        """Show one file or several; world and controls stay if refused."""

        def show_files() -> None:
            self._page.scenarios.clear()  # a new file may have the name of an old one
            with self._page.uploads.added(name, content) as (main, texture):
                self._show_preview(str(main[0]), main[0].name)
            self._sources |= {path.name: str(path) for path in main}
            self._source.options = tuple(self._sources)
            self._source.value = main[0].name  # type: ignore[misc]
            if texture is not None:
                self._options.set_file("texture", texture)

        self._page.worker.submit(f"open {name}", show_files)

    def _read_as_map(self) -> None:
        self._maps.add(self._sources[self._source.value])
        self.preview()

    def _show_preview(self, source: str, name: str) -> None:
        options, mapping = self._read(source), self._mapping.read()
        with self._page.progress(name) as progress:
            shown = preview(source, options, self._page.uploads.folder, progress, **mapping)
            triangles = self._page.scene.show_world(shown.world, coarse=True)
        kind = find_source(source, options).kind
        self._options.show_for(kind)
        self._mapping.show_for(kind)
        self._as_map.visible = self._page.guard.map_seen
        self._download.disabled = True
        self._show(shown, (("preview", f"{triangles:,} triangles"),))

    def _read(self, source: str) -> BuildOptions:
        """Return a source's options, with a resolution if it is read as a map."""
        given = self._options.read()
        if source in self._maps:
            if given["resolution"] is None:
                self._page.guard.note(f"{source}: {MAP_RESOLUTION:g} m a pixel, unless --resolution is given")
            given["kind"], given["resolution"] = given["kind"] or "map", given["resolution"] or MAP_RESOLUTION
        return BuildOptions(**given)

    def _build_now(self) -> None:
        try:
            name, folder = self._source.value, self._page.uploads.folder
            source, formats = self._sources[name], [name for name, box in self._formats.items() if box.value]
            options, mapping = self._read(source), self._mapping.read()
            with self._page.progress(name) as progress:
                shown = build(source, options, folder, formats, self._terrain.value, progress, **mapping)
                triangles = self._page.scene.show_world(shown.world, coarse=False)
        finally:
            self._build.disabled = False
        self._download.disabled = False
        self._show(shown, (("shown", f"{triangles:,} triangles"),))

    def _show(self, shown: Shown, more: Facts) -> None:
        self.shown = shown
        self._facts.content = as_table((*shown.facts, *more))
        self._page.guard.done()
        self._changed()

    def _send(self) -> None:
        if self.shown is None or self.shown.package is None:
            raise ConfigError("nothing is built yet: Build comes first")
        self._page.send(self.shown.package)


class PlaybackTab(Generic[AnyPlayback]):
    """Tab with a drive, its play button, speed, timeline and figures."""

    def __init__(self, page: PageContext, begun: Callable[[], None]) -> None:
        self._page, self._begun = page, begun
        self.playback: AnyPlayback | None = None
        self.running = False
        self._time = self._shown_at = 0.0  # simulated time of the shown moment, wall time of its picture
        self._started = 0.0, 0.0  # wall time and simulated time at which playing began

    def _add_play(self, label: str, speeds: tuple[str, ...], color: Literal["green"] | None = None) -> None:
        """Add the play button, the speeds and the switch that follows the robot."""
        gui, guard = self._page.client.gui, self._page.guard
        self._label = label
        self._play = gui.add_button(label, color=color, icon=viser.Icon.PLAYER_PLAY, disabled=True)
        self._play.on_click(guard(lambda _: self.press_play()))
        self._speed = gui.add_dropdown("speed", speeds, initial_value=SPEED, hint=SPEED_HINT)
        self._speed.on_update(guard(lambda _: self._restart_clock()))
        self._follow = gui.add_checkbox("follow robot", True)
        self._follow.on_update(guard(lambda _: self._apply()))

    def _add_timeline(self) -> None:
        gui = self._page.client.gui
        self._slider = gui.add_slider("timeline [s]", 0.0, 1.0, 0.1, 0.0, visible=False)
        self._slider.on_update(self._go_to_slider)
        self._facts = gui.add_markdown("")

    def pause(self) -> None:
        """Stop at the shown moment."""
        self._page.worker.repeat(None)
        self._show_state(running=False)

    def press_play(self) -> None:
        """Go on or pause, as the button does."""
        if not self._play.disabled:
            self.pause() if self.running else self.go_on()

    def go_on(self) -> None:
        """Drive on where the drive is; of a finished run, play from the shown moment."""
        if self.playback is None:
            return
        if not self.playback.over:
            self._time = self.playback.time
        elif self._time >= self.playback.time:
            self._time = 0.0
        self._restart_clock()
        self._show_state(running=True)
        self._page.worker.repeat(self._play_slice)

    def forget(self) -> None:
        """Drop the drive, since the page shows something else."""
        self.pause()
        self.playback = None
        self._slider.visible = False
        self._facts.content = ""
        self._show_state()

    def _begin(self, playback: AnyPlayback) -> None:
        """Show another drive."""
        self._apply()
        self._slider.max = max(0.1, playback.seconds)
        self._slider.visible = True
        self.playback = playback
        self._page.drive_scene.begin(playback.robot, playback.world)
        self._show_scan(0)
        self._page.drive_scene.approach(playback.moment(0).T_world_base.position)
        self._show_state()

    def _play_slice(self) -> None:
        """Play for a moment of wall time; show the last scan when due."""
        playback = self.playback
        if playback is None or not self.running:
            return
        until, (wall, simulated) = time.monotonic() + SLICE, self._started
        wanted = simulated + SPEEDS[self._speed.value] * (until - wall)
        playback.drive_on(until, wanted)
        if not playback.over and playback.time < wanted:  # slower than wanted: never made up for
            self._started = until, playback.time
        ended = playback.over and wanted >= playback.time
        if ended or time.monotonic() - self._shown_at >= PERIOD:
            self._show_scan(playback.last_scan(wanted))
        if ended:
            self._end()
        else:
            time.sleep(max(0.0, until - time.monotonic()))

    def _end(self) -> None:
        """Stop at the end of the drive."""
        self.pause()

    def _show_scan(self, scan: int) -> None:
        """Show a moment, and move the timeline there."""
        if self.playback is None:
            return
        moment = self.playback.moment(scan)
        self._time = moment.time
        self._page.drive_scene.show(moment)
        self._page.drive_scene.show_course(self.playback.curve(), self.playback.marks)
        slider: Any = self._slider
        slider.value = min(round(moment.time, 1), float(slider.max))
        self._facts.content = as_table(moment.facts)
        self._shown_at = time.monotonic()

    async def _go_to_slider(self, event: Any) -> None:
        # A coroutine is called at once, and not in a thread: a moment that is shown then moves the timeline.
        if event.client_id is None or self.playback is None:
            return  # moved by `_show_scan`
        wanted = float(self._slider.value)

        def show() -> None:
            if self.playback is not None:
                self._show_scan(self.playback.last_scan(wanted))

        self.pause()
        self._page.worker.submit("timeline", show)

    def _restart_clock(self) -> None:
        self._started = time.monotonic(), self._time

    def _apply(self) -> None:
        """Apply the switches to the drive."""
        self._page.drive_scene.follow = self._follow.value

    def _show_state(self, *, running: bool = False) -> None:
        self.running = running
        self._play.label = "Pause" if running else self._label
        self._play.icon = viser.Icon.PLAYER_PAUSE if running else viser.Icon.PLAYER_PLAY
        self._play.disabled = self.playback is None


class DriveTab(PlaybackTab[LiveDrive]):
    """Controls of a drive."""

    def __init__(
        self, page: PageContext, world: Callable[[], Shown | None], begun: Callable[[], None]
    ) -> None:
        super().__init__(page, begun)
        self._world = world
        self._clicked: Place | None = None
        gui = page.client.gui
        self._hint = gui.add_markdown(CLICK)
        self._controls = OptionControls(gui, page.guard, RunConfig, first=RUN_OPTIONS, more=MORE)
        start = gui.add_button(
            "Start", color="green", icon=viser.Icon.PLAYER_PLAY, hint="From the start pose."
        )
        start.on_click(page.guard(lambda _: self.start()))
        self._add_play("Go on", tuple(SPEEDS))
        self._step = gui.add_button("Step one scan", icon=viser.Icon.PLAYER_SKIP_FORWARD, disabled=True)
        self._step.on_click(page.guard(lambda _: page.worker.submit("step", self._step_one)))
        self._save = gui.add_button("Save the run", icon=viser.Icon.DOWNLOAD, disabled=True)
        self._save.on_click(page.guard(lambda _: page.worker.submit("save", self._save_now)))
        self._add_timeline()
        self._by_hand = gui.add_checkbox("drive by hand", False)
        self._by_hand.on_update(page.guard(lambda _: self._apply()))
        self._stick = Stick(gui, page.guard, self._steer)
        self._command = gui.add_html("", visible=False)

    def click(self, place: Place) -> None:
        """Take a clicked place: first the start, then the goal, to which the robot drives."""
        shown = self._world()
        if shown is None:
            return
        if self._clicked is None:
            self._page.scene.unmark()
            self._clicked = place
            self._page.scene.mark("start", place, shown.world)
            self._hint.content = CLICK_GOAL
        else:
            self._page.scene.mark("goal", place, shown.world)
            self.start((self._clicked, place))

    def start(self, route: tuple[Place, Place] | None = None) -> None:
        """Drive from the start pose, or from a place to a goal."""
        self.pause()
        self._clicked, self._hint.content = None, CLICK
        self._page.worker.submit("start", lambda: self._start_now(route))

    def _start_now(self, route: tuple[Place, Place] | None) -> None:
        shown = self._world()
        if shown is None:
            raise ConfigError("there is no world to drive in: choose one first")
        config = RunConfig(source=shown.source, build=shown.options, **self._controls.read())
        config = config if route is None else to_goal(config, *route)
        self._begun()
        self.playback = None
        with self._page.progress(config.robot) as progress:
            drive = LiveDrive(config, self._page.scenarios, progress)
            self._page.scene.show_world(drive.world, coarse=False)
        self._begin(drive)
        self._show_command()
        self._page.guard.done()
        self.go_on()

    def _end(self) -> None:
        """Stop, and name what can be done next."""
        super()._end()
        if self.playback is not None:
            self._hint.content = FAILED if self.playback.failed else NEXT
            self._slider.max = max(0.1, round(self.playback.time, 1))
        self._show_command()

    def _show_command(self) -> None:
        """Show the command that repeats the drive; files stand under their own names."""
        drive, folder = self.playback, f"{self._page.uploads.folder}/"
        command = "" if drive is None else command_of(drive.repeated)
        command = "" if f"{folder}maps/" in command else command.replace(folder, "")
        self._command.content = asset("command.html").replace("COMMAND", html.escape(command))
        self._command.visible = bool(command)

    def _step_one(self) -> None:
        self.pause()
        if self.playback is not None:
            self.playback.step()
            self._show_scan(self.playback.scans - 1)
            self._end() if self.playback.over else self._show_state()

    def _save_now(self) -> None:
        if self.playback is None:
            return
        with self._page.progress("run") as progress:
            folder = self.playback.save(self._page.uploads.folder / "runs", progress).folder
        if folder is not None:
            self._page.send(folder)
        self._show_command()
        self._restart_clock()

    def _steer(self, forward: float, left: float) -> None:
        if self.playback is not None:
            self.playback.driver.steer(forward, left)

    def _apply(self) -> None:
        super()._apply()
        self._stick.show(self._by_hand.value)
        if self.playback is not None:
            self.playback.driver.by_hand = self._by_hand.value

    def _show_state(self, *, running: bool = False) -> None:
        super()._show_state(running=running)
        self._play.disabled = self._step.disabled = self.playback is None or self.playback.over
        self._save.disabled = self.playback is None or self.playback.failed


class ReplayTab(PlaybackTab[Playback]):
    """Controls of a replay."""

    def __init__(self, page: PageContext, runs: Path | None, begun: Callable[[], None]) -> None:
        super().__init__(page, begun)
        self._runs = runs
        gui, guard, listed = page.client.gui, page.guard, runs is not None
        self._choice = gui.add_dropdown("run", (NONE,), hint="Runs on the server.", visible=listed)
        self._choice.on_update(guard(self._chosen))
        refresh = gui.add_button("Look for runs", icon=viser.Icon.REFRESH, visible=listed)
        refresh.on_click(guard(lambda _: self._look()))
        upload = gui.add_upload_button(
            "Open a zipped run ...",
            icon=viser.Icon.UPLOAD,
            mime_type=".zip",
            hint="A run's folder as a zip archive, as Save the run gives it.",
        )
        upload.on_upload(guard(lambda _: self._open(upload.value.content)))
        gui.add_html(with_script("drop", "Open a zipped run"))
        self._look()
        self._add_play("Play", tuple(SPEEDS)[:-1], "green")
        self._add_timeline()

    def _look(self) -> None:
        self._choice.options = (NONE, *(() if self._runs is None else runs_in(self._runs)))

    def _chosen(self, event: Any) -> None:
        name = self._choice.value
        if event.client_id is not None and name != NONE and self._runs is not None:
            self._open(runs_in(self._runs)[name])

    def _open(self, source: Path | bytes) -> None:
        """Show a run's folder on the server, or the zipped one that a browser sent."""
        self._page.worker.submit("replay", lambda: self._show(source))

    def _show(self, source: Path | bytes) -> None:
        self.pause()
        if uploaded := isinstance(source, bytes):
            source = unpacked_run(source, self._page.uploads.folder / "replayed")
        self._begun()
        with self._page.progress("run") as progress:
            progress("read", 0.0)
            run = read_playback(source, self._page.scenarios, uploaded=uploaded)
            if run.world is not None:
                self._page.scene.show_world(run.world, coarse=False)
            else:
                self._page.scene.clear()
        self._begin(run)
        if run.world is None:
            self._page.guard.note(f"The run is shown without its world: {run.note}")
        self._page.guard.done()
