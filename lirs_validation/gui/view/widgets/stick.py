"""A stick in the page, and the keys W A S D and arrows, to drive by hand.

viser has neither. The stick is HTML of its own, which writes where it is into the text field beside it; the
page hears of that as of any change of a field.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import viser

from lirs_validation.gui.view.guard import Guard
from lirs_validation.gui.view.widgets.html import with_script
from lirs_wct.errors import ConfigError

LABEL = "stick"
HINT = "Forward and left, -1 to 1 each. Drag the stick, hold W A S D or the arrow keys, or write here."
_HTML = """
<div tabindex="0" class="lirs-stick" style="position:relative;width:9em;height:9em;margin:.2em auto .6em;
 border-radius:50%;background:radial-gradient(#f4f6f8,#d5dbe1);border:1px solid #aab4be;touch-action:none;
 cursor:grab;outline:none">
 <div class="lirs-knob" style="position:absolute;left:50%;top:50%;width:3em;height:3em;margin:-1.5em;
  border-radius:50%;background:#0072B2;box-shadow:0 2px 5px #0006;pointer-events:none"></div>
 SCRIPT
</div>
<div style="text-align:center;font-size:.8em;opacity:.7">drag, or hold W A S D / arrow keys</div>
"""
_SCRIPT = """
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


class Stick:
    """A stick with its field.

    Args:
        gui: of the page.
        guard: of its callbacks.
        steer: called with forward and left, -1 to 1 each.
    """

    def __init__(self, gui: viser.GuiApi, guard: Guard, steer: Callable[[float, float], None]) -> None:
        self._html = gui.add_html(with_script(_HTML, _SCRIPT.replace("LABEL", LABEL)), visible=False)
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
