"""Worlds keep their place on the earth and their heights: world.json, SDF, `info`, neighbors, windows."""

import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from pyproj import CRS

from lirs_validation.gui.construction import preview_facts
from lirs_validation.metrics.world_geometry import ground_facts, measured_facts
from lirs_wct import World, write_package
from lirs_wct.errors import ConfigError
from lirs_wct.sources.build import build_world
from lirs_wct.sources.source import BuildOptions
from tests.lirs_wct.formats.elevation.gdal_rasters import write_raster

CELL, WEST, NORTH = 10.0, -8_238_310.0, 4_970_072.0


def heights(cols: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return 700 + 20 * np.sin(cols / 7)[None, :] + 0.5 * rows[:, None]


def tile(path: Path, first: int, *, cols: int = 33, rows: int = 25) -> Path:
    """Write an ASCII grid in web Mercator; a tile's last column is the next one's first."""
    z = heights(first + np.arange(cols), np.arange(rows))
    lines = [
        f"ncols {cols}", f"nrows {rows}", f"xllcenter {WEST + first * CELL}",
        f"yllcenter {NORTH - (rows - 1) * CELL}", f"cellsize {CELL}",
        *(" ".join(f"{value:.6f}" for value in row) for row in z),
    ]  # fmt: skip
    path.write_text("\n".join(lines) + "\n")
    path.with_suffix(".prj").write_text(CRS.from_epsg(3857).to_wkt("WKT1_ESRI"))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("tiles")
    tile(made / "a.asc", 0)
    tile(made / "b.asc", 32)
    return made


def built(path: Path, **options: Any) -> World:
    with warnings.catch_warnings(action="error"):
        return build_world(path, BuildOptions(**options))


def mercator(latitude: float, longitude: float) -> tuple[float, float]:
    """Return web Mercator's meters: Snyder 1987, eqs. 7-1 and 7-2, on a sphere."""
    a = 6378137.0
    return a * np.radians(longitude), a * np.log(np.tan(np.pi / 4 + np.radians(latitude) / 2))


def test_every_node_lies_where_its_pixel_lay(folder: Path) -> None:
    for options in ({}, {"crop": (4, 3, 20, 15)}, {"resize": (65, 13)}, {"scale": (0.1, 0.1, 0.1)}):
        world = built(folder / "a.asc", **options)
        left, top, cols, rows = options.get("crop", (0, 0, 33, 25))
        west, south, east, north = world.surface.bounds
        corners = {(west, north): (left, top), (east, south): (left + cols - 1, top + rows - 1)}
        for (x, y), (column, row) in corners.items():
            found = mercator(*(float(v) for v in world.to_geographic(x, y)))
            assert found == pytest.approx((WEST + CELL * column, NORTH - CELL * row), abs=1e-6)


def test_absolute_heights_and_what_undoes_them(folder: Path) -> None:
    z = heights(np.arange(33), np.arange(25))
    world = built(folder / "a.asc")
    assert world.place.height == pytest.approx(z.min(), abs=1e-5)
    for options in ({"height": 3.0}, {"z_scale": 2.0}, {"scale": (1.0, 1.0, 2.0)}, {"invert": True}):
        place = built(folder / "a.asc", **options).place
        assert place.height is None
        with pytest.raises(ConfigError, match=r"a\.asc: --option zero needs the file's own heights"):
            built(folder / "a.asc", zero=700.0, **options)


def test_neighbors_fit_with_one_zero(folder: Path) -> None:
    a, b = (built(folder / f"{name}.asc", zero=650.0) for name in "ab")
    np.testing.assert_array_equal(a.surface.z[:, -1], b.surface.z[:, 0])
    assert a.surface.z[0, 0] == pytest.approx(50.0, abs=1e-4)
    assert [w.place and w.place.height for w in (a, b)] == [650.0, 650.0]
    apart = [built(folder / f"{name}.asc") for name in "ab"]
    assert np.abs(apart[0].surface.z[:, -1] - apart[1].surface.z[:, 0]).max() > 0.1


def test_a_window_keeps_place_and_height(folder: Path, tmp_path: Path) -> None:
    whole = built(folder / "a.asc")
    saved = World.load(whole.save(tmp_path / "a"))
    window = (40.0, -30.0, 80.0)
    for part in (
        built(folder / "a.asc", window=window),
        build_world(tmp_path / "a", BuildOptions(window=window)),
    ):
        assert part.place.affine == whole.place.affine
        above = float(whole.surface.height_at(40.0, -30.0)) + (whole.place.height or 0)
        assert float(part.surface.height_at(40.0, -30.0)) + (part.place.height or 0) == pytest.approx(
            above, abs=1e-3
        )
    assert saved.place == whole.place
    high = built(folder / "a.asc", window=window, zero=600.0)
    assert high.surface.z.min() > 80


def test_gazebo_and_info_are_told(folder: Path, tmp_path: Path) -> None:
    world = built(folder / "a.asc")
    package = write_package(world, tmp_path, formats=("stl", "sdf"))
    place = ElementTree.parse(package / "a.world").find("world/spherical_coordinates")
    assert place is not None
    found = {child.tag: child.text or "" for child in place}
    latitude, longitude = world.to_geographic(0.0, 0.0)
    assert found["surface_model"] == "EARTH_WGS84"
    assert found["world_frame_orientation"] == "ENU"
    assert float(found["latitude_deg"]) == pytest.approx(float(latitude), abs=1e-8)
    assert float(found["longitude_deg"]) == pytest.approx(float(longitude), abs=1e-8)
    assert float(found["elevation"]) == pytest.approx(680, abs=1)
    assert float(found["heading_deg"]) == pytest.approx(0, abs=1e-6)
    line = dict(preview_facts(world))["place on earth"]
    assert re.fullmatch(r"EPSG:3857, 40\.7\d{5} N 74\.0\d{5} W, z = 0 at 680\.\d\d m", line)
    assert ("place on earth", line) in ground_facts(world)


def test_info_promises_no_start_between_coarse_samples(folder: Path) -> None:
    world = built(folder / "a.asc")
    for spacing, text in (
        (0.5, ", for {} and smaller robots"),
        (30.0, ", unknown whether {} can stand between the samples"),
    ):
        sampled = replace(world, ground=replace(world.ground, sample_spacing=spacing))
        rows = dict(measured_facts(sampled))
        assert rows["start poses"] == f"{len(world.spawn_poses)}{text.format(world.spawn_for)}"


def test_a_utm_world_says_that_its_x_axis_is_not_east(tmp_path: Path) -> None:
    """Grid convergence of 32618 at 74 W, 40.7 N: .65 deg, by (longitude - meridian) sin latitude."""
    write_raster(tmp_path / "utm.tif")
    world = built(tmp_path / "utm.tif")
    package = write_package(world, tmp_path, formats=("stl", "sdf"))
    path = "world/spherical_coordinates/heading_deg"
    turned = float(ElementTree.parse(package / "utm.world").findtext(path, ""))
    assert turned == pytest.approx((74.006 - 75) * np.sin(np.radians(40.71)), abs=2e-3)
    assert world.place.heading() == pytest.approx(turned, abs=1e-6)


def test_a_picture_lies_nowhere(tmp_path: Path) -> None:
    world = built(Path("simple"))
    assert world.place is None
    with pytest.raises(ConfigError, match="simple: its source does not say where on the earth it lies"):
        world.to_geographic(0.0, 0.0)
    assert "place on earth" not in dict(preview_facts(world))


@pytest.mark.parametrize(
    ("options", "steeper"),
    [
        ({"size": 3.0}, r"slopes become 8\d\.\d+ times as steep: .* \(5\d\.\d+ m\); --height or --scale"),
        ({"resolution": 75.91}, r"slopes become 0\.1 times as steep"),
        ({"size": 3.0, "height": 1.0}, None),
        ({"scale": (0.01, 0.01, 0.01)}, None),
    ],
)
def test_an_extent_alone_is_told_to_change_slopes(
    options: dict[str, Any], steeper: str | None, folder: Path
) -> None:
    if steeper is None:
        built(folder / "a.asc", **options)
        return
    with pytest.warns(UserWarning, match=rf"a\.asc: {steeper}"):
        build_world(folder / "a.asc", BuildOptions(**options))
