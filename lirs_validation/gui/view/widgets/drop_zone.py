"""Files that are dropped onto the page go the way of an upload button; viser's own takes none."""

from __future__ import annotations

import viser

from lirs_validation.gui.view.widgets.html import with_script

_HTML = """
<div class="lirs-drop" style="text-align:center;font-size:.8em;opacity:.7;margin:-.2em 0 .5em">
 or drop it anywhere on the page SCRIPT
</div>
"""
_SCRIPT = """
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


def add_drop_zone(gui: viser.GuiApi, label: str) -> None:
    """Let files be dropped onto the page while this part of it is seen.

    Of several files, as a map's picture and its YAML, the YAML comes last: it names the others.

    Args:
        gui: of the page.
        label: of the upload button that they go to, or a part of it that no other button has.
    """
    gui.add_html(with_script(_HTML, _SCRIPT.replace("LABEL", label)))
