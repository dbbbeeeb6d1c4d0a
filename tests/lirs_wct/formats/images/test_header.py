"""Headers of pictures, byte by byte, and by Pillow as a second writer."""

import io
import struct
import zlib
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import rasterio
from PIL import Image
from rasterio.transform import from_origin

from lirs_wct.formats.images import tiff
from lirs_wct.formats.images.gdal import read_gdal
from lirs_wct.formats.images.header import PictureHeader, check_complete, read_header


def header(data: bytes) -> PictureHeader:
    return read_header(cast(Any, data))


def check(data: bytes) -> None:
    check_complete(cast(Any, data))


def chunk(kind: bytes, body: bytes = b"") -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


PNG = b"\x89PNG\r\n\x1a\n"
IHDR = chunk(b"IHDR", struct.pack(">IIBBBBB", 258, 771, 8, 0, 0, 0, 0))


@pytest.mark.parametrize("form", ["PNG", "GIF", "JPEG", "TIFF", "BMP", "PPM", "WEBP"])
@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_sizes_that_pillow_writes(form: str, mode: str) -> None:
    file = io.BytesIO()
    Image.new(mode, (301, 517)).save(file, form)
    found = header(file.getvalue())
    assert (found.width, found.height, found.pages) == (301, 517, 1)
    assert bool(found.tags) == (form == "TIFF")
    check(file.getvalue())


def test_what_is_no_picture() -> None:
    for data in (b"GIF88a\1\0\1\0\0", b"P7\n1 1", b"II*\1", b"\x89PNG\r\n\x1a\r", b"\xff\xd8\xfe", b""):
        with pytest.raises(ValueError, match="is not a picture; legal: PNG"):
            header(data)


def test_png_size_and_first_chunk() -> None:
    assert header(PNG + IHDR) == PictureHeader(258, 771)
    with pytest.raises(ValueError, match="does not begin with IHDR"):
        header(PNG + chunk(b"IDAT", bytes(13)))


def test_png_is_whole_up_to_its_end_chunk() -> None:
    body, end = chunk(b"IDAT", b"pixels"), chunk(b"IEND")
    check(PNG + IHDR + body + end)
    check(PNG + IHDR + body + end + b"what follows does not matter")
    for cut in (1, 4, 5, 11, 12, 13, 20):
        with pytest.raises(ValueError, match="is truncated: the PNG's end is missing"):
            check((PNG + IHDR + body + end)[:-cut])
    for at in (len(PNG) + 9, len(PNG + IHDR) + 8, len(PNG + IHDR) + 4, len(PNG + IHDR + body) - 1):
        damaged = bytearray(PNG + IHDR + body + end)
        damaged[at] ^= 4
        with pytest.raises(ValueError, match="is damaged: checksum of PNG chunk "):
            check(bytes(damaged))


def gif_colors(flags: int) -> bytes:
    """A table of colors that look like the beginning of an image and of the end."""
    return b",\xfa;" * (1 << (flags % 8 + 1)) if flags & 0x80 else b""


def gif(*blocks: bytes, flags: int = 0, size: tuple[int, int] = (7, 300)) -> bytes:
    table = gif_colors(flags)
    return b"GIF89a" + struct.pack("<HHBBB", *size, flags, 0, 0) + table + b"".join(blocks) + b";"


def gif_image(w: int, h: int, flags: int = 0) -> bytes:
    """An image at (9, 9); its data hold separators that are none."""
    table = gif_colors(flags)
    return b"," + struct.pack("<HHHHB", 9, 9, w, h, flags) + table + b"\x02" + b"\x03,,," + b"\x02;;" + b"\0"


COMMENT = b"!\xfe" + b"\x05,;,;," + b"\x01," + b"\0"


