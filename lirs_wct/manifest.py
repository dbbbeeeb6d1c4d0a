"""The manifest of a folder: a list of the files that this program wrote there, with their digests.

The manifest is text as `sha256sum` writes and checks it (and BagIt, RFC 8493, section 2.1.3).
"""

from __future__ import annotations

import hashlib
from pathlib import Path

MANIFEST = "manifest-sha256.txt"


def write_manifest(folder: Path) -> None:
    """List every file that a folder holds now."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != MANIFEST)
    lines = (f"{digest(path)}  {path.relative_to(folder).as_posix()}\n" for path in files)
    (folder / MANIFEST).write_text("".join(lines), encoding="utf-8")


def read_manifest(folder: Path) -> dict[str, str] | None:
    """Return the digests by file name; None if the manifest is missing or damaged."""
    try:
        lines = (folder / MANIFEST).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return None
    return {name: value for value, _, name in (line.partition("  ") for line in lines)}


def digest(path: Path) -> str:
    """Return the SHA-256 digest of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
