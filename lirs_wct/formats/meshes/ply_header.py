"""The header of a PLY file: its elements and their properties."""

from __future__ import annotations

from pathlib import Path

from lirs_wct.errors import SourceError

_HEADER = 1 << 16
"""Bytes of a file in which its header stands."""


def ply_elements(path: Path) -> dict[str, tuple[int, tuple[str, ...]]] | None:
    """Return each element's count and the names of its properties; None where it is no PLY header."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEADER)
    except OSError:
        return None
    text, end, _ = head.partition(b"end_header")
    if not (head.startswith(b"ply") and end):
        return None
    found: dict[str, tuple[int, tuple[str, ...]]] = {}
    for line in text.decode("ascii", errors="replace").splitlines():
        match line.split():
            case ["element", name, count] if count.isdecimal():
                found[name] = (int(count), ())
            case ["property", *_, name] if found:
                element = next(reversed(found))
                found[element] = (found[element][0], (*found[element][1], name))
    return found


def require_positions(path: Path) -> None:
    """Check that the vertices of a PLY file have x, y and z, and that its elements fit into the file.

    Raises:
        SourceError: it has no vertices, or these have other properties, or it is too short for its counts.
    """
    elements = ply_elements(path)
    if elements is None:
        return  # the reader says what is wrong with it
    if "vertex" not in elements:
        got = ", ".join(elements) or "none"
        raise SourceError(f"{path}: needs an element 'vertex' with x, y and z; its elements are: {got}")
    require_xyz(path, elements["vertex"][1])
    # Each value takes a byte at least, of a number or of its text.
    need, size = sum(n * len(names) for n, names in elements.values()), path.stat().st_size
    if need > size:
        counts = ", ".join(f"{n} of {name}" for name, (n, _) in elements.items())
        raise SourceError(f"{path}: is damaged or cut off: {counts} need {need} bytes or more, it has {size}")


def require_xyz(path: Path, fields: tuple[str, ...]) -> None:
    """Check that the fields of points hold x, y and z.

    Raises:
        SourceError: one of them is missing.
    """
    if missing := [axis for axis in "xyz" if axis not in fields]:
        got = ", ".join(fields) or "none"
        raise SourceError(f"{path}: points need x, y and z; missing: {', '.join(missing)}; got: {got}")
