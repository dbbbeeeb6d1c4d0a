"""Odd inputs: each works, or is refused in one line."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.sources.build import build_world
from lirs_wct.sources.options import BuildOptions

HEADER = "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n"


def write_tiff(path: Path, pixels: np.ndarray) -> Path:
    rows, cols = pixels.shape
    shape = {"width": cols, "height": rows, "count": 1, "dtype": pixels.dtype}
    place = {"crs": 32633, "transform": rasterio.transform.from_origin(500_000, 5_000_000, 1, 1)}
    with rasterio.open(path, "w", driver="GTiff", **shape, **place) as file:
        file.write(pixels, 1)
    return path


@pytest.mark.parametrize("nodata", [3.4e38, -3.4e38])
def test_an_unmarked_huge_pixel_is_filled(nodata: float, tmp_path: Path) -> None:
    z = np.add.outer(np.arange(9), np.arange(9)).astype(np.float32)
    z[4, 4] = nodata
    with pytest.warns(UserWarning, match="1 of 81 pixels have no height"):
        world = build_world(write_tiff(tmp_path / "hole.tif", z))
    assert world.surface.relief == 16


@pytest.mark.parametrize("kind", [np.complex64, np.complex128])
def test_complex_numbers_are_refused(kind: type, tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"radar\.tif: holds complex numbers"):
        build_world(write_tiff(tmp_path / "radar.tif", np.ones((9, 9), kind)))


def test_a_byte_order_mark_is_no_part_of_the_header(tmp_path: Path) -> None:
    path = tmp_path / "mark.asc"
    path.write_text(HEADER + "1 2 3\n4 5 6\n", encoding="utf-8-sig")
    assert build_world(path).surface.relief == 5


def test_a_map_of_endless_cells_is_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "map.pgm"), np.full((9, 9), 254, np.uint8))
    path = tmp_path / "map.yaml"
    path.write_text("image: map.pgm\nresolution: 1e300\norigin: [0, 0, 0]\n")
    with pytest.raises(SourceError, match=r"map\.yaml: resolution must be .* at most 1000 m, got 1e\+300"):
        build_world(path)


def test_a_name_too_long_for_files_is_refused() -> None:
    with pytest.raises(ConfigError, match="--name: a world's name has at most 200 characters, got 300"):
        build_world("simple", BuildOptions(name="a" * 300))
