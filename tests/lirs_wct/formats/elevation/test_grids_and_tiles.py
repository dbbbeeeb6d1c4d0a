"""ASCII grids, HGT files and encoded tiles, against numbers by hand and, where it is there, rasterio."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
from pyproj import CRS

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats import limited
from lirs_wct.formats.elevation import decode, read_raster, tile_georeference
from lirs_wct.geometry import geodesy
from lirs_wct.geometry.geodesy import Georeference
from lirs_wct.sources.build import build_world
from lirs_wct.sources.source import BuildOptions
from tests.kit import read_heights, refused

HEADER = "ncols 4\nNROWS 3\nxllcorner 500000\nyllcorner 4000000\ncellsize 10\nNODATA_value -1\n"
HEIGHTS = "1 2 3 4\n5 6 -1 8\n9 10 11 12.5\n"
SRTM_ROWS = 1201


def grid(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "a.asc"
    path.write_text(text)
    return path


def georeference(path: Path) -> Georeference:
    found = read_raster(path).info.georeference
    assert found is not None
    return found


def test_an_ascii_grid(tmp_path: Path) -> None:
    path = grid(tmp_path, HEADER + HEIGHTS)
    raster = read_raster(path)
    np.testing.assert_array_equal(raster.pixels, [[1, 2, 3, 4], [5, 6, -1, 8], [9, 10, 11, 12.5]])
    assert raster.info.nodata == -1
    assert georeference(path).affine == (10, 0, 500005, 0, -10, 4000025)
    with pytest.warns(UserWarning, match="1 of 12 pixels have no height"):
        surface = read_heights(path)
    assert surface.cell == (10, 10)
    np.testing.assert_array_equal(surface.z[[0, 2]], [[0, 1, 2, 3], [8, 9, 10, 11.5]])


@pytest.mark.parametrize(
    ("header", "affine"),
    [
        ("xllcenter 7\nyllcenter 8\ncellsize 2\n", (2, 0, 7, 0, -2, 12)),
        ("yllcorner 8\nxllcorner 7\ndx 2\ndy 4\n", (2, 0, 8, 0, -4, 18)),
    ],
)
def test_corners_centers_and_two_spacings(header: str, affine: tuple[float, ...], tmp_path: Path) -> None:
    assert georeference(grid(tmp_path, f"nrows 3\nncols 4\n{header}{HEIGHTS}")).affine == affine


def test_a_grid_lies_where_its_projection_file_says(tmp_path: Path) -> None:
    path = grid(tmp_path, HEADER + HEIGHTS)
    (tmp_path / "a.prj").write_text(CRS.from_epsg(32618).to_wkt("WKT1_ESRI"))
    assert georeference(path).system.name == "EPSG:32618"
    assert georeference(path).pixel == pytest.approx(
        (10 / 0.9996, 10 / 0.9996), rel=2e-7
    )  # on the central meridian
    path = grid(
        tmp_path, HEADER.replace("500000", "-74").replace("4000000", "40").replace("10", "0.001") + HEIGHTS
    )
    (tmp_path / "a.prj").write_text(CRS.from_epsg(4326).to_wkt("WKT1_ESRI"))
    assert georeference(path).pixel == pytest.approx((85.39, 111.03), rel=1e-4)
    (tmp_path / "a.prj").unlink()
    with pytest.warns(
        UserWarning, match=r"a\.asc: names no coordinate system, its coordinates are taken for deg"
    ):
        assert georeference(path).pixel == pytest.approx((85.39, 111.03), rel=1e-4)


def test_files_that_need_an_extra_name_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is guessed without PROJ and GDAL; grids and pictures without a system need neither."""
    for module in (geodesy, limited):
        monkeypatch.setattr(module, "find_spec", lambda name: None)
    path, tif, tile = grid(tmp_path, HEADER + HEIGHTS), tmp_path / "g.tif", tmp_path / "14/4825/6156.png"
    assert read_raster(path).pixels.shape == (3, 4)
    tif.write_bytes(b"II*\0")
    with pytest.raises(SourceError, match=r"g\.tif: .*lirs-wct\[dem\]"):
        read_raster(tif)
    with pytest.raises(SourceError, match=r"6156\.png: .*lirs-wct\[dem\]"):
        tile_georeference(tile, (4, 4))
    path.with_suffix(".prj").write_text(CRS.from_epsg(32633).to_wkt())
    with pytest.raises(SourceError, match=r"a\.prj: .*lirs-wct\[dem\]"):
        read_raster(path)


def test_grids_as_rasterio_reads_them(tmp_path: Path) -> None:
    path = grid(tmp_path, HEADER + HEIGHTS)
    with rasterio.open(path) as file:
        a, b, c, d, e, f = tuple(file.transform)[:6]
        np.testing.assert_array_equal(file.read(1), read_raster(path).pixels)
        assert file.nodata == read_raster(path).info.nodata
    assert georeference(path).affine == (a, b, c + a / 2, d, e, f + e / 2)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is empty"),
        (HEADER, "holds 0 heights, 4 x 3 are announced"),
        (HEADER + HEIGHTS + "7", "holds 13 heights, 4 x 3 are announced"),
        (HEADER.replace("cellsize 10", "cellsize 0") + HEIGHTS, "cells must be above 0, got 0 x 0"),
        (HEADER.replace("cellsize 10", "cellsize 1 2") + HEIGHTS, "line 'cellsize 1 2' has no single value"),
        (HEADER.replace("ncols 4", "ncols inf"), "ncols must be a whole number above 0, got inf"),
        (HEADER.replace("NROWS 3", "NROWS 2.5"), "nrows must be a whole number above 0, got 2.5"),
        (HEADER.replace("500000", "nan") + HEIGHTS, "its corner must be finite, got nan, "),
        (HEADER.replace("10", "ten") + HEIGHTS, "holds a value that is no number"),
        (HEADER + HEIGHTS.replace("9", "nine"), "holds a value that is no number"),
        (HEADER.replace("ncols 4", "ncols 99999999"), "image is 99999999x3 px"),
    ],
)
def test_grids_that_are_none(text: str, reason: str, tmp_path: Path) -> None:
    with refused(f"{tmp_path / 'a.asc'}: ", reason):
        read_raster(grid(tmp_path, text))


