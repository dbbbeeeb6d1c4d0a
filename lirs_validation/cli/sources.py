"""Sources of commands: worlds, files, and logs, which are mapped first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from lirs_validation.cli.command import Few
from lirs_validation.cli.progress import note, progress_bar
from lirs_validation.config import WORLD_FLAGS
from lirs_wct.formats.suffixes import Storage
from lirs_wct.option import Options, argument, option
from lirs_wct.sources.source import BuildOptions, is_log

SOURCE_HELP = "simple, medium, advanced, a picture, a map YAML, a laser log, a mesh or a built folder."
World = Annotated[BuildOptions, Few(WORLD_FLAGS)]
"""Options of a world for commands that drive through it; `build` has a flag for each."""


def complete_source(incomplete: str) -> list[str]:
    """Return bundled worlds and paths that begin with a text, for the shell."""
    # Slow to import; only the shell's completion needs it.
    from lirs_wct.sources.bundled import RECIPES

    worlds = [name for name in RECIPES if name.startswith(incomplete)]
    folder, separator, name = incomplete.rpartition("/")
    found = [path.name for path in Path(folder + separator).glob("*") if path.name.startswith(name)]
    return worlds + sorted(folder + separator + name for name in found)


def sources_argument(**given: Any) -> Any:
    """Return a field of several sources."""
    return argument(SOURCE_HELP, "SOURCES...", complete=complete_source, **given)


@dataclass(frozen=True, kw_only=True)
class OneSource(Options):
    """Source of a command."""

    source: str = argument(SOURCE_HELP, "SOURCE", complete=complete_source)


@dataclass(frozen=True, kw_only=True)
class BagOptions(Options):
    """ROS 2 bag that a command writes."""

    storage: Storage = option("mcap", "Storage of the bag's messages.")
    sensors_only: bool = option(False, "No map -> odom and /map, for a SLAM system that publishes these.")


def map_logs(
    sources: Sequence[str], options: BuildOptions, output: Path | None
) -> tuple[tuple[str, ...], BuildOptions]:
    """Replace the logs among sources by their maps; return the options that are left.

    Args:
        sources: Sources of a command.
        options: Construction of the world; the resolution of logs is that of their maps.
        output: Output folder or file of the command, where the maps are written; None = here.

    Raises:
        WctError: a log cannot be mapped, or its map cannot be written.
    """
    logs = [source for source in sources if is_log(Path(source))]
    folder = Path() if output is None else output.parent if output.suffix else output
    maps = {log: _map_log(log, options, folder) for log in logs}
    if logs and len(logs) == len(sources):
        options = replace(options, resolution=None)
    return tuple(maps.get(source, source) for source in sources), options


def _map_log(log: str, options: BuildOptions, out: Path) -> str:
    from lirs_validation.logs.map_log import resolve_source

    with progress_bar(log) as progress:
        path = resolve_source(log, options, out, progress)
    note(f"{log}: its map is {path}")
    return str(path)
