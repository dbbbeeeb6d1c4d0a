"""GeoTIFFs as rasterio and PROJ read them, on files that rasterio writes."""

import math
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from lirs_wct.formats.elevation import Raster, RasterInfo, read_raster
from tests.lirs_wct.formats.elevation.gdal_rasters import CASES, read_truth, write_raster

UNITS = {None: 1.0, "ft": 0.3048, "US survey foot": 1200 / 3937}


PLAIN = (
    "feet",
    "survey_feet",
    "int32",
    "uint32",
    "float64",
    "tiled_lzw",
    "bigtiff",
    "overviews",
    "point",
    "utm_south",
)
"""Rasters that differ from the others in one small thing."""
NAMES = [pytest.param(name, marks=pytest.mark.slow) if name in PLAIN else name for name in CASES]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All cases as files."""
    folder = tmp_path_factory.mktemp("rasters")
    for name in CASES:
        write_raster(folder / f"{name}.tif")
    return folder


@cache
def read_and_told(path: Path) -> tuple[Raster, list[str]]:
    """Return a raster and the warnings about it; each is read once, in a process of its own."""
    with warnings.catch_warnings(record=True, action="always") as told:
        return read_raster(path), [str(warning.message) for warning in told]


def by_place(rows: np.ndarray, affine: Any) -> dict[tuple[float, float], float]:
    """Return heights by the coordinates of their pixels' middles."""
    a, b, c, d, e, f = affine
    return {
        (round(a * i + b * j + c, 6), round(d * i + e * j + f, 6)): float(rows[j, i])
        for j, i in np.ndindex(rows.shape)
    }


@pytest.mark.parametrize("name", NAMES)
def test_heights_lie_where_rasterio_sees_them(name: str, folder: Path) -> None:
    path = folder / f"{name}.tif"
    record, raster = read_truth(path), read_and_told(path)[0]
    info, georeference = raster.info, raster.info.georeference
    values = raster.pixels.astype(np.float64) * info.scale + info.offset
    if info.nodata is not None:
        values[raster.pixels == info.nodata] = np.nan
    a, b, c, d, e, f = record["transform"]
    middle = (a, b, c + (a + b) / 2, d, e, f + (d + e) / 2)
    expected = by_place(record["heights"], middle)
    found = by_place(values, georeference.affine)
    assert found.keys() == expected.keys()
    for place, height in expected.items():
        assert found[place] == pytest.approx(height, rel=1e-7, nan_ok=True), place
    feet = name == "state_plane_feet"  # heights without a unit have that of the plane
    assert info.unit == pytest.approx(UNITS["US survey foot" if feet else record["unit"]])
    assert info.nodata == record["nodata"]


@pytest.mark.parametrize("name", [name for name in NAMES if name != "no_system"])
def test_pixels_are_in_meters_on_the_ground(name: str, folder: Path) -> None:
    path = folder / f"{name}.tif"
    record, georeference = read_truth(path), read_and_told(path)[0].info.georeference
    assert georeference.system.name == f"EPSG:{record['epsg']}"
    assert sorted(georeference.pixel) == pytest.approx(sorted(record["pixel"]), rel=2e-6)
    (ce, cn), (re, rn) = georeference.steps
    assert ce > abs(cn)
    assert -rn > abs(re)
    a, b, c, d, e, f = record["transform"]
    rows, cols = np.shape(record["heights"])
    ends = [(i + 0.5, j + 0.5) for i in (0, cols - 1) for j in (0, rows - 1)]
    x, y = (np.array([k * i + m * j + n for i, j in ends]) for k, m, n in ((a, b, c), (d, e, f)))
    found = np.stack(georeference.system.to_geographic(x, y), axis=1)
    np.testing.assert_allclose(found, record["corners"], rtol=0, atol=5e-9)  # half a millimeter


def test_ten_meters_of_web_mercator_at_40_7_north_are_seven_and_a_half(folder: Path) -> None:
    georeference = read_and_told(folder / "mercator.tif")[0].info.georeference
    assert georeference.pixel == pytest.approx((10 * math.cos(math.radians(40.71)),) * 2, rel=3e-3)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (
            "state_plane_feet",
            "its heights have no unit: they are taken for the same; if they are meters, give --z-scale 3.28",
        ),
        ("mask", None),
        ("turned", r"is turned by -30 deg; x of the world goes along its rows, -30.65 deg north of east"),
        ("mercator", None),
        ("south_up", None),
        ("west_up", None),
        ("no_system", None),
    ],
)
def test_what_is_left_out_is_told(name: str, words: str | None, folder: Path) -> None:
    told = read_and_told(folder / f"{name}.tif")[1]
    assert len(told) == (words is not None)
    if words is not None:
        assert told[0].startswith(str(folder / f"{name}.tif"))
        assert words in told[0]


@pytest.mark.parametrize("suffix", [pytest.param("img", marks=pytest.mark.slow), "bil"])
def test_other_rasters_are_read_by_gdal(suffix: str, folder: Path, tmp_path: Path) -> None:
    from rasterio.shutil import copy

    path = tmp_path / f"a.{suffix}"
    copy(folder / "utm.tif", path, driver={"img": "HFA", "bil": "EHdr"}[suffix])
    with rasterio.open(path) as file:
        assert file.driver != "GTiff"
    found, known = read_raster(path), read_and_told(folder / "utm.tif")[0]
    np.testing.assert_array_equal(found.pixels, known.pixels)
    assert found.info.georeference.pixel == pytest.approx(known.info.georeference.pixel)


def georeferenced(path: Path, crs: str) -> RasterInfo:
    place = rasterio.transform.from_origin(10, 60, 0.01, 0.02)
    shape = {"width": 8, "height": 6, "count": 1, "dtype": "float32"}
    with rasterio.open(path, "w", driver="GTiff", crs=crs, transform=place, **shape) as file:
        file.write(np.ones((6, 8), np.float32), 1)
    return read_raster(path).info


@pytest.mark.parametrize(("vertical", "meters"), [(5703, 1.0), (6360, 1200 / 3937), (8228, 0.3048)])
def test_heights_have_the_unit_of_their_vertical_system(vertical: int, meters: float, tmp_path: Path) -> None:
    info = georeferenced(tmp_path / "a.tif", f"EPSG:4269+{vertical}")
    assert info.unit == meters
    assert info.georeference.system.name == "EPSG:4269"


def test_degrees_of_another_body_have_its_radius(tmp_path: Path) -> None:
    """The moon's center pixel: 60 deg - 3 x .02 deg north."""
    georeference = georeferenced(tmp_path / "moon.tif", "+proj=longlat +R=1737400 +no_defs").georeference
    degree = math.radians(1_737_400.0)
    expected = 0.01 * degree * math.cos(math.radians(59.94)), 0.02 * degree
    assert georeference.pixel == pytest.approx(expected, rel=1e-6)