@pytest.mark.parametrize(
    ("data", "size", "pages"),
    [
        (gif(gif_image(5, 6)), (7, 300), 1),
        (gif(), (7, 300), 1),
        (gif(gif_image(400, 6)), (400, 300), 1),
        (gif(gif_image(5, 600)), (7, 600), 1),
        (gif(COMMENT, gif_image(5, 6), COMMENT, gif_image(8, 2), COMMENT), (8, 300), 2),
        (gif(gif_image(5, 6, 0x80), gif_image(1, 1, 0x87), gif_image(1, 1, 0x03), flags=0x82), (7, 300), 3),
        (gif(gif_image(5, 6), flags=0x07), (7, 300), 1),
        (gif(gif_image(5, 6)) + gif_image(999, 999), (7, 300), 1),
        (gif(gif_image(5, 6)) + b"\0\0" + gif_image(999, 999), (7, 300), 1),
        (gif(gif_image(5, 6), gif_image(5, 6))[:-4], (7, 300), 2),
    ],
)
def test_gif_frames_are_counted_and_the_largest_side_is_told(
    data: bytes, size: tuple[int, int], pages: int
) -> None:
    assert header(data) == PictureHeader(*size, pages)


def segment(marker: int, body: bytes) -> bytes:
    return struct.pack(">HH", marker, len(body) + 2) + body


def frame(marker: int, width: int = 513, height: int = 258) -> bytes:
    return segment(marker, struct.pack(">BHHB", 8, height, width, 1) + bytes(3))


@pytest.mark.parametrize("marker", [0xFFC0, 0xFFC1, 0xFFC2, 0xFFC9, 0xFFCF])
def test_jpeg_size_is_that_of_its_frame(marker: int) -> None:
    others = b"".join(frame(m, 1, 2) for m in (0xFFE0, 0xFFC4, 0xFFC8, 0xFFCC, 0xFFDB, 0xFFD0, 0xFFFE))
    assert header(b"\xff\xd8" + others + frame(marker) + frame(0xFFC0, 9, 9)) == PictureHeader(513, 258)


@pytest.mark.parametrize("marker", [0xFFBF, 0xFFFF, 0xFEC0, 0x1234])
def test_jpeg_without_a_frame(marker: int) -> None:
    with pytest.raises(ValueError, match="the JPEG has no frame header"):
        header(b"\xff\xd8\xff\xe0\0\2" + frame(marker) + frame(0xFFC0))
    with pytest.raises(ValueError, match="the JPEG has no frame header"):
        header(b"\xff\xd8" + segment(0xFFE0, b"nothing else"))
    with pytest.raises(struct.error):
        header(b"\xff\xd8" + segment(0xFFE0, b"nothing else") + b"\xff")


def test_jpeg_ends_with_its_marker() -> None:
    scan = b"\xff\xd8" + frame(0xFFC0) + segment(0xFFDA, b"scan")
    check(scan + b"pixels\xff\xd9")
    check(scan + b"pixels\xff\xd9" + b"and more")
    for data in (scan + b"pixels", b"\xff\xd8\xff\xe1\xff\xd9" + scan):  # a thumbnail's end is not the end
        with pytest.raises(ValueError, match="the JPEG's end marker is missing"):
            check(data)


def test_tiff_size_and_pages() -> None:
    entries = [(256, 3, 1, 300), (257, 4, 1, 70000)]
    data = b"II*\0" + struct.pack("<IH", 8, 2)
    for tag, kind, count, value in entries:
        data += struct.pack("<HHII", tag, kind, count, value)
    found = header(data + bytes(4))
    assert (found.width, found.height, found.pages) == (300, 70000, 1)
    assert found.tags == {tiff.WIDTH: (300,), tiff.HEIGHT: (70000,)}
    for missing in (tiff.WIDTH, tiff.HEIGHT):
        with pytest.raises(ValueError, match="the TIFF does not say its size"):
            header(data.replace(struct.pack("<H", missing), struct.pack("<H", 999), 1) + bytes(4))


def test_bmp_of_both_headers() -> None:
    head = b"BM" + bytes(12)
    assert header(head + struct.pack("<IHH", 12, 300, 40000)) == PictureHeader(300, 40000)
    assert header(head + struct.pack("<Iii", 40, 300, 70000)) == PictureHeader(300, 70000)
    assert header(head + struct.pack("<Iii", 108, 300, -70000)) == PictureHeader(300, 70000)


