"""Logs as sources of commands: they are mapped first."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from lirs_validation.cli.console import err
from lirs_validation.cli.progress import progress_bar
from lirs_validation.config import SourceOptions


def with_logs_mapped(given: dict[str, Any], options: SourceOptions) -> tuple[dict[str, Any], SourceOptions]:
    """Replace the logs among a command's sources by their maps.

    Args:
        given: the command's own arguments: `source` or `sources`, and `output`.
        options: how sources become worlds; those that only concern a log's map are taken out.

    Raises:
        WctError: a log cannot be mapped, or its map cannot be written.
    """
    # The import loads much of SciPy, which would delay `--help`.
    from lirs_wct.sources.source import is_log

    sources = given.get("sources") or [given.get("source", "")]
    logs = [source for source in sources if source and is_log(Path(source))]
    if not logs:
        return given, options
    out = _folder(given.get("output"))
    maps = {log: _map_log(log, options, out) for log in logs}
    found = [maps.get(source, source) for source in sources]
    rest = replace(options, log_mapper=type(options)().log_mapper)
    if len(logs) == len(sources):
        rest = replace(rest, resolution=None)
    return given | ({"sources": found} if "sources" in given else {"source": found[0]}), rest


def _folder(output: Path | None) -> Path:
    """Return the folder for maps: the output folder, the output file's folder, or here."""
    if output is None:
        return Path()
    return output.parent if output.suffix else output


def _map_log(log: str, options: SourceOptions, out: Path) -> str:
    from lirs_validation.logs.log_source import resolve_source

    with progress_bar(log, err) as progress:
        path = resolve_source(log, options, out, progress)
    err.print(f"{log}: its map is {path}", soft_wrap=True, highlight=False)
    return str(path)
