"""The command `gui`: the live page."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from lirs_validation.cli.progress import out
from lirs_validation.cli.typer_options import SOURCE_HELP, complete_source
from lirs_wct.errors import ConfigError


def gui(
    source: Annotated[
        str | None, typer.Argument(help=f"Shown first: {SOURCE_HELP}", autocompletion=complete_source)
    ] = None,
    runs: Annotated[
        Path, typer.Option(help="Folder of finished runs, or one run's, that pages may replay.")
    ] = Path("out"),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen at; 0 = any free one.")] = 8080,
    host: Annotated[
        str, typer.Option(help="Address to listen at; 0.0.0.0 = every network that this machine is in.")
    ] = "127.0.0.1",
) -> None:
    """Build worlds, drive robots and replay runs in a browser; ends with Ctrl-C."""
    if find_spec("viser") is None:
        raise ConfigError("the live page needs viser: pip install '.[gui]'")
    from lirs_validation.gui.server import Server
    from lirs_wct.sources.options import BuildOptions
    from lirs_wct.sources.source import find_source

    if source is not None:
        find_source(source, BuildOptions())
    server = Server(source, runs=runs if runs.is_dir() else None, host=host, port=port)
    out.print(f"{server.address}: open it in a browser, Ctrl-C ends it", soft_wrap=True, highlight=False)
    server.serve()
