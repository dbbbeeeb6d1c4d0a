"""Log as a source of worlds.

It is mapped once; later worlds are built from its map.
"""

from __future__ import annotations

import json
from pathlib import Path

from lirs_validation.config import SourceOptions
from lirs_validation.logs.map_log import folder_name, run_mapping
from lirs_validation.map_config import MapConfig
from lirs_validation.record.provenance import is_stale
from lirs_wct.errors import SourceError
from lirs_wct.files import atomic_write
from lirs_wct.formats.map_server import read_map
from lirs_wct.progress import Progress, no_progress
from lirs_wct.sources.options import BuildOptions, SourceKind
from lirs_wct.sources.source import find_source


def resolve_source(
    source: str | Path, options: BuildOptions, out: str | Path, progress: Progress = no_progress
) -> str | Path:
    """Return the source, or for a log the YAML file of its map.

    The map is made into `out` as `lirs-wct map` makes it. One that lies there already is used again, if
    this very log and this very code made it.

    Raises:
        WctError: there is no such source, the log cannot be mapped, or the map cannot be written.
    """
    found = find_source(source, BuildOptions())
    if found.kind is not SourceKind.LOG:
        return source
    config = MapConfig(
        log=str(source),
        mapper=SourceOptions.of(options).log_mapper,
        resolution=options.resolution,
        second="none",
    )
    out = Path(out)
    folder = out / folder_name(config)
    found_before = _read_ending(folder)
    if found_before is None:
        record = run_mapping(config, out=out, progress=progress).record
        found_before = record.status, record.reason
    status, reason = found_before
    if status != "ok":
        what = "left out scans of" if status == "incomplete" else "lost its place in"
        raise SourceError(
            f"{source}: {config.mapper} {what} this log ({reason}), its map is no world (see {folder}); "
            "try another --log-mapper"
        )
    named = folder / f"{found.name}.yaml"
    with atomic_write(named) as path:
        path.write_bytes((folder / "map.yaml").read_bytes())
    return named


def _read_ending(folder: Path) -> tuple[str, str] | None:
    """Return status and reason of a finished mapping in a folder.

    None if the folder holds no current result.
    """
    path = folder / "record.json"
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        ended, written_by = (str(record["status"]), str(record["reason"])), record["versions"]
        read_map(folder / "map.yaml")
    except (OSError, ValueError, KeyError, TypeError, RecursionError, SourceError):
        return None
    # The folder's name holds the digest of the log: another content is another folder.
    return None if is_stale(path, written_by, inputs=()) else ended
