"""Rasters as people have them: world files, other suffixes, no system, feet, codes for "no height"."""

import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from PIL import Image
from rasterio.control import GroundControlPoint
from rasterio.transform import from_origin

from lirs_wct.errors import SourceError
from lirs_wct.formats.elevation import missing_heights
from lirs_wct.sources.build import build_world
from tests.kit import built

HILLS = np.add.outer(20 * np.hanning(81)[:80], np.zeros(100)).astype(np.float32)
"""Heights from 0 to 20 m, (80, 100)."""
UTM: dict[str, Any] = {"crs": "EPSG:32632", "transform": from_origin(500_000, 5_300_000, 1, 1)}


def raster(path: Path, z: np.ndarray, driver: str = "GTiff", **profile: Any) -> Path:
    bands = z if z.ndim == 3 else z[None]
    shape = {"count": len(bands), "height": z.shape[-2], "width": z.shape[-1], "dtype": z.dtype}
    ignored = warnings.catch_warnings(action="ignore")
    with ignored, rasterio.open(path, "w", driver=driver, **shape, **profile) as file:
        file.write(bands)
    return path


@pytest.mark.parametrize(
    ("name", "beside"),
    [("a.tif", "a.tfw"), ("a.png", "a.pgw"), ("a.jpg", "a.jgw"), ("a.bmp", "a.bpw"), ("a.pgm", "a.pmw")],
)
def test_a_world_file_gives_meters_and_place(name: str, beside: str, tmp_path: Path) -> None:
    path = tmp_path / name
    Image.fromarray(np.rint(HILLS).astype(np.uint8)).save(path)
    (tmp_path / beside).write_text("2,0\n0\n0\n-2\n500000\n5300000\n")
    world, told = built(path)
    assert told == []
    assert world.surface.size == pytest.approx((198, 158))
    assert world.surface.relief == pytest.approx(20, abs=1.0)  # of JPEG
    assert world.place.coordinates(0.0, 0.0) == pytest.approx((500_099, 5_299_921))


@pytest.mark.parametrize("name", ["a.tif", "a.png", "a.pgm"])
@pytest.mark.parametrize("text", ["2\n0\n0\nx\n5\n5\n", "2\n0\n0\n-2\n5\n"])
def test_a_damaged_world_file_is_refused(name: str, text: str, tmp_path: Path) -> None:
    Image.fromarray(np.rint(HILLS).astype(np.uint8)).save(tmp_path / name)
    (tmp_path / "a.wld").write_text(text)
    with pytest.raises(SourceError, match=f"^{tmp_path}/a.wld: is damaged: a world file holds six numbers$"):
        build_world(tmp_path / name)


def test_a_pgm_with_statistics_beside_it_has_no_extent(tmp_path: Path) -> None:
    Image.fromarray(np.rint(HILLS).astype(np.uint8)).save(tmp_path / "a.pgm")
    (tmp_path / "a.pgm.aux.xml").write_text("<PAMDataset></PAMDataset>")
    assert built(tmp_path / "a.pgm")[0].surface.size == pytest.approx((50, 50 * 79 / 99))


@pytest.mark.parametrize("kind", ["uint8", "int16", "float32"])
def test_alpha_hides_heights(kind: str, tmp_path: Path) -> None:
    bands = np.stack([HILLS, np.full_like(HILLS, 255)]).astype(kind)
    bands[:, :4] = [[[200]], [[0]]]
    path = raster(tmp_path / "a.tif", bands, photometric="MINISBLACK", alpha="YES", **UTM)
    world, told = built(path)
    assert told == [
        f"{path}: 400 of 8000 pixels have no height (NaN or nodata), filled from their nearest neighbors"
    ]
    assert world.surface.relief == pytest.approx(20, abs=0.5)


@pytest.mark.parametrize("kind", [np.complex64, np.complex128])
def test_complex_numbers_are_refused(kind: type, tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"radar\.tif: holds complex numbers"):
        built(raster(tmp_path / "radar.tif", np.ones((9, 9), kind), **UTM))


def test_control_points_are_no_grid(tmp_path: Path) -> None:
    points = [GroundControlPoint(r, c, 500_000 + c, 5_300_000 - r) for r, c in ((0, 0), (80, 0), (0, 100))]
    with pytest.raises(SourceError, match=r"a\.tif: is placed by ground control points: gdalwarp gives"):
        build_world(raster(tmp_path / "a.tif", HILLS, gcps=points, crs="EPSG:32632"))


def test_a_sidecar_of_gdal_gives_meters_and_place(tmp_path: Path) -> None:
    path = raster(tmp_path / "a.png", np.rint(HILLS).astype(np.uint8), driver="PNG", **UTM)
    assert (tmp_path / "a.png.aux.xml").exists()
    world, told = built(path)
    assert told == []
    assert world.surface.size == pytest.approx((99, 79), rel=1e-3)
    assert world.surface.relief == pytest.approx(20)


