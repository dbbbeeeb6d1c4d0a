"""Arguments that several commands take."""

from __future__ import annotations

from typing import Annotated

import typer

SOURCE_HELP = "simple, medium, advanced, a picture, a map YAML, a laser log, a mesh or a built folder."
Sources = Annotated[list[str], typer.Argument(help=SOURCE_HELP)]
Source = Annotated[str, typer.Argument(help=SOURCE_HELP)]
