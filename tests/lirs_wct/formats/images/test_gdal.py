"""Rasters through GDAL: values, units, mask and place of a small file of each kind."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from lirs_wct.formats.images.gdal import read_gdal

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
