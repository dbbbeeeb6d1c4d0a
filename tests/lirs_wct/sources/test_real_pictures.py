"""Every real picture: built, built with a warning, or refused with one clear line."""

import re
import warnings
from pathlib import Path

import pytest

from tests.kit import read_heights, refused

COLOR = "is in color"
LIKE_MAP = "looks like a laser map"
HOLES = "pixels have no height"
PAGES = "pages, the first is taken"

# file: outcome: (rows, cols) and the words of its warning, or the words of its refusal
OUTCOMES: dict[str, tuple[tuple[int, int], str] | str] = {
    "height/PX4-SITL_gazebo-classic__terrain.png": ((513, 513), ""),
    "height/Pillow__16_bit_binary.pgm": ((100, 20), ""),
    "height/Pillow__16bit.cropped.tif": ((64, 64), ""),
    "height/TouchTerrain_for_CAGEO__geotiff_example.tif": ((379, 415), ""),
    "height/TouchTerrain_for_CAGEO__pyramid.tif": ((101, 101), ""),
    "height/gazebo_models__NAC_DTM_APOLLO15_E261N0036_257x257+7472+2152.png": ((257, 257), ""),
    "height/gazebo_terrain_generator__prayag_height_map.tif": ((1025, 1025), ""),
    "height/gz-common__dem_landscape.tif": ((125, 200), ""),
    "height/gz-common__dem_moon.tif": ((33, 33), "its units are taken for ground meters"),
    "height/gz-common__dem_squared.tif": ((129, 129), ""),
    "height/gz-common__dem_unfinished.tif": ((33, 33), f"282 of 1089 {HOLES}"),
    "height/gz-common__heightmap_bowl.png": ((129, 129), ""),
    "height/gz-common__heightmap_flat_257x257.png": ((257, 257), ""),
    "height/gz-sim__lookup_slip_heightmap.png": ((129, 129), ""),
    "height/hmstl__mask.png": ((104, 138), LIKE_MAP),
    "height/hmstl__scene.png": ((104, 138), ""),
    "height/mujoco-terrain-based-on-grayscale-images__terrain0.png": ((100, 100), ""),
    "height/mujoco__hfield.png": COLOR,
    "height/mujoco__hfield_240_280.png": ((240, 280), ""),
    "height/pydelatin__fuji.png": COLOR,
    "height/rasterio__RGBA.uint16.tif": f"133258 of 260574 {HOLES}",
    "height/rasterio__float_nan.tif": ((2, 3), f"1 of 6 {HOLES}"),
    "height/tin-terrain__valid_raster.tif": ((80, 100), f"970 of 8000 {HOLES}"),
    "height/unicode путь 图.png": ((65, 97), ""),
    "height/unitree_mujoco__height_field.png": ((128, 128), ""),
    "height/unitree_mujoco__unitree_robot.jpeg": COLOR,
    "height/vrc_driving_heightmap.png": ((129, 129), ""),
    "broken/Pillow__broken.png": "is damaged, or not a picture",
    "broken/Pillow__broken_exif_dpi.jpg": COLOR,
    "broken/Pillow__decompression_bomb.gif": "cannot be read by GDAL",
    "broken/Pillow__hopper_bw_500.png": ((500, 500), LIKE_MAP),
    "broken/Pillow__pil_sample_cmyk.jpg": COLOR,
    "broken/gen_1x1.png": "image is 1x1 px, a terrain needs at least 2x2",
    "broken/gen_1x64.png": "image is 1x64 px, a terrain needs at least 2x2",
    "broken/gen_allblack_129.png": ((129, 129), ""),
    "broken/gen_animated.gif": ((65, 97), f"has 4 {PAGES}"),
    "broken/gen_badcrc.png": "is damaged: broken PNG file (bad header checksum in b'IDAT')",
    "broken/gen_bomb_header_100000x100000.png": "= 10000000000 pixels, at most",
    "broken/gen_cmyk.jpg": ((65, 97), ""),
    "broken/gen_empty.png": "is empty",
    "broken/gen_float32_nan.tif": ((65, 97), f"15 of 6305 {HOLES}"),
    "broken/gen_float32_nodata-9999.tif": ((65, 97), f"15 of 6305 {HOLES}"),
    "broken/gen_gray16_97x65.png": ((65, 97), ""),
    "broken/gen_gray1bit.png": ((64, 64), LIKE_MAP),
    "broken/gen_gray2bit.png": ((64, 64), LIKE_MAP),
    "broken/gen_p2_ascii.pgm": ((3, 4), LIKE_MAP),
    "broken/gen_palette.png": ((65, 97), ""),
    "broken/gen_palette_trns.png": ((65, 97), "pixels are transparent; the alpha channel is left out"),
    "broken/gen_pgm_short.pgm": "is damaged: image file is truncated",
    "broken/gen_progressive.jpg": ((65, 97), ""),
    "broken/gen_text.png": "is neither a picture nor elevation data that is read; legal: PNG",
    "broken/gen_truncated_half.png": "is damaged: Truncated File Read",
    "broken/gen_zero_width.png": "is damaged, or not a picture",
}

SIZES = {  # meters, from the GeoTIFFs' own scale; on the ground at the center's latitude
    "gz-common__dem_moon.tif": (77.65, 77.65, 6.856),
    "gz-common__dem_squared.tif": (3123.6, 3946.5, 253.08),
    "tin-terrain__valid_raster.tif": (307.00, 243.95, 17.493),
    "TouchTerrain_for_CAGEO__geotiff_example.tif": (15003.77, 13699.10, 415.42),
}


@pytest.mark.shared
def test_the_table_is_complete(shared_data: Path) -> None:
    there = {f"{d}/{p.name}" for d in ("height", "broken") for p in (shared_data / d).iterdir()}
    assert there == set(OUTCOMES)


@pytest.mark.shared
@pytest.mark.parametrize("name", OUTCOMES)
def test_outcome(shared_data: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    path, outcome = shared_data / name, OUTCOMES[name]
    with warnings.catch_warnings(record=True, action="always") as said:
        if isinstance(outcome, str):
            with refused(f"{path}: ", re.escape(outcome)):
                read_heights(path)
            return
        surface = read_heights(path)
    shape, warning = outcome
    assert surface.shape == shape
    assert surface.z.min() == 0
    assert [warning in str(w.message) for w in said] == [True] * bool(warning)
    assert capfd.readouterr() == ("", "")


@pytest.mark.shared
@pytest.mark.parametrize("name", [name for name, outcome in OUTCOMES.items() if outcome == COLOR])
def test_color_builds_with_grayscale(shared_data: Path, name: str) -> None:
    relief = read_heights(shared_data / name, grayscale=True).relief
    one_color = name == "broken/Pillow__broken_exif_dpi.jpg"
    assert relief == pytest.approx(0 if one_color else 6)


@pytest.mark.shared
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", SIZES)
def test_geotiffs_keep_their_own_scale(shared_data: Path, name: str) -> None:
    surface = read_heights(shared_data / "height" / name)
    assert (*surface.size, surface.relief) == pytest.approx(SIZES[name], rel=1e-4)
