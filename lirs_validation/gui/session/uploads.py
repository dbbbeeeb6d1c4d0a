"""Uploaded files of a page, under safe names in the page's folder."""

from __future__ import annotations

import re
from pathlib import Path, PureWindowsPath
from tempfile import TemporaryDirectory

import yaml

from lirs_wct.errors import SourceError
from lirs_wct.formats import map_server, suffixes

MAX_NAME = 80
"""Characters of a file's stem."""


class Uploads:
    """Files of one page, in a folder that is removed with the page.

    Attributes:
        folder: Folder of the page, also for its maps, worlds and runs.
    """

    def __init__(self) -> None:
        self._temporary = TemporaryDirectory(prefix="lirs-wct-gui-", ignore_cleanup_errors=True)
        self.folder = Path(self._temporary.name)

    def add(self, name: str, content: bytes) -> Path:
        """Keep a file under its name without folders and unsafe characters; another is replaced.

        Raises:
            SourceError: A YAML is not that of a map.
        """
        path = self.folder / harmless(name)
        if path.suffix.lower() in suffixes.MAPS:
            content = with_own_picture(path.name, content)
        path.write_bytes(content)
        return path

    def close(self) -> None:
        """Remove the folder."""
        self._temporary.cleanup()


def harmless(name: str) -> str:
    """Return a file's own name without folders, of letters, digits, dots, hyphens and underscores.

    >>> harmless("../../etc/my map.YAML")
    'my_map.YAML'
    """
    last = PureWindowsPath(name).name  # takes both kinds of slashes
    stem, dot, suffix = re.sub(r"[^A-Za-z0-9_.-]+", "_", last).rpartition(".")
    return f"{stem.strip('._-')[:MAX_NAME] or 'file'}{dot}{suffix[:10]}"


def with_own_picture(name: str, content: bytes) -> bytes:
    """Return a map's YAML whose picture is the file of that name beside it.

    Raises:
        SourceError: it is not the YAML of a map.
    """
    try:
        entry = map_server.map_entries(Path(name), content)
        entry["image"] = harmless(str(entry["image"]))
    except (ValueError, KeyError) as error:
        raise SourceError(f"{name}: is no YAML of a map, which names its image") from error
    return yaml.safe_dump(entry).encode()