@pytest.mark.parametrize("suffix", ["dem", "png", "asc", "img", "dat"])
def test_the_content_decides_and_not_the_suffix(suffix: str, tmp_path: Path) -> None:
    origin = raster(tmp_path / "a.tif", HILLS, **UTM)
    shutil.copy(origin, path := tmp_path / f"b.{suffix}")
    np.testing.assert_array_equal(built(path)[0].surface.z, built(origin)[0].surface.z)


@pytest.mark.parametrize("kind", ["float32", "float64"])
@pytest.mark.parametrize("code", [-32767, 9999, -99999, -999, -10000, 65535, 32767, -9999.9, 1e20, -1e10])
@pytest.mark.parametrize("place", [np.s_[30:40, 30:40], np.s_[:1, :], np.s_[5, 5]])
def test_an_isolated_code_is_no_height(code: float, place: Any, kind: str) -> None:
    z = (HILLS + 400).astype(kind)
    z[place] = code
    expected = np.zeros(z.shape, np.bool_)
    expected[place] = True
    missing, codes = missing_heights(z, None, search=True)
    np.testing.assert_array_equal(missing, expected)
    assert codes == pytest.approx([code])
    assert missing_heights(z, None, search=False)[0].sum() == 0


def test_an_isolated_code_is_told(tmp_path: Path) -> None:
    z = HILLS + 400
    z[30:40, 30:40] = 9999
    world, told = built(raster(tmp_path / "a.tif", z, **UTM))
    assert world.surface.relief == pytest.approx(20, abs=0.1)
    assert len(told) == 1
    assert "100 of 8000 pixels have no height (NaN or nodata), 9999 among them: an isolated" in told[0]
    assert "the others are 400 to 4" in told[0]


def test_two_codes_at_once_and_a_code_that_is_given(tmp_path: Path) -> None:
    z = HILLS + 400
    z[:2], z[40] = -32767, 9999
    path = raster(tmp_path / "a.tif", z, **UTM)
    world, told = built(path)
    assert world.surface.relief == pytest.approx(20, abs=0.1)
    assert "-32767 and 9999 among them" in told[0]
    assert built(path, nodata=9999.0)[0].surface.relief == pytest.approx(33_187, abs=1)


@pytest.mark.parametrize(
    "z",
    [
        np.linspace(-2000, 999, 8000, dtype=np.float32).reshape(80, 100),
        np.where(HILLS > 10, 10, 0).astype(np.float32),
        (HILLS * 100 + 7000).astype(np.float32),
    ],
    ids=["a slope up to 999 m", "two levels", "mountains"],
)
def test_heights_are_no_codes(z: np.ndarray, tmp_path: Path) -> None:
    world, told = built(raster(tmp_path / "a.tif", z, **UTM))
    assert world.surface.relief == pytest.approx(float(np.ptp(z)))
    assert not any("no height (NaN" in line for line in told)


def test_the_window_is_cut_before_holes_are_counted(tmp_path: Path) -> None:
    z = HILLS.copy()
    z[:, 48:], z[:, :10] = -9999, -9999
    path = raster(tmp_path / "a.tif", z, nodata=-9999, **UTM)
    with pytest.raises(SourceError, match=r"4960 of 8000 pixels have no height .*--window"):
        built(path)
    world, told = built(path, window=(-20.0, 0.0, 20.0))
    assert world.surface.size == pytest.approx((20, 20), abs=1.1)
    assert world.surface.relief == pytest.approx(float(np.ptp(z[29:51, 20:40])), rel=0.05)
    assert len(told) == 1


@pytest.mark.parametrize(
    ("step", "corner", "relief", "width"),
    [
        (1 / 3600, (7.0, 47.0), 500.0, 2090.0),
        (1 / 10800, (7.0, 47.0), 500.0, 697.0),
        (0.000833, (5.0, 45.0), 300.0, 6480.0),
        (1 / 30, (5.0, 48.0), 20.0, 252_000.0),
        (0.25, (5.0, 48.0), 3000.0, 2_172_000.0),
        (0.01, (12.34, 45.6), 0.2, 0.99),
        (0.013, (12.34, 45.6), 0.9, 1.287),
        (0.05, (3.0, 4.0), 1.0, 4.95),
        (0.5, (30.0, 40.0), 10.0, 49.5),
        (1.0, (0.0, 0.0), 900.0, 99.0),
        (1.0, (500_000.0, 5_000_000.0), 900.0, 99.0),
    ],
)
def test_degrees_or_meters_without_a_system(
    step: float, corner: tuple[float, float], relief: float, width: float, tmp_path: Path
) -> None:
    z = HILLS * np.float32(relief / 20)
    world, told = built(raster(tmp_path / "a.tif", z, transform=from_origin(*corner, step, step)))
    assert world.surface.size[0] == pytest.approx(width, rel=0.02)
    assert world.surface.relief == pytest.approx(relief, rel=1e-3)
    degrees = width != pytest.approx(99 * step)
    assert any("taken for degrees" in line for line in told) == degrees


