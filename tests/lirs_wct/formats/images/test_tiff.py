"""Tags of TIFF files made byte by byte."""

import itertools
import math
import struct
from collections.abc import Mapping
from typing import Any, cast

import pytest

from lirs_wct.formats.images import tiff
from lirs_wct.formats.images.tiff import Tags, TagValue

KINDS = {"B": 1, "s": 2, "H": 3, "I": 4, "b": 6, "h": 8, "i": 9, "f": 11, "d": 12, "Q": 16, "q": 17}
Entries = Mapping[int, tuple[str, tuple[Any, ...]]]
FORMS = list(itertools.product("<>", (False, True)))


def directory(entries: Entries, at: int, order: str, big: bool, following: int = 0) -> bytes:
    """Return a directory that begins at a byte; values that do not fit into its entries follow it."""
    word, inline = ("Q", 8) if big else ("I", 4)
    size = (8 if big else 2) + len(entries) * (20 if big else 12) + inline
    head, rest = struct.pack(order + ("Q" if big else "H"), len(entries)), b""
    for tag, (kind, values) in entries.items():
        count = len(values[0]) if kind == "s" else len(values)
        data = struct.pack(f"{order}{count}{kind}", *values)
        if len(data) > inline:
            where = struct.pack(order + word, at + size + len(rest))
            rest += data
        else:
            where = data.ljust(inline, b"\0")
        head += struct.pack(order + "HH" + word, tag, KINDS[kind], count) + where
    return head + struct.pack(order + word, following) + rest


def start(order: str, big: bool, first: int) -> bytes:
    mark = b"II" if order == "<" else b"MM"
    if big:
        return mark + struct.pack(order + "HHHQ", 43, 8, 0, first)
    return mark + struct.pack(order + "HI", 42, first)


def tiff_file(entries: Entries, order: str = "<", big: bool = False) -> bytes:
    first = 20  # a gap behind the header: the offset is read, not guessed
    return start(order, big, first).ljust(first, b"?") + directory(entries, first, order, big)


def read(data: bytes) -> tuple[Tags, tuple[int, ...]]:
    return tiff.read_tags(cast(Any, data))


ALL: Entries = {
    256: ("H", (513,)),
    257: ("I", (70001,)),
    300: ("B", (1, 2, 3)),
    301: ("B", (1, 2, 3, 4)),
    302: ("B", tuple(range(9))),
    303: ("b", (-1, -2)),
    304: ("h", (-300, 5)),
    305: ("h", (-300, 5, 7)),
    306: ("i", (-70000,)),
    307: ("i", (-70000, 8)),
    308: ("f", (0.5,)),
    309: ("f", (0.5, -2.0, 8.0)),
    310: ("d", (1e-9, -math.pi)),
    311: ("s", (b"abc\0",)),
    312: ("s", (b"a long text\0\0",)),
    313: ("Q", (1 << 40,)),
    314: ("q", (-(1 << 40), 3)),
}


@pytest.mark.parametrize(("order", "big"), FORMS)
def test_every_type_in_place_and_by_offset(order: str, big: bool) -> None:
    tags, kinds = read(tiff_file(ALL, order, big))
    expected: dict[int, TagValue] = {
        tag: values[0].rstrip(b"\0") if kind == "s" else values for tag, (kind, values) in ALL.items()
    }
    assert tags == expected
    assert kinds == (0,)


def test_a_type_that_is_not_known_is_passed_over() -> None:
    data = bytearray(tiff_file({256: ("H", (5,)), 400: ("H", (6,)), 257: ("H", (7,))}))
    for kind in (5, 7, 13, 99):
        struct.pack_into("<H", data, 20 + 2 + 12 + 2, kind)
        assert read(bytes(data))[0] == {256: (5,), 257: (7,)}
    struct.pack_into("<H", data, 20 + 2 + 12 + 2, 3)
    assert read(bytes(data))[0] == {256: (5,), 400: (6,), 257: (7,)}


@pytest.mark.parametrize(("order", "big"), FORMS)
@pytest.mark.parametrize("loop", [False, True])
def test_pages_are_the_directories_of_the_chain(order: str, big: bool, loop: bool) -> None:
    one, offsets = directory({256: ("H", (1,))}, 0, order, big), [20, 300, 120]
    data = bytearray(start(order, big, 20).ljust(400, b"\0"))
    for k, (at, value) in enumerate(zip(offsets, (11, 22, 33), strict=True)):
        following = offsets[k + 1] if k < 2 else (120 if loop else 0)
        data[at : at + len(one)] = directory({256: ("H", (value,))}, at, order, big, following)
    assert read(bytes(data)) == ({256: (11,)}, (0, 0, 0))


def test_a_directory_that_ends_early() -> None:
    data = tiff_file({256: ("H", (5,)), 257: ("d", (1.0, 2.0))})
    for cut in (1, 17, 20, 40):
        with pytest.raises(struct.error):
            read(data[:-cut])


@pytest.mark.parametrize("tags", [(273, 279), (324, 325)])
def test_pixels_that_the_file_does_not_hold(tags: tuple[int, int]) -> None:
    def with_strips(last: int) -> bytes:
        return tiff_file({256: ("H", (5,)), tags[0]: ("I", (30, last - 25)), tags[1]: ("I", (20, 25))})

    size = len(with_strips(25))
    assert read(with_strips(size))[1] == (0,)
    with pytest.raises(ValueError, match=f"is truncated: {size + 1} bytes of pixels announced, {size} there"):
        read(with_strips(size + 1))
    half = tiff_file({tags[0]: ("I", (9999, 8888))})  # offsets alone announce nothing
    assert read(half)[1] == (0,)
