"""Uploaded files of a page: limited in size, with safe names, in the page's folder."""

from __future__ import annotations

import gzip
import io
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

import yaml

from lirs_wct.checks import Checked, limited
from lirs_wct.errors import SourceError
from lirs_wct.files import remove_orphans
from lirs_wct.formats.images.picture import MAX_PIXELS
from lirs_wct.formats.map_server import map_entries
from lirs_wct.formats.suffixes import BAGS, CLOUDS, LOGS, MAPS, MESHES, RASTERS, ZSTD, way_to_read

PICTURES = (".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".tif", ".tiff", ".gif", ".bmp")
SUFFIXES = (*PICTURES, *RASTERS, *MAPS, *MESHES, *CLOUDS, *LOGS, ".gz", *BAGS, ZSTD)
"""Of files that can be sources, textures or a map's picture."""
LONGEST = 80
"""Characters of a name."""
UNPACKED = 8
"""A compressed log or bag may be this many times as large as an upload."""
PREFIX = "lirs-wct-gui-"


@dataclass(frozen=True, kw_only=True)
class PageLimits(Checked):
    """Limits of a page's uploads.

    Attributes:
        upload: bytes of all files that a page sends.
        pixels: of a picture, decoded.
    """

    upload: int = limited(256 * 2**20, "(0, inf]")
    pixels: int = limited(MAX_PIXELS, "(0, inf]")


class Uploads:
    """Files of one page, in a folder that is removed with the page."""

    def __init__(self, limits: PageLimits) -> None:
        parent = Path(tempfile.gettempdir())
        remove_orphans(parent, PREFIX)
        self.folder = Path(tempfile.mkdtemp(prefix=f"{PREFIX}{os.getpid()}-", dir=parent))
        self._limits = limits
        self._sizes: dict[str, int] = {}
        self._replaced: tuple[Path, bytes | None] | None = None

    def add(self, name: str, content: bytes) -> Path:
        """Keep a file; another of its name is replaced.

        Args:
            name: name from the browser; folders and unsafe characters are removed.
            content: of the file.

        Raises:
            SourceError: it is too large, or nothing that this program reads.
        """
        safe = harmless(name)
        suffix = Path(safe).suffix.lower()
        if suffix not in SUFFIXES:
            way = way_to_read(Path(safe)) or f"not a file that is read; legal: {', '.join(SUFFIXES)}"
            raise SourceError(f"{safe}: {way}")
        self.check_room(safe, len(content))
        if suffix in (".gz", ZSTD):
            self._check_unpacked(safe, content)
        if suffix in MAPS:
            content = _beside(safe, content)
        path = self.folder / safe
        self._replaced = path, path.read_bytes() if path.exists() else None
        path.write_bytes(content)
        self._sizes[safe] = len(content)
        return path

    def undo(self) -> None:
        """Remove the last file again; one that it replaced comes back."""
        if self._replaced is None:
            return
        (path, before), self._replaced = self._replaced, None
        path.unlink(missing_ok=True)
        self._sizes.pop(path.name, None)
        if before is not None:
            path.write_bytes(before)
            self._sizes[path.name] = len(before)

    def check_room(self, name: str, size: int) -> None:
        """Raise SourceError if a file of this size is more than the page may send."""
        held = sum(count for other, count in self._sizes.items() if other != harmless(name))
        if held + size > self._limits.upload:
            raise SourceError(
                f"{harmless(name)}: {size / 2**20:.1f} MiB are too many: a page may send "
                f"{self._limits.upload / 2**20:g} MiB in all, {held / 2**20:.1f} MiB are used"
            )

    def _check_unpacked(self, name: str, content: bytes) -> None:
        most, size = UNPACKED * self._limits.upload, 0
        try:
            for part in _decompress(name, content):
                size += len(part)
                if size > most:
                    break
        except (OSError, EOFError, ImportError):
            return  # damaged, or without the library of bags: its reader says how
        if size > most:
            raise SourceError(f"{name}: unpacks to more than {most / 2**20:g} MiB")

    def close(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)


def _decompress(name: str, content: bytes) -> Iterator[bytes]:
    """Yield the decompressed content of a file in parts.

    Raises:
        OSError, EOFError: it is damaged.
        ImportError: it is a bag, and the library is not installed.
    """
    if name.lower().endswith(ZSTD):
        from lirs_wct.formats.rosbag.compression import ZstdStream

        file: io.BufferedIOBase = ZstdStream(io.BytesIO(content))
    else:
        file = gzip.GzipFile(fileobj=io.BytesIO(content))
    with file:
        while part := file.read(1 << 20):
            yield part


def harmless(name: str) -> str:
    """Return a file's own name without folders, of letters, digits, dots, hyphens and underscores.

    >>> harmless("../../etc/my map.YAML")
    'my_map.YAML'
    """
    last = PureWindowsPath(name).name  # takes both kinds of slashes
    stem, dot, suffix = re.sub(r"[^A-Za-z0-9_.-]+", "_", last).rpartition(".")
    return f"{stem.strip('._-')[:LONGEST] or 'file'}{dot}{suffix[:10]}"


def _beside(name: str, content: bytes) -> bytes:
    """Return a map's YAML whose picture is the uploaded file of that name."""
    try:
        entry = map_entries(Path(name), content)
        entry["image"] = harmless(str(entry["image"]))
    except (ValueError, KeyError) as error:
        raise SourceError(f"{name}: is no YAML of a map, which names its image") from error
    return yaml.safe_dump(entry).encode()