@pytest.fixture
def srtm(tmp_path: Path) -> Path:
    heights = np.add.outer(np.arange(SRTM_ROWS)[::-1], np.arange(SRTM_ROWS)).astype(">i2")
    heights[5, 7] = -32768
    heights.tofile(tmp_path / "S34W071.hgt")
    return tmp_path / "S34W071.hgt"


def test_hgt_lies_where_its_name_says(srtm: Path) -> None:
    raster = read_raster(srtm)
    assert raster.pixels.shape == (SRTM_ROWS, SRTM_ROWS)
    assert raster.pixels[0, 0] == SRTM_ROWS - 1
    assert raster.info.nodata == -32768
    found = georeference(srtm)
    assert found.coordinates(0, 0) == (-71, -33)
    assert found.coordinates(SRTM_ROWS - 1, SRTM_ROWS - 1) == pytest.approx((-70, -34))
    assert found.pixel == pytest.approx((111320 / 1200 * np.cos(np.radians(33.5)), 110922 / 1200), rel=2e-3)
    with rasterio.open(srtm) as file:
        np.testing.assert_array_equal(file.read(1), raster.pixels)


def test_hgt_of_another_name_or_length(srtm: Path, tmp_path: Path) -> None:
    srtm.rename(tmp_path / "andes.hgt")
    (tmp_path / "N01E001.hgt").write_bytes(bytes(100))
    for name, reason in (
        ("andes.hgt", ".*. An HGT file is named by its south-west corner"),
        ("N01E001.hgt", "is neither a picture nor elevation data"),
        ("N01E002.hgt", "cannot be read: No such file"),
    ):
        with pytest.raises(SourceError, match=rf"{name}: {reason}"):
            read_raster(tmp_path / name)


# ---- heights in colors


def encoded(meters: np.ndarray, encoding: str) -> np.ndarray:
    """Return BGR by the encodings' own words, the other way round."""
    if encoding == "terrain-rgb":
        levels = np.rint((meters + 10000) * 10).astype(np.int64)
    else:
        levels = np.rint((meters + 32768) * 256).astype(np.int64)
    return np.stack([levels >> shift & 255 for shift in (0, 8, 16)], axis=-1).astype(np.uint8)


METERS = 800 + 400 * cv2.GaussianBlur(np.random.default_rng(3).random((64, 64)), (0, 0), 5)


@pytest.mark.parametrize(("encoding", "step"), [("terrain-rgb", 0.1), ("terrarium", 1 / 256)])
def test_tiles_are_decoded(encoding: Any, step: float, tmp_path: Path) -> None:
    pixels = encoded(METERS, encoding)
    np.testing.assert_allclose(decode(pixels, encoding), METERS, atol=step / 2 + 1e-9)
    tile = tmp_path / "14" / "4824" / "6158.png"
    tile.parent.mkdir(parents=True)
    cv2.imwrite(str(tile), pixels)
    with pytest.raises(SourceError, match=rf"--option encoding reads .*{encoding}"):
        build_world(tile)
    world = build_world(tile, BuildOptions(encoding=encoding))
    np.testing.assert_allclose(world.surface.z, METERS - METERS.min(), atol=step)
    assert world.place.height == pytest.approx(METERS.min(), abs=step)
    # OSM's slippy map: the tile's corner, and half a pixel.
    west, north = world.surface.bounds[0], world.surface.bounds[3]
    latitude, longitude = world.to_geographic(west, north)
    assert longitude == pytest.approx(4824 / 2**14 * 360 - 180 + 180 / 2**14 / 64, abs=1e-9)
    row = (6158 + 0.5 / 64) / 2**14
    assert latitude == pytest.approx(np.degrees(np.arctan(np.sinh(np.pi * (1 - 2 * row)))), abs=1e-9)
    assert world.surface.cell[0] == pytest.approx(
        40075016.7 / 2**14 / 64 * np.cos(np.radians(40.706)), rel=3e-3
    )


def test_a_tile_of_another_name_needs_an_extent(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), encoded(METERS, "terrarium"))
    with pytest.raises(ConfigError, match=r"a\.png: its heights are in meters.*--resolution or --size"):
        build_world(tmp_path / "a.png", BuildOptions(encoding="terrarium"))
    world = build_world(tmp_path / "a.png", BuildOptions(encoding="terrarium", resolution=3.0))
    assert world.surface.cell == (3, 3)
    assert world.place is None
    cv2.imwrite(str(tmp_path / "gray.png"), np.zeros((4, 4), np.uint8))
    with pytest.raises(SourceError, match=r"gray\.png: terrarium is 8-bit color, this is uint8 gray"):
        build_world(tmp_path / "gray.png", BuildOptions(encoding="terrarium", resolution=3.0))