@pytest.mark.parametrize("kind", b"123456fF")
def test_pnm_size_between_comments(kind: int) -> None:
    assert header(b"P%c\n300 70 255\n" % kind) == PictureHeader(300, 70)
    assert header(b"P%c # one\n# two 5 6\n 300\t# 7\n70\n255" % kind) == PictureHeader(300, 70)
    late = b"P%c\n#" % kind + b"x" * 4080
    assert header(late + b"\n12 345 255") == PictureHeader(12, 345)
    for data in (b"P%c\n300" % kind, b"P%c 300 x" % kind, b"P%c300 70" % kind, late + bytes(99) + b"\n1 2"):
        with pytest.raises(ValueError, match="the PNM header lacks the size"):
            header(data)


def test_webp_of_each_kind_says_size_and_frames() -> None:
    pages = [Image.new("RGB", (31, 17), color) for color in ("red", "green")]
    for options, frames in (({"lossless": True}, 1), ({"exif": b"Exif"}, 1), ({"append_images": pages}, 3)):
        file = io.BytesIO()
        Image.new("RGB", (31, 17)).save(file, "WEBP", save_all="append_images" in options, **options)
        assert header(file.getvalue()) == PictureHeader(31, 17, frames)
        with pytest.raises(ValueError, match="is truncated"):
            header(file.getvalue()[:-9])
    with pytest.raises(ValueError, match="a RIFF file is read if it is a WebP"):
        header(b"RIFF\4\0\0\0WAVEfmt ")


Z = np.arange(12, dtype=np.float32).reshape(3, 4)


def write(path: Path, driver: str, **options: Any) -> None:
    """Write Z as the first of two bands."""
    shape: dict[str, Any] = {"height": 3, "width": 4, "count": 2, "dtype": "float32"}
    with rasterio.open(path, "w", driver=driver, **shape, **options) as file:
        file.write(Z, 1)
        file.write(-Z, 2)
        file.units, file.scales, file.offsets = ("ft", "m"), (2.0, 1.0), (5.0, 0.0)


@pytest.mark.parametrize(("driver", "name"), [("GTiff", "a.tif"), ("HFA", "a.img")])
def test_the_first_band_with_its_unit_and_place(driver: str, name: str, tmp_path: Path) -> None:
    write(
        tmp_path / name, driver, transform=from_origin(100.0, 50.0, 2.0, 3.0), crs="EPSG:32633", nodata=-1.0
    )
    found = read_gdal(tmp_path / name, (driver,), 100)
    assert (found.width, found.height) == (4, 3)
    assert found.pixels is not None
    np.testing.assert_array_equal(found.pixels, Z)
    assert found.nodata == -1.0
    assert found.transform == (2.0, 0.0, 100.0, 0.0, -3.0, 50.0)
    assert "UTM zone 33N" in found.wkt
    if driver == "GTiff":  # HFA keeps neither
        assert (found.unit, found.scale, found.offset) == ("ft", 2.0, 5.0)


def test_a_large_raster_is_described_without_its_pixels(tmp_path: Path) -> None:
    write(tmp_path / "a.tif", "GTiff")
    assert read_gdal(tmp_path / "a.tif", ("GTiff",), 12).pixels is not None
    found = read_gdal(tmp_path / "a.tif", ("GTiff",), 11)
    assert found.pixels is None
    assert (found.width, found.height, found.transform, found.wkt) == (4, 3, None, "")


def test_masked_pixels_are_missing(tmp_path: Path) -> None:
    mask = np.full((3, 4), 255, np.uint8)
    mask[1, 2] = 0
    with rasterio.open(
        tmp_path / "a.tif", "w", driver="GTiff", height=3, width=4, count=1, dtype="uint8"
    ) as file:
        file.write(Z.astype(np.uint8), 1)
        file.write_mask(mask)
    found = read_gdal(tmp_path / "a.tif", ("GTiff",), 100).pixels
    assert found is not None
    wanted = Z.astype(np.float64)
    wanted[1, 2] = np.nan
    np.testing.assert_array_equal(found, wanted)
