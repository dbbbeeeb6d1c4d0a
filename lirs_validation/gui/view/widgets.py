"""Widgets of a page: options, pace, progress, stick, drop zone."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import viser

from lirs_validation.gui.session.construction import Facts
from lirs_validation.gui.session.controls import FIRST_PANEL, Control, controls
from lirs_validation.gui.view.page_context import Guard
from lirs_validation.gui.view.scene import DriveScene
from lirs_wct.errors import ConfigError
from lirs_wct.option import Options
from lirs_wct.progress import Progress
from lirs_wct.sources.options import SourceKind

PATIENCE = 0.4
"""Seconds before a bar appears; shorter work shows none."""
PERIOD = 0.1
"""Seconds between two updates."""
SPEEDS = {"1 x real time": 1.0, "2 x": 2.0, "5 x": 5.0, "10 x": 10.0, "as fast as it goes": float("inf")}
MORE = "More options"
"""Heading of the options that are not among the first."""
_DROP_HTML = """
<div class="lirs-drop" style="text-align:center;font-size:.8em;opacity:.7;margin:-.2em 0 .5em">
 or drop it anywhere on the page SCRIPT
</div>
"""
_DROP_SCRIPT = """
function(root){
 const wait = () => new Promise(done => setTimeout(done, 100));
 const input = () => [...document.querySelectorAll('input[type=file]')]
  .find(found => found.parentElement.textContent.includes('LABEL'));
 async function take(files){
  const yaml = file => /[.]ya?ml$/i.test(file.name);
  for (const file of [...files].sort((a, b) => yaml(a) - yaml(b))) {
   while (input().parentElement.querySelector('button').disabled) await wait();
   const one = new DataTransfer();
   one.items.add(file);
   input().files = one.files;
   input().dispatchEvent(new Event('change', {bubbles: true}));
   await wait();
  }
 }
 function dropped(event){
  if (!root.isConnected) {
   ['dragover', 'drop'].forEach(kind => window.removeEventListener(kind, dropped));
   return;
  }
  if (!root.offsetParent || !event.dataTransfer.types.includes('Files')) return;
  event.preventDefault();
  if (event.type === 'drop') take(event.dataTransfer.files);
 }
 ['dragover', 'drop'].forEach(kind => window.addEventListener(kind, dropped));
}
"""
LABEL = "stick"
HINT = "Forward and left, -1 to 1 each. Drag the stick, hold W A S D or the arrow keys, or write here."
_STICK_HTML = """
<div tabindex="0" class="lirs-stick" style="position:relative;width:9em;height:9em;margin:.2em auto .6em;
 border-radius:50%;background:radial-gradient(#f4f6f8,#d5dbe1);border:1px solid #aab4be;touch-action:none;
 cursor:grab;outline:none">
 <div class="lirs-knob" style="position:absolute;left:50%;top:50%;width:3em;height:3em;margin:-1.5em;
  border-radius:50%;background:#0072B2;box-shadow:0 2px 5px #0006;pointer-events:none"></div>
 SCRIPT
</div>
<div style="text-align:center;font-size:.8em;opacity:.7">drag, or hold W A S D / arrow keys</div>
"""
_STICK_SCRIPT = """
function(root){
 const knob = root.querySelector('.lirs-knob'), held = new Set();
 const keys = {KeyW:[1,0],ArrowUp:[1,0],KeyS:[-1,0],ArrowDown:[-1,0],
               KeyA:[0,1],ArrowLeft:[0,1],KeyD:[0,-1],ArrowRight:[0,-1]};
 const write = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype,'value').set;
 let last = '';
 function field(){
  let row = [...document.querySelectorAll('label')].find(l => l.textContent === 'LABEL');
  while (row && !row.querySelector('input')) row = row.parentElement;
  return row && row.querySelector('input');
 }
 function steer(forward, left){
  knob.style.transform = `translate(${-3 * left}em,${-3 * forward}em)`;
  const text = forward.toFixed(2) + ' ' + left.toFixed(2), input = field();
  if (!input || text === last) return;
  last = text;
  write.call(input, text);
  input.dispatchEvent(new Event('input', {bubbles: true}));
 }
 function pressed(){
  let f = 0, l = 0;
  held.forEach(k => { f += keys[k][0]; l += keys[k][1]; });
  steer(Math.sign(f), 0.6 * Math.sign(l));
 }
 function key(event){
  if (!root.isConnected) {
   ['keydown','keyup'].forEach(kind => window.removeEventListener(kind, key, true));
   return;
  }
  if (!(event.code in keys) || !root.offsetParent) return;
  const writes = event.target.matches('textarea,input:not([type=checkbox]):not([type=range])');
  if (writes || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  event.stopPropagation();
  if (event.type === 'keydown') held.add(event.code); else held.delete(event.code);
  pressed();
 }
 ['keydown','keyup'].forEach(kind => window.addEventListener(kind, key, true));
 window.addEventListener('blur', () => { if (held.size) { held.clear(); pressed(); } });
 root.onpointerdown = event => { root.setPointerCapture(event.pointerId); root.onpointermove(event); };
 root.onpointermove = event => {
  if (!root.hasPointerCapture(event.pointerId)) return;
  const box = root.getBoundingClientRect(), reach = box.width / 3;
  let x = (event.clientX - box.left - box.width / 2) / reach;
  let y = (event.clientY - box.top - box.height / 2) / reach;
  const far = Math.max(1, Math.hypot(x, y));
  steer(-y / far, -x / far);
 };
 root.onpointerup = root.onpointercancel = () => steer(0, 0);
}
"""


def with_script(html: str, script: str) -> str:
    """Return HTML whose script, a function, is called with the element around the mark `SCRIPT`."""
    quoted = script.replace('"', "&quot;").replace("\n", " ")
    mark = f'<img src="data:," style="display:none" onerror="({quoted})(this.parentElement)">'
    return html.replace("SCRIPT", mark)


class ProgressLine:
    """Progress bar with a line of text, hidden while idle."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._text = gui.add_markdown("", visible=False)
        self._bar = gui.add_progress_bar(0.0, animated=True, visible=False)

    @contextmanager
    def show(self, work: str) -> Iterator[Progress]:
        """Show the progress of a piece of work."""
        begun = last = time.monotonic()

        def progress(step: str, share: float) -> None:
            nonlocal last
            now = time.monotonic()
            if now - begun < PATIENCE or (now - last < PERIOD and self._bar.visible):
                return
            last = now
            self._text.content = f"{work}: {step}"
            self._bar.value = 100.0 * min(1.0, max(0.0, share))  # type: ignore[misc]
            self._text.visible = self._bar.visible = True

        try:
            yield progress
        finally:
            self._text.visible = self._bar.visible = False


class Pace:
    """Dropdown of speeds, and the simulated time at the chosen speed.

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
        """Restart the clock at the shown simulated time."""
        self._clock = time.monotonic(), self._now()

    def time(self, ahead: float = 0.0) -> float:
        """Return the simulated time at `ahead` wall seconds from now."""
        wall, simulated = self._clock
        return simulated + SPEEDS[self._speed.value] * (time.monotonic() - wall + ahead)


class PlayButton:
    """Button that starts and pauses, labeled with its next action.

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
        """Show whether the drive is running."""
        self.running = running
        self._button.label = "Pause" if running else self._label
        self._button.icon = viser.Icon.PLAYER_PAUSE if running else viser.Icon.PLAYER_PLAY

    def enable(self, enabled: bool) -> None:
        """Enable or disable the button."""
        self._button.disabled = not enabled


def add_follow(gui: viser.GuiApi, guard: Guard, scene: DriveScene) -> Callable[[], None]:
    """Add a check box for a view that follows the robot; return its apply function."""
    box = gui.add_checkbox("follow robot", True)

    def apply() -> None:
        scene.follow = box.value

    box.on_update(guard(lambda _: apply()))
    return apply


class OptionControls:
    """Controls of the options of a class; `values` reads them.

    Args:
        gui: of the page.
        guard: of its callbacks.
        options: the class.
        changed: called after a change.
        keep_file: keeps an uploaded file and returns its path.
        first: names of options above all headings; None = every option stands under its own heading.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        guard: Guard,
        options: type[Options],
        *,
        changed: Callable[[], None] = lambda: None,
        keep_file: Callable[[str, bytes], str] = lambda name, content: "",
        first: tuple[str, ...] | None = None,
    ) -> None:
        self._gui, self._guard, self._changed, self._keep_file = gui, guard, changed, keep_file
        self._files: dict[str, str] = {}
        self._shown: list[tuple[Control, Any]] = []
        self._folders: dict[str, Any] = {}
        for control in sorted(controls(options), key=lambda c: first is not None and c.name not in first):
            panel = control.panel if first is None else MORE
            with nullcontext() if first and control.name in first else self._folder(panel):
                self._shown.append((control, self._add(control)))

    def values(self) -> dict[str, bool | float | str]:
        """Return the value of every control, by option."""
        return {
            control.name: self._files.get(control.name, "") if control.kind == "file" else handle.value
            for control, handle in self._shown
        }

    def show_for(self, kind: SourceKind) -> None:
        """Show the controls that have an effect on a kind of source."""
        legal: set[str] = set()
        for control, handle in self._shown:
            handle.visible = control.shown_for(kind)
            if handle.visible:
                legal.add(control.panel)
        for panel, folder in self._folders.items():
            folder.visible = panel in legal

    def _folder(self, panel: str) -> Any:
        if panel not in self._folders:
            self._folders[panel] = self._gui.add_folder(panel, expand_by_default=panel != FIRST_PANEL)
        return self._folders[panel]

    def _add(self, control: Control) -> Any:
        gui, hint = self._gui, control.hint
        handle: Any
        if control.kind == "switch":
            handle = gui.add_checkbox(control.title, bool(control.initial), hint=hint)
        elif control.kind == "choice":
            handle = gui.add_dropdown(
                control.title, control.choices, initial_value=str(control.initial), hint=hint
            )
        elif control.slider is not None:
            s = control.slider
            handle = gui.add_slider(control.title, s.low, s.high, s.step, s.neutral, hint=hint)
        elif control.kind == "file":
            return self._add_file(control)
        else:
            handle = gui.add_text(control.title, str(control.initial), hint=hint)
        handle.on_update(self._guard(lambda _: self._changed()))
        return handle

    def _add_file(self, control: Control) -> Any:
        handle = self._gui.add_upload_button(f"{control.title} ...", hint=control.hint)

        def keep_upload(_: Any) -> None:
            self._files[control.name] = self._keep_file(handle.value.name, handle.value.content)
            handle.label = f"{control.title}: {handle.value.name}"
            self._changed()

        handle.on_upload(self._guard(keep_upload))
        return handle


def add_drop_zone(gui: viser.GuiApi, label: str) -> None:
    """Accept files dropped onto the page while this part is visible.

    Of several files, such as a map's picture and its YAML, the YAML is sent last because it names the others.

    Args:
        gui: of the page.
        label: of the upload button that they go to, or a part of it that no other button has.
    """
    gui.add_html(with_script(_DROP_HTML, _DROP_SCRIPT.replace("LABEL", label)))


class Stick:
    """Stick for manual driving, by pointer or the keys W A S D and arrows.

    viser has no such widget. The stick is HTML that writes its position into the text field below it; the
    page gets an event for each change of the field.

    Args:
        gui: of the page.
        guard: of its callbacks.
        steer: called with forward and left, -1 to 1 each.
    """

    def __init__(self, gui: viser.GuiApi, guard: Guard, steer: Callable[[float, float], None]) -> None:
        html = with_script(_STICK_HTML, _STICK_SCRIPT.replace("LABEL", LABEL))
        self._html = gui.add_html(html, visible=False)
        self._field = gui.add_text(LABEL, "0.00 0.00", hint=HINT, visible=False)
        self._field.on_update(guard(lambda _: steer(*read_stick(self._field.value))))

    @property
    def visible(self) -> bool:
        """Whether it can be used."""
        return bool(self._html.visible)

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._field.visible = self._html.visible = visible
        field: Any = self._field
        field.value = "0.00 0.00"


def read_stick(text: str) -> tuple[float, float]:
    """Return forward and left.

    Raises:
        ConfigError: these are no two finite numbers.
    """
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
