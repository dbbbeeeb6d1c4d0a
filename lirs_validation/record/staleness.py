"""Staleness: whether results in a folder are still those that running again would give."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from lirs_validation.config import RunConfig
from lirs_validation.record.provenance import code, versions


def same_code(found: Any) -> bool:
    """Tell whether a result comes from this version of the package, and from this very code."""
    return (
        isinstance(found, dict)
        and found.get("code") == code()
        and found.get("lirs-wct") == versions()["lirs-wct"]
    )


def world_files(config: RunConfig) -> list[Path]:
    """Return the files that a source is read from, as far as its name says; none for a bundled world."""
    path = Path(config.source)
    if path.is_dir():
        return [path / "world.json", path / "world.npz"]
    siblings = path.parent.glob(f"{path.stem}.*") if path.suffix in (".yaml", ".yml") else ()
    textures = (config.build.texture, config.build.wall_texture)
    return [path, *siblings, *filter(None, textures)]


def is_stale(result: Path, found: Any, inputs: Iterable[Path | None]) -> bool:
    """Tell whether other code wrote a result, or an input changed after it was written.

    Args:
        result: file that was written last.
        found: the versions that the result says it is of.
        inputs: files that it was made from, where they are known.
    """
    return not same_code(found) or is_older(result, inputs)


def is_older(result: Path, inputs: Iterable[Path | None]) -> bool:
    """Tell whether an input was written, moved or copied after the result was."""
    written = result.stat().st_mtime
    for path in inputs:
        with suppress(OSError):
            if path is not None and max(path.stat().st_mtime, path.stat().st_ctime) > written:
                return True
    return False
