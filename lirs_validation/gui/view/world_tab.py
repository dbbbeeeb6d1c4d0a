"""Tab for the construction of worlds: source, options, facts, package."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import viser

from lirs_validation.gui.session.construction import Construction, Facts, Shown, zip_folder
from lirs_validation.gui.session.controls import read_controls
from lirs_validation.gui.view.page_context import PageContext
from lirs_validation.gui.view.widgets import OptionControls, ProgressLine, add_drop_zone, as_table
from lirs_wct.errors import ConfigError
from lirs_wct.export.package import DEFAULT_FORMATS, FORMATS, GazeboTerrain
from lirs_wct.sources.bundled import RECIPES
from lirs_wct.sources.source import BuildOptions, find_source

FIRST = (
    *("size", "height", "invert", "smoothing", "z_scale", "wall_height", "unknown", "speckle"),
    *("resolution", "cloud_surface"),
)
"""Options above the folded ones; at most five of them have an effect on a kind of source."""
TERRAINS: tuple[GazeboTerrain, ...] = ("solid", "heightmap")


class WorldTab:
    """Controls of the construction, and the world that they make.

    Attributes:
        shown: World that the page shows; None before the first.
    """

    def __init__(self, page: PageContext, sources: dict[str, str], changed: Callable[[Shown], None]) -> None:
        self._page, self._sources, self._tell = page, dict(sources), changed
        self._construction = Construction(page.uploads.folder, scenarios=page.scenarios)
        self.shown: Shown | None = None
        gui = page.client.gui
        self._add_source(gui)
        self._add_results(gui)
        self._options = OptionControls(
            gui, page.guard, BuildOptions, changed=self.preview, keep_file=self._keep, first=FIRST
        )
        self._add_files(gui)

    def _add_source(self, gui: viser.GuiApi) -> None:
        self._source = gui.add_dropdown(
            "source", tuple(self._sources), hint="A bundled world, or a file that was opened here."
        )
        self._source.on_update(self._page.guard(self._chosen))
        upload = gui.add_upload_button(
            "Open a file ...",
            icon=viser.Icon.UPLOAD,
            hint="Picture of heights, laser map (first its picture, then its YAML), mesh, laser log or bag.",
        )
        upload.on_upload(self._page.guard(lambda _: self._open(upload.value.name, upload.value.content)))
        add_drop_zone(gui, "Open a file")

    def _add_results(self, gui: viser.GuiApi) -> None:
        self._build = gui.add_button("Build", color="green", icon=viser.Icon.HAMMER)
        self._build.on_click(self._page.guard(lambda _: self.build()))
        self._download = gui.add_button("Download the package", icon=viser.Icon.DOWNLOAD, disabled=True)
        self._download.on_click(self._page.guard(lambda _: self._page.worker.submit("download", self._send)))
        self._progress = ProgressLine(gui)
        self._facts = gui.add_markdown("")

    def _add_files(self, gui: viser.GuiApi) -> None:
        with gui.add_folder("Files of the package", expand_by_default=False):
            self._formats = {
                name: gui.add_checkbox(name, name in DEFAULT_FORMATS, hint="Written by Build.")
                for name in FORMATS
            }
            self._terrain = gui.add_dropdown(
                "Gazebo model", TERRAINS, hint="The solid mesh, or a heightmap (square, 2^n + 1 px, 8 bit)."
            )

    def _chosen(self, event: viser.GuiEvent[Any]) -> None:
        """Show the source that a person chose."""
        if event.client_id is not None:
            self.preview()

    def preview(self) -> None:
        """Show a coarse preview for the present controls."""
        self._page.worker.submit("preview", self._preview)

    def build(self) -> None:
        """Build the world of the present controls, show it and write its package."""
        self._build.disabled = True
        self._page.worker.submit("build", self._build_now)

    def _keep(self, name: str, content: bytes) -> str:
        path = self._page.uploads.add(name, content)
        self._construction.forget()
        return str(path)

    def _open(self, name: str, content: bytes) -> None:
        self._page.worker.submit(f"open {name}", lambda: self._open_now(name, content))

    def _open_now(self, name: str, content: bytes) -> None:
        """Show an uploaded file; world and controls stay if it is refused."""
        path = Path(self._keep(name, content))
        self._show_preview(str(path), path.name)
        self._show_controls(str(path))
        self._sources[path.name] = str(path)
        self._source.options = tuple(self._sources)
        self._source.value = path.name  # type: ignore[misc]

    def _read(self) -> BuildOptions:
        return read_controls(self._options.values())

    def _preview(self) -> None:
        name = self._source.value
        self._show_controls(self._sources[name])
        self._show_preview(self._sources[name], name)

    def _show_controls(self, source: str) -> None:
        self._options.show_for(find_source(source, self._read()).kind)

    def _show_preview(self, source: str, name: str) -> None:
        options = self._read()
        with self._progress.show(name) as progress:
            shown = self._construction.preview(source, options, progress)
            triangles = self._page.scene.show_world(shown.world, coarse=True)
        self._download.disabled = True
        self._show(shown, (("preview", f"{triangles:,} triangles"),))

    def _build_now(self) -> None:
        try:
            source, options = self._sources[self._source.value], self._read()
            formats = [name for name, box in self._formats.items() if box.value]
            if not formats:
                raise ConfigError(f"nothing to write; legal: {', '.join(FORMATS)}")
            with self._progress.show(self._source.value) as progress:
                shown = self._construction.build(source, options, formats, self._terrain.value, progress)
                triangles = self._page.scene.show_world(shown.world, coarse=False)
        finally:
            self._build.disabled = False
        self._download.disabled = False
        self._show(shown, (("shown", f"{triangles:,} triangles"),))

    def _show(self, shown: Shown, more: Facts) -> None:
        self.shown = shown
        self._facts.content = as_table((*shown.facts, *more))
        self._page.guard.done()
        self._tell(shown)

    def _send(self) -> None:
        if self.shown is None or self.shown.package is None:
            raise ConfigError("nothing is built yet: Build comes first")
        folder = self.shown.package
        self._page.client.send_file_download(f"{folder.name}.zip", zip_folder(folder), save_immediately=True)


def first_sources(given: str | None) -> dict[str, str]:
    """Return the sources of a new page: the command line's, then the bundled worlds."""
    named = {} if given is None else {given if given in RECIPES else Path(given).name: given}
    return named | {name: name for name in RECIPES if name not in named}
