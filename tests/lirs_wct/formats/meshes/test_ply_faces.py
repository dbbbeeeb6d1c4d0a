"""PLY with faces of any number of corners, as text and binary of both byte orders."""

import struct
from pathlib import Path

import numpy as np
import pytest

from lirs_wct.errors import SourceError
from lirs_wct.formats.meshes.reader import read_upright
from lirs_wct.sources.build import build_world
from tests.kit import refused

PLACES = [
    (x, 0.2 * y, z)
    for y in (0, 1)
    for x, z in ((0, 0), (1.5, 0), (1.5, 2), (2.5, 2), (2.5, 0), (4, 0), (4, 3), (0, 3))
]
DOOR = [
    tuple(range(8)),
    tuple(range(15, 7, -1)),
    *((i, i - 1, i + 7, i + 8) for i in range(1, 8)),
    (0, 7, 15, 8),
]
"""Wall of 4 x 3 m with a door of 1 x 2 m."""


def door(path: Path, kind: str, faces: list[tuple[int, ...]] = DOOR, flags: bool = False) -> Path:
    """Write a PLY; with flags, each face has a number before and a list after its corners."""
    extra = ("property uchar flag\n", "property list uchar float quality\n") if flags else ("", "")
    head = (
        f"ply\nformat {kind} 1.0\ncomment element face 7\nelement vertex {len(PLACES)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\n{extra[0]}property list uchar int vertex_indices\n{extra[1]}end_header\n"
    )
    order = ">" if "big" in kind else "<"
    rows = [(order + "3d", place) for place in PLACES]
    for k, face in enumerate(faces):
        flag, quality = ((k,), (k % 3, *[0.5] * (k % 3))) if flags else ((), ())
        code = f"{len(flag)}BB{len(face)}i" + (f"B{k % 3}f" if flags else "")
        rows.append((order + code, (*flag, len(face), *face, *quality)))
    if kind == "ascii":
        body = "\n".join(" ".join(map(str, values)) for _, values in rows).encode()
    else:
        body = b"".join(struct.pack(code, *values) for code, values in rows)
    path.write_bytes(head.encode() + body)
    return path


@pytest.mark.parametrize("flags", [False, True])
@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_wall_with_a_door(tmp_path: Path, kind: str, flags: bool) -> None:
    mesh = read_upright(door(tmp_path / "a.ply", kind, flags=flags))
    np.testing.assert_allclose(mesh.bounds, [(0, 0, 0), (4, 0.2, 3)])
    assert mesh.is_watertight
    assert abs(mesh.volume) == pytest.approx(10 * 0.2)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_a_file_that_ends_in_a_face(tmp_path: Path, kind: str) -> None:
    path = door(tmp_path / "a.ply", kind)
    path.write_bytes(path.read_bytes()[:-9])
    reason = "is damaged or cut off in its face list: |is damaged: a face has a corner"
    with refused(f"{path}: ", reason):
        read_upright(path)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (b"little", b"middle", "has the unknown format 'binary_middle_endian'; legal: ascii, binary_"),
        (b"element face", b"element tristrips", "holds tristrips, which are not read; export it with faces"),
        (b"list uchar", b"list char", "is damaged or cut off in its face list: a length is negative"),
    ],
)
def test_a_header_that_is_refused(tmp_path: Path, old: bytes, new: bytes, reason: str) -> None:
    path = door(tmp_path / "a.ply", "binary_little_endian")
    path.write_bytes(path.read_bytes().replace(old, new).replace(b"\x08\0\0", b"\xfb\0\0", 1))
    with pytest.raises(SourceError, match=rf"^{path}: .*{reason}"):
        build_world(path)