def test_where_both_are_likely_the_pixel_is_asked_for(tmp_path: Path) -> None:
    path = raster(tmp_path / "a.tif", HILLS / 10, transform=from_origin(7.0, 47.0, 0.01, 0.01))
    with pytest.raises(SourceError, match=r"may be degrees or meters: give --resolution METERS"):
        built(path)
    world, _ = built(path, resolution=0.01)
    assert world.surface.size == pytest.approx((0.99, 0.79))
    assert world.surface.relief == pytest.approx(2.0, rel=1e-3)


def test_feet_have_one_rule(tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    from pyproj import CRS

    place = {"crs": "EPSG:2263", "transform": from_origin(980_000, 200_000, 3, 3)}
    path = raster(tmp_path / "a.tif", HILLS, **place)
    cloud = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    row, col = np.indices(HILLS.shape)
    cloud.x, cloud.y, cloud.z = 980_000 + 3 * col.ravel(), 200_000 - 3 * row.ravel(), HILLS.ravel()
    cloud.header.add_crs(CRS.from_epsg(2263))
    cloud.classification = np.full(HILLS.size, 2)
    cloud.write(tmp_path / "a.las")
    for each in (path, tmp_path / "a.las"):
        world, told = built(each)
        assert world.surface.relief == pytest.approx(20 * 1200 / 3937, rel=0.02)
        assert world.surface.size == pytest.approx((297 * 1200 / 3937, 237 * 1200 / 3937), rel=0.03)
        assert sum("its heights have no unit" in line for line in told) == 1
        assert built(each, z_scale=3937 / 1200)[0].surface.relief == pytest.approx(20, rel=0.02)


def test_keywords_of_arcinfo_name_a_system(tmp_path: Path) -> None:
    rows = "\n".join(" ".join(f"{value:.1f}" for value in row) for row in HILLS)
    header = "ncols 100\nnrows 80\nxllcorner 5\nyllcorner 45\ncellsize 0.000833333\n"
    (tmp_path / "a.asc").write_text(header + rows)
    (tmp_path / "a.prj").write_text(
        "Projection    GEOGRAPHIC\nDatum         WGS84\nUnits         DD\nParameters\n"
    )
    world, told = built(tmp_path / "a.asc")
    assert told == []
    assert world.surface.size == pytest.approx((6501, 7316), rel=1e-3)
    assert world.place.system.name == "EPSG:4326"


def test_bands_and_transparency_that_are_left_out_are_named(tmp_path: Path) -> None:
    two = np.stack((HILLS, HILLS * 2))
    assert "has 2 bands, the first is taken" in built(raster(tmp_path / "a.tif", two, **UTM))[1][0]
    gray = np.rint(HILLS).astype(np.uint8)
    Image.merge("LA", [Image.fromarray(gray), Image.fromarray(255 - gray)]).save(tmp_path / "a.png")
    world, told = built(tmp_path / "a.png")
    assert world.surface.relief == 6
    assert f"{int((gray > 0).sum())} of 8000 pixels are transparent; the alpha channel is left out" in told[0]


@pytest.mark.parametrize(("kind", "code"), [("int16", -32767), ("uint16", 65535), ("int32", -99999)])
def test_codes_of_whole_numbers(kind: str, code: int, tmp_path: Path) -> None:
    z = (np.rint(HILLS) + 400).astype(kind)
    z[:, 90:] = code
    world, told = built(raster(tmp_path / "a.tif", z, **UTM))
    assert world.surface.relief == 20
    assert f"800 of 8000 pixels have no height (NaN or nodata), {code} among them" in told[0]


def test_points_as_text(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    rows, cols = np.indices((9, 12))
    text = [f"{10 + x},{20 + y},{x + y}" for y, x in zip(rows.ravel(), cols.ravel(), strict=True)]
    path.write_text("\n".join(["x,y,z", *text]))
    assert built(path)[0].surface.size == pytest.approx((11, 8))
    path.write_text(
        "".join(f"{x:.3f} {y:.3f} 1\n" for x, y in np.random.default_rng(1).uniform(0, 9, (50, 2)))
    )
    with pytest.raises(SourceError, match=r"a\.xyz: .*Scattered points are read from \.las"):
        built(path)
