"""Shared parts of a page's tabs: messages, worker thread, controls, progress, stick."""

from __future__ import annotations

import logging
import math
import queue
import re
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import viser

from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.construction import Facts, Uploads, zip_folder
from lirs_validation.gui.controls import Control, controls, without_flags
from lirs_validation.gui.scene import DriveScene, WorldScene
from lirs_wct.errors import ConfigError, MapPictureWarning, WctError
from lirs_wct.option import Options
from lirs_wct.progress import Progress
from lirs_wct.sources.source import SourceKind

Callback = Callable[[Any], None]
Job = Callable[[], None]
ABSOLUTE_PATH = re.compile(r"(?<![\w.:/])/(?:[^\s/:;,'\"]+/)*([^\s/:;,'\"]+)")
"""A path on the server, of which messages show the last part."""
_LOG = logging.getLogger(__name__)
PATIENCE = 0.4
"""Seconds before progress appears; shorter work shows none."""
PERIOD = 0.1
"""Seconds between two updates."""
FIRST_PANEL = "Source"
"""Heading of the options that the command line has without one."""
LABEL = "stick"
HINT = "Forward and left, -1 to 1 each. Drag the stick, hold W A S D or the arrow keys, or write here."


class Guard:
    """Wrap the callbacks of one page, and show their errors and hints there."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._shown: viser.NotificationHandle | None = None
        self._notes: list[Warning | str] = []

    def __call__(self, callback: Callback) -> Callback:
        """Return a callback whose errors are shown."""

        def run(event: Any) -> None:
            try:
                callback(event)
            except Exception as error:
                self.show(error)

        return run

    def show(self, error: Exception) -> None:
        """Show an error instead of the last one; log it unless it is a WctError."""
        self._notes.clear()
        if isinstance(error, WctError):
            self._say("Input cannot be used", str(error), "red")
            return
        _LOG.error("a page failed", exc_info=error)
        self._say("The program failed", f"{type(error).__name__}: {error}", "red")

    def note(self, message: Warning | str) -> None:
        """Keep a hint until the present work is done."""
        self._notes.append(message)

    @property
    def map_seen(self) -> bool:
        """Whether a kept hint tells of a picture that looks like a map."""
        return any(isinstance(note, MapPictureWarning) for note in self._notes)

    def done(self) -> None:
        """Remove the last error and show the collected hints."""
        notes, self._notes = self._notes, []
        if notes:
            self._say("Note", "\n".join(dict.fromkeys(map(str, notes))), "yellow")
        else:
            self._remove_shown()

    def _remove_shown(self) -> None:
        if self._shown is not None:
            self._shown.remove()
            self._shown = None

    def _say(self, title: str, message: str, color: Any) -> None:
        self._remove_shown()
        message = ABSOLUTE_PATH.sub(r"\1", without_flags(message))
        self._shown = self._client.add_notification(title, message, color=color)


class PageWorker:
    """Run the jobs of one page in sequence, so that its state needs no locks."""

    def __init__(self, on_error: Callable[[Exception], None], name: str = "page") -> None:
        self._on_error = on_error
        self._jobs = queue.SimpleQueue[tuple[str, Job] | None]()
        self._newest: dict[str, Job] = {}
        self._idle: Job | None = None
        self._closing = False
        self._at_end: Job | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def submit(self, kind: str, job: Job) -> None:
        """Queue a job; it replaces a waiting one of the same kind."""
        self._newest[kind] = job
        self._jobs.put((kind, job))

    def repeat(self, slice_of_work: Job | None) -> None:
        """Call a short function repeatedly while no job waits; None = stop."""
        self._idle = slice_of_work
        self._jobs.put(None)  # wakes the thread

    def close(self, at_end: Job | None = None) -> None:
        """Drop waiting jobs and end the thread after the present job, then `at_end`."""
        self._at_end, self._closing = at_end, True
        self._jobs.put(None)

    def join(self, timeout: float | None = None) -> bool:
        """Wait for the thread's end; return whether it has ended."""
        self._thread.join(timeout)
        return not self._thread.is_alive()

    @property
    def here(self) -> bool:
        """Whether the caller runs in the worker's thread."""
        return threading.current_thread() is self._thread

    def _run(self) -> None:
        while not self._closing:
            idle = self._idle
            try:
                item = self._jobs.get(block=idle is None)
            except queue.Empty:
                self._run_job(idle)
                continue
            if item is not None and self._newest.get(item[0]) is item[1] and not self._closing:
                del self._newest[item[0]]
                self._run_job(item[1])
        self._run_job(self._at_end)

    def _run_job(self, job: Job | None) -> None:
        try:
            if job is not None:
                job()
        except Exception as error:
            self._idle = None
            self._on_error(error)


