"""Linux's renames that exchange two paths or refuse to replace one, with `renameat2`."""

from __future__ import annotations

import ctypes
import errno
import os
import sys
from pathlib import Path

_CURRENT_FOLDER = -100
_NO_REPLACE = 1
_EXCHANGE = 2
_UNSUPPORTED = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)


def exchange(path: Path, other: Path) -> bool:
    """Exchange two paths in one step; return False where the file system cannot."""
    return _renameat2(path, other, _EXCHANGE)


def move(path: Path, target: Path) -> None:
    """Rename a file or folder, and never replace another one.

    Raises:
        FileExistsError: the target exists.
        OSError: the file system refuses the rename.
    """
    if _renameat2(path, target, _NO_REPLACE):
        return
    if os.path.lexists(target):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target))
    path.rename(target)


def _renameat2(path: Path, target: Path, flags: int) -> bool:
    """Call `renameat2`; return False where the system or the file system does not have it."""
    if sys.platform == "win32":
        return False
    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if call is None:
        return False
    if call(_CURRENT_FOLDER, os.fsencode(path), _CURRENT_FOLDER, os.fsencode(target), flags) == 0:
        return True
    code = ctypes.get_errno()
    if code in _UNSUPPORTED:
        return False
    raise OSError(code, os.strerror(code), str(path), None, str(target))
