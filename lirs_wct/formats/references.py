"""References of a file to other files in its folder or package.

References outside it, or to a network, are refused.
"""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import unquote, urlsplit

from lirs_wct.errors import SourceError

_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+._-]+:")
"""Begins a URL, or a driver's prefix of GDAL; one letter is a drive of Windows."""
_PACKAGE = ("model.config", "world.json")
"""Files that mark the top folder of a Gazebo model package, and of a built world."""


def referenced_file(owner: Path, name: str) -> Path:
    """Return the path of a referenced file, which need not exist.

    A relative name begins at the owner's folder, `model://NAME/...` at the folder of its model package.

    Args:
        owner: file that holds the reference.
        name: as the owner spells it: a path, `file://` or `model://`.

    Raises:
        SourceError: the name is another URL, or leads out of the owner's folder or package, also through
            `..` or a symbolic link. A package is a Gazebo model's folder or that of a built world.
    """
    folder = owner.parent.resolve()
    package = next(
        (at for at in (folder, *folder.parents) if any((at / n).is_file() for n in _PACKAGE)), None
    )
    root, base, given = package or folder, folder, name.strip()
    if given.startswith("model://") and package is not None:
        root = base = package.parent
        given = unquote(given.removeprefix("model://"))
    elif given.startswith("file://"):
        given = unquote(urlsplit(given).path)
    if given.startswith(("/vsi", "\\\\", "<")) or "\0" in given or _SCHEME.match(given):
        raise SourceError(f"{owner}: names {_short(name)}; only files in {root} are read")
    try:
        found = (base / given).resolve()
    except (OSError, RuntimeError) as error:  # too long, or a loop of links
        raise SourceError(f"{owner}: names {_short(name)}, which is no legal path") from error
    if not found.is_relative_to(root):
        raise SourceError(
            f"{owner}: names {_short(name)}, which is outside {root}; only files in it are read"
        )
    return found


def _short(name: str) -> str:
    text = " ".join(name.split())
    return repr(text if len(text) <= 200 else f"{text[:200]}...")
