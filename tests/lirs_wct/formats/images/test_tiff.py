"""Tags of TIFF files made byte by byte, and what GeoTIFF says in them, against formulas of its own."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.images import tiff
from lirs_wct.formats.images.geotiff import height_unit, raster_info
from lirs_wct.formats.images.tiff import Tags, TagValue
from lirs_wct.geometry.geodesy import CoordinateSystem, meters_per_degree

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


# ---- GeoTIFF


def keys(*entries: tuple[int, int, int, int]) -> tuple[int, ...]:
    return (1, 1, 0, len(entries), *itertools.chain(*entries))


def geo(**values: TagValue) -> Tags:
    names = {
        "width": 256, "height": 257, "scale": 33550, "tie": 33922, "matrix": 34264, "keys": 34735,
        "doubles": 34736, "nodata": 42113,
    }  # fmt: skip
    return {names[name]: value for name, value in values.items()}


DEGREES = keys((1024, 0, 1, 2))


def pixel(tags: Tags) -> tuple[float, float] | None:
    found = raster_info(Path("a.tif"), {tiff.WIDTH: (4,), tiff.HEIGHT: (4,)} | tags).georeference
    return None if found is None else found.pixel


def degree(latitude: float, a: float, inverse: float) -> tuple[float, float]:
    """Return meters in a degree east and north, by differences of points on the ellipsoid."""
    b = a * (1 - 1 / inverse) if inverse else a

    def at(angle: float) -> np.ndarray:
        beta = math.atan2(b * math.sin(angle), a * math.cos(angle))  # parametric latitude
        return np.array((a * math.cos(beta), b * math.sin(beta)))

    phi, small = math.radians(latitude), 1e-6
    north = float(np.linalg.norm(at(phi + small) - at(phi - small))) / (2 * small)
    return math.radians(float(at(phi)[0])), math.radians(north)


@given(
    st.floats(-85, 85),
    st.sampled_from(((6378137.0, 298.257223563), (6377397.155, 299.1528128), (6371000.0, 0.0))),
)
def test_meters_in_a_degree_on_any_ellipsoid(latitude: float, ellipsoid: tuple[float, float]) -> None:
    a, inverse = ellipsoid
    found = meters_per_degree(latitude, ellipsoid)
    assert found == pytest.approx(degree(latitude, a, inverse), rel=1e-6)
    if a == 6378137.0:
        assert meters_per_degree(latitude) == found


def test_meters_in_a_degree_as_published() -> None:
    """WGS 84 (NGA's calculator): 111,319.5 and 110,574.3 m at the equator, 78,846.8 and 111,131.7 at 45."""
    assert meters_per_degree(0.0) == pytest.approx((111319.49, 110574.28), abs=0.05)
    assert meters_per_degree(45.0) == pytest.approx((78846.81, 111131.75), abs=0.05)
    assert 0 < meters_per_degree(89.999999)[0] < 0.01
    assert meters_per_degree(-45.0) == meters_per_degree(45.0)
    for latitude in (90.0, 91.0, -120.0):
        with pytest.raises(ConfigError, match="degrees have no width there"):
            CoordinateSystem.of_code(4326).ground_meters(7.0, latitude)


@pytest.mark.parametrize("tie_row", [0.0, 0.5, 30.0])
def test_the_latitude_is_that_of_the_center_by_a_tie_point(tie_row: float) -> None:
    """A raster of 40 rows by 10 columns whose tie point need not be its corner."""
    sx, sy, latitude = 0.02, 0.05, -47.0
    tags = geo(
        width=(10,),
        height=(40,),
        scale=(sx, sy, 0.0),
        tie=(3.0, tie_row, 0.0, 8.0, latitude, 0.0),
        keys=DEGREES,
    )
    east, north = degree(latitude - (20 - tie_row) * sy, 6378137.0, 298.257223563)
    assert pixel(tags) == pytest.approx((sx * east, sy * north), rel=1e-6)


def test_the_latitude_is_that_of_the_center_by_a_matrix() -> None:
    """A turned raster: the steps along a column and a row have lengths of their own."""
    m = (0.003, 0.004, 0.0, 7.0, 0.001, -0.02, 0.0, 61.5, *[0.0] * 7, 1.0)
    tags = geo(width=(10,), height=(40,), matrix=m, keys=DEGREES)
    east, north = degree(61.5 + 0.001 * 5 - 0.02 * 20, 6378137.0, 298.257223563)
    across = math.hypot(0.003 * east, 0.001 * north), math.hypot(0.004 * east, 0.02 * north)
    assert pixel(tags) == pytest.approx(across, rel=1e-6)
    sx, sy = math.hypot(0.003, 0.001), math.hypot(0.004, 0.02)
    assert pixel(geo(matrix=m)) == pytest.approx((sx, sy))
    with pytest.warns(UserWarning, match="its coordinates are taken for degrees"):
        assert pixel(geo(matrix=(*m[:5], -0.01, *m[6:])))[0] > 100
    assert pixel(geo(matrix=m, scale=(2.0, 3.0, 0.0))) == (2.0, 3.0)
    assert pixel(geo(matrix=m, scale=(2.0, 3.0, 0.0))) == (2.0, 3.0)


def test_degrees_without_a_place() -> None:
    for tie in ((), (0.0, 0.0, 0.0, 8.0, 47.0)):
        with pytest.raises(SourceError, match=r"a\.tif: GeoTIFF: .* no tie point: its latitude is unknown"):
            pixel(geo(width=(4,), height=(4,), scale=(1.0, 1.0), tie=tie, keys=DEGREES))


def test_a_file_without_scale_has_none() -> None:
    assert pixel(geo(width=(4,), height=(4,), keys=DEGREES)) is None


@pytest.mark.parametrize("scale", [(0.0, 1.0), (1.0, 0.0), (-1.0, 1.0), (1.0, math.inf), (math.nan, 1.0)])
def test_a_scale_that_is_none(scale: tuple[float, float]) -> None:
    with pytest.raises(SourceError, match=r"a\.tif: GeoTIFF: pixel scale must be above 0"):
        pixel(geo(scale=scale))


@pytest.mark.parametrize(("code", "meters"), [(9001, 1.0), (9002, 0.3048), (9003, 0.3048006096), (9999, 1.0)])
def test_units_of_length(code: int, meters: float) -> None:
    tags = geo(scale=(2.0, 5.0, 0.0), keys=keys((1024, 0, 1, 1), (3076, 0, 1, code)))
    assert pixel(tags) == pytest.approx((2 * meters, 5 * meters), rel=1e-9)
    assert raster_info(Path("a.tif"), {tiff.WIDTH: (4,), tiff.HEIGHT: (4,)} | tags).unit == 1.0
    assert height_unit(Path(), "", geo(keys=keys((4099, 0, 1, code)))) == pytest.approx(meters, rel=1e-9)
    assert height_unit(Path(), "", {}) == height_unit(Path(), "") == 1.0


def test_keys_hold_a_number_or_the_place_of_one() -> None:
    found = tiff.geo_keys(
        geo(
            keys=keys((1024, 0, 1, 2), (2057, 34736, 1, 1), (2059, 34736, 1, 2), (2060, 34736, 1, 3),
                      (1026, 34737, 22, 0), (4099, 0, 1, 9002)),
            doubles=(7.0, 6377000.5, 299.5),
        )
    )  # fmt: skip
    assert found == {1024: 2, 2057: 6377000.5, 2059: 299.5, 4099: 9002}
    assert tiff.geo_keys(geo(keys=(*keys((1024, 0, 1, 2)), 3076, 0, 1))) == {1024: 2}
    assert tiff.geo_keys(geo(keys=b"a text")) == tiff.geo_keys({}) == {}


@pytest.mark.parametrize(
    ("value", "expected"),
    [(b"-9999", -9999.0), (b" 1e30 ", 1e30), (b"none", None), (b"", None), ((5.0,), None)],
)
def test_nodata_is_a_text(value: TagValue, expected: float | None) -> None:
    assert tiff.nodata(geo(nodata=value)) == expected
    assert tiff.nodata({}) is None
    assert math.isnan(tiff.nodata(geo(nodata=b"nan")) or 0.0)
