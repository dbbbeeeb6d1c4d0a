"""Arguments shared by several commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lirs_wct.errors import ConfigError

SOURCE_HELP = "simple, medium, advanced, a picture, a map YAML, a laser log, a mesh or a built folder."


def complete_source(incomplete: str) -> list[str]:
    """Return bundled worlds and paths that begin with a text, for the shell."""
    # Slow to import; only the shell's completion needs it.
    from lirs_wct.sources.bundled import RECIPES

    worlds = [name for name in RECIPES if name.startswith(incomplete)]
    folder, separator, name = incomplete.rpartition("/")
    found = [path.name for path in Path(folder + separator).glob("*") if path.name.startswith(name)]
    return worlds + sorted(folder + separator + name for name in found)


Sources = Annotated[list[str], typer.Argument(help=SOURCE_HELP, autocompletion=complete_source)]
Source = Annotated[str, typer.Argument(help=SOURCE_HELP, autocompletion=complete_source)]


def read_fields(text: str | None, flag: str) -> dict[str, str]:
    """Return the fields and values of a list such as `mapper=hector,world=medium`; nothing of None.

    Raises:
        ConfigError: it is no such list.
    """
    pairs = [part.partition("=") for part in (text.split(",") if text is not None else ())]
    if not all(name.strip() and value.strip() for name, _, value in pairs):
        raise ConfigError(f"{flag} must be a list such as mapper=hector,world=medium, got {text!r}")
    return {name.strip(): value.strip() for name, _, value in pairs}