class PageContext:
    """Parts of one page that its tabs share: connection, thread, messages, scenes, files and worlds."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self.client = client
        self.guard = Guard(client)
        self.worker = PageWorker(self.guard.show, name=f"page {client.client_id}")
        self.scene, self.drive_scene = WorldScene(client), DriveScene(client)
        self.uploads, self.scenarios = Uploads(), ScenarioCache()

    @contextmanager
    def progress(self, work: str) -> Iterator[Progress]:
        """Show the progress of a piece of work over the scene."""
        last, shown = time.monotonic(), None

        def progress(step: str, share: float) -> None:
            nonlocal last, shown
            now, text = time.monotonic(), f"{step}, {100 * min(1.0, max(0.0, share)):.0f} %"
            if now - last < (PATIENCE if shown is None else PERIOD):
                return
            last = now
            if shown is None:
                shown = self.client.add_notification(work, text, loading=True, with_close_button=False)
            shown.body = text

        try:
            yield progress
        finally:
            if shown is not None:
                shown.remove()

    def send(self, folder: Path) -> None:
        """Let the browser save a folder as a zip archive."""
        self.client.send_file_download(f"{folder.name}.zip", zip_folder(folder), save_immediately=True)


def asset(name: str) -> str:
    """Return the text of one of our files for browsers."""
    return (Path(__file__).parent / "assets" / name).read_text(encoding="utf-8")


def with_script(name: str, label: str) -> str:
    """Return HTML and script of a name in our assets; the text `LABEL` is replaced."""
    script = asset(f"{name}.js").replace("LABEL", label).replace('"', "&quot;").replace("\n", " ")
    mark = f'<img src="data:," alt="" style="display:none" onerror="({script})(this.parentElement)">'
    return asset(f"{name}.html").replace("SCRIPT", mark)


class OptionControls:
    """Controls of the options of a class; `read` returns the options' values.

    The options in `first` stand above the folded ones, and those under the heading `more` or, without one,
    under their own. `keep_file` keeps an uploaded file and returns its path. `only` names the options that
    have a control; empty = all. They are shown for sources of these kinds.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        guard: Guard,
        options: type[Options],
        *,
        changed: Callable[[], None] = lambda: None,
        keep_file: Callable[[str, bytes], Path] = lambda name, content: Path(name),
        first: tuple[str, ...],
        more: str = "",
        only: Collection[str] = (),
        kinds: Collection[SourceKind] = tuple(SourceKind),
    ) -> None:
        self._gui, self._guard, self._changed, self._keep_file = gui, guard, changed, keep_file
        self._kinds, self._more = kinds, more
        self._files: dict[str, str] = {}
        self._shown: list[tuple[Control, Any]] = []
        self._folders: dict[str, Any] = {}
        offered = (control for control in controls(options) if not only or control.name in only)
        for control in sorted(offered, key=lambda c: c.name not in first):
            panel = self._panel(control)
            if control.name not in first and panel not in self._folders:
                self._folders[panel] = gui.add_folder(panel, expand_by_default=False)
            with nullcontext() if control.name in first else self._folders[panel]:
                self._shown.append((control, self._add(control)))

    def read(self) -> dict[str, Any]:
        """Return the value of every option."""
        return {
            c.name: c.read(self._files.get(c.name, "") if c.kind == "file" else handle.value)
            for c, handle in self._shown
        }

    def show_for(self, kind: SourceKind) -> None:
        """Show the controls that have an effect on a kind of source."""
        for control, handle in self._shown:
            handle.visible = kind in self._kinds and control.shown_for(kind)
        legal = {self._panel(control) for control, handle in self._shown if handle.visible}
        for panel, folder in self._folders.items():
            folder.visible = panel in legal

    def _panel(self, control: Control) -> str:
        return self._more or control.option.panel or FIRST_PANEL

    def _add(self, control: Control) -> Any:
        gui, title, start, hint = self._gui, control.title, control.initial, control.hint
        handle: Any
        if control.kind == "file":
            handle = gui.add_upload_button(f"{title} ...", hint=hint)

            def keep_upload(_: Any) -> None:
                self.set_file(control.name, self._keep_file(handle.value.name, handle.value.content))

            handle.on_upload(self._guard(keep_upload))
            return handle
        if control.kind == "switch":
            handle = gui.add_checkbox(title, bool(start), hint=hint)
        elif control.kind == "choice":
            handle = gui.add_dropdown(title, control.choices, initial_value=str(start), hint=hint)
        elif (slider := control.option.slider) is not None:
            handle = gui.add_slider(title, slider.low, slider.high, slider.step, slider.neutral, hint=hint)
        else:
            handle = gui.add_text(title, str(start), hint=hint)
        handle.on_update(self._guard(lambda _: self._changed()))
        return handle

    def set_file(self, option: str, path: Path) -> None:
        """Give an option a file, and show its name."""
        self._files[option] = str(path)
        control, handle = next(shown for shown in self._shown if shown[0].name == option)
        handle.label = f"{control.title}: {path.name}"
        self._changed()


class Stick:
    """Stick for manual driving: HTML that writes forward and left into a text field."""

    def __init__(self, gui: viser.GuiApi, guard: Guard, steer: Callable[[float, float], None]) -> None:
        self._html = gui.add_html(with_script("stick", LABEL), visible=False)
        self._field = gui.add_text(LABEL, "0.00 0.00", hint=HINT, visible=False)
        self._field.on_update(guard(lambda _: steer(*read_stick(self._field.value))))

    def show(self, visible: bool) -> None:
        """Show the stick in its middle, or hide it."""
        if visible != self._html.visible:
            self._field.visible = self._html.visible = visible
            field: Any = self._field
            field.value = "0.00 0.00"


def read_stick(text: str) -> tuple[float, float]:
    """Return forward and left."""
    try:
        forward, left = (float(part) for part in text.split())
    except ValueError:
        forward = left = math.nan
    if not (math.isfinite(forward) and math.isfinite(left)):
        raise ConfigError(f"stick must be two numbers, forward and left, got {text!r}")
    return forward, left


def as_table(facts: Facts) -> str:
    """Return facts as a table in Markdown."""
    rows = (f"| {name} | {value} |".replace("\n", " ") for name, value in facts)
    return "\n".join(("| | |", "|---|---|", *rows))
