"""Options on a page: a control for each, under headings."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import viser

from lirs_validation.gui.session.controls import FIRST_PANEL, Control, controls
from lirs_validation.gui.view.guard import Guard
from lirs_wct.option import Options
from lirs_wct.sources.source_kind import SourceKind

MORE = "More options"
"""Heading of the options that are not among the first."""


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

        def uploaded(_: Any) -> None:
            self._files[control.name] = self._keep_file(handle.value.name, handle.value.content)
            handle.label = f"{control.title}: {handle.value.name}"
            self._changed()

        handle.on_upload(self._guard(uploaded))
        return handle
