"""The place on earth of a world file, as gz-sim's NavSat reads it (Debian's python3-ignition-math)."""

import json
import math
import subprocess
import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine, xy
from rasterio.warp import transform

from lirs_wct.formats.gazebo import world_sdf
from lirs_wct.sources.build import build_world

PYTHON = "/usr/bin/python3"
PIXELS, SPACING = 41, 200.0
"""A square of 8 km: its corners are 5.7 km from the middle."""
TRANSFORM = """
import json, math, sys
from ignition.math import Angle, SphericalCoordinates as S, Vector3d
latitude, longitude, elevation, heading, frame, points = json.load(sys.stdin)
angles = (Angle(math.radians(a)) for a in (latitude, longitude))
place = S(S.EARTH_WGS84, *angles, elevation, Angle(math.radians(heading)))
found = [place.position_transform(Vector3d(*p), getattr(S, frame), S.SPHERICAL) for p in points]
print(json.dumps([(math.degrees(v.x()), math.degrees(v.y())) for v in found]))
"""
PLACES = {
    "New York": (32618, 583_000.0, 4_507_000.0, 0.0),
    "Tromso, far from its zone's meridian": (32633, 715_000.0, 7_740_000.0, 20.0),
    "Kazan": (32639, 380_000.0, 6_180_000.0, -35.0),
    "Quito, web Mercator": (3857, -8_737_000.0, -22_000.0, 90.0),
    "Cape Town": (32734, 262_000.0, 6_243_000.0, 160.0),
    "Ushuaia": (32719, 545_000.0, 3_927_000.0, 250.0),
}
"""EPSG code, coordinates of the middle, and the turn of the raster's rows from east to north, degrees."""


@pytest.fixture(scope="module", autouse=True)
def _library() -> None:
    command = (PYTHON, "-c", "import ignition.math")
    if not Path(PYTHON).exists() or subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip(f"{PYTHON} has no module ignition.math (Debian package python3-ignition-math)")


@pytest.mark.parametrize(
    "name", ["Kazan", *(pytest.param(name, marks=pytest.mark.slow) for name in PLACES if name != "Kazan")]
)
def test_corners_of_a_turned_raster_lie_where_their_pixels_lie(name: str, tmp_path: Path) -> None:
    code, east, north, turn = PLACES[name]
    c, s = SPACING * math.cos(math.radians(turn)), SPACING * math.sin(math.radians(turn))
    half = PIXELS / 2
    affine = Affine(c, s, east - (c + s) * half, s, -c, north - (s - c) * half)
    heights = np.arange(PIXELS**2, dtype=np.float32).reshape(PIXELS, PIXELS)
    shape = {"width": PIXELS, "height": PIXELS, "count": 1, "dtype": "float32"}
    path = tmp_path / "turned.tif"
    with rasterio.open(path, "w", driver="GTiff", crs=code, transform=affine, **shape) as file:
        file.write(heights, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        world = build_world(path)
    west, south, east_end, north_end = world.surface.bounds
    corners = [(west, south, 0.0), (east_end, south, 0.0), (east_end, north_end, 0.0), (west, north_end, 0.0)]
    sdf = world_sdf("turned", place=world.place)
    element = ElementTree.fromstring(sdf).find("world/spherical_coordinates")
    assert element is not None
    keys = ("latitude_deg", "longitude_deg", "elevation", "heading_deg")
    *origin, heading = (float(element.findtext(key, "")) for key in keys)
    # A height names its pixel, also where rows and columns of the raster were exchanged.
    x, y, _ = np.transpose(corners)
    pixels = [np.argwhere(heights == round(float(z)))[0] for z in world.surface.height_at(x, y)]
    truth = transform(f"EPSG:{code}", "EPSG:4326", *xy(affine, *np.transpose(pixels)))[:2][::-1]
    meters = 111_320 * np.array((1.0, math.cos(math.radians(truth[0][0]))))
    # Gazebo classic's frame is LOCAL; the manual tells which heading it needs.
    for frame, turned in (("LOCAL2", heading), ("LOCAL", 180 - heading)):
        question = json.dumps([*origin, turned, frame, corners])
        command = (PYTHON, "-c", TRANSFORM)
        done = subprocess.run(command, input=question, capture_output=True, text=True, check=True)
        apart = np.linalg.norm((json.loads(done.stdout) - np.transpose(truth)) * meters, axis=1)
        assert apart.max() < 1, (frame, apart)
