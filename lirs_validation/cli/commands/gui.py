"""The command `gui`: the live page."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from lirs_validation.cli.command import SOURCE_HELP, complete_source
from lirs_validation.cli.progress import say
from lirs_wct.errors import ConfigError
from lirs_wct.option import Options, argument, option, within


@dataclass(frozen=True, kw_only=True)
class GuiOptions(Options):
    """Source, runs and address of `gui`."""

    source: str | None = argument(f"Shown first: {SOURCE_HELP}", "[SOURCE]", None, complete=complete_source)
    runs: Path = option(Path("out"), "Folder of finished runs, or one run's, that pages may replay.")
    port: int = option(8080, "Port to listen at; 0 = any free one.", check=within("[0, 65535]"))
    host: str = option(
        "127.0.0.1",
        "Address to listen at; 0.0.0.0 = every network that this machine is in.",
        metavar="ADDRESS",
    )


def gui(options: GuiOptions) -> None:
    """Build worlds, drive robots and replay runs in a browser; ends with Ctrl-C.

    Examples:
    lirs-wct gui medium --port 8080
    """
    if find_spec("viser") is None:
        raise ConfigError("the live page needs viser: pip install '.[gui]'")
    from lirs_validation.gui.server import Server
    from lirs_wct.sources.source import BuildOptions, find_source

    if options.source is not None:
        find_source(options.source, BuildOptions())
    runs = options.runs if options.runs.is_dir() else None
    server = Server(options.source, runs=runs, host=options.host, port=options.port)
    say(f"{server.address}: open it in a browser, Ctrl-C ends it")
    server.serve()
