"""ROS maps: a YAML and a picture, read as map_server reads them, pixel by pixel."""

import math
import re
import warnings
from itertools import cycle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
import yaml
from hypothesis import given, settings, strategies as st
from PIL import Image

from lirs_wct.errors import SourceError
from lirs_wct.formats.map_server import MapMetadata, read_map, read_map_picture, read_metadata, write_map
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from tests.kit import refused

KEYS = "resolution: 0.5\norigin: [1.0, -2.0, 0.5]\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


def a_map(folder: Path, pixels: np.ndarray, keys: str) -> OccupancyGrid:
    cv2.imwrite(str(folder / "m.png"), pixels)
    (folder / "m.yaml").write_text(f"image: m.png\n{KEYS}{keys}")
    return read_map(folder / "m.yaml")


def states(grid: OccupancyGrid) -> list[list[str]]:
    symbols = np.where(grid.occupied, "#", np.where(grid.free, ".", np.where(grid.known, "~", "?")))
    return [" ".join(row).split() for row in symbols[::-1]]


def test_row_0_is_the_south_and_the_origin_its_corner(tmp_path: Path) -> None:
    pixels = np.full((4, 6), 254, np.uint8)
    pixels[3, 0] = 0  # lower left of the picture
    grid = a_map(tmp_path, pixels, "negate: 0\n")
    np.testing.assert_allclose(grid.occupied_points(), [Pose2(1, -2, 0.5).apply((0.25, 0.25))])


@given(
    st.lists(st.lists(st.sampled_from((0.0, 1.0, np.nan)), min_size=4, max_size=4), min_size=2, max_size=6),
    st.floats(0.01, 1),
    st.floats(-9, 9),
)
@settings(max_examples=30)
def test_a_written_map_reads_back(
    tmp_path_factory: pytest.TempPathFactory, p: list[list[float]], resolution: float, yaw: float
) -> None:
    stem = tmp_path_factory.mktemp("map") / "room.v2"
    grid = OccupancyGrid.from_probability(p, np.float64(resolution), Pose2(-1.5, np.float64(2.25), yaw))
    write_map(stem, grid)
    again = read_map(stem.with_name("room.v2.yaml"))
    assert (again.resolution, again.origin) == (grid.resolution, grid.origin)
    assert states(again) == states(grid)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("image: m.png\n", "resolution, origin"),
        ("image: m.png\nresolution: 0\norigin: [0, 0, 0]\n", "resolution must be a finite number above 0"),
        ("image: m.png\nresolution: 1\norigin: [0, 1e300, 0]\n", "origin must lie within 1e+09 m"),
        ("image: m.png\nresolution: nan\norigin: [0, 0]\n", "resolution must be a finite number above 0"),
        ("image: m.png\nresolution: 1e300\norigin: [0, 0]\n", "at most 1000 m, got 1e+300"),
        (f"image: m.png\n{KEYS}mode: cubic\n", "trinary, scale, raw"),
        ("image: m.png\nresolution: 1\norigin: [0]\n", "origin must be [x, y, yaw]"),
        ("image: m.png\nresolution: 1\norigin: [0, 0]\noccupied_thresh: 1.01\n", "must be from 0 to 1, got"),
        ("image: m.png\nresolution: 1\norigin: [0, 0]\nfree_thresh: nan\n", "from 0 to 1, got free"),
        ("image: m.png\nresolution: true\norigin: [0, 0]\n", "resolution must be a number, got 'true'"),
        (f"image: m.png\n{KEYS}mode: {{a: b}}\n", "mode: a map has no use for nested values"),
        (f"image: m.png\n{KEYS}\tmode: raw\n", "line 6: while parsing a block mapping"),
        ("- what\n", "line 1 is not `key: value`"),
        ("image: 'm.png\n", "line 2: while scanning a quoted scalar, found unexpected end of stream"),
        ("image: a\x01.png\n", "is not YAML: unacceptable character"),
        ("[" * 600, "is not YAML: is nested too deeply"),
        ("image: m.png\nresolution: [1]\norigin: [0, 0]\n", "resolution must be a number, got ['1']"),
        ("image: !!python/object/apply:os.system [x]\n", "origin"),
        (f"image: gone.png\n{KEYS}", "gone.png"),
    ],
)  # fmt: skip
def test_a_bad_yaml_is_one_line_with_its_path(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with refused(words=rf"bad\.yaml: .*{re.escape(says)}"):
        read_map(path)


def read_text(text: str, folder: Path) -> MapMetadata:
    path = folder / "text.yaml"
    path.write_text(text)
    return read_metadata(path)


@pytest.mark.parametrize(
    "change",
    [
        ("negate: 0", "negate: 0\nstatic_layer:\n  levels: [{a: 1, a: 2}]\n? [a, b]\n: c"),
        ("resolution: ", "resolution:\t"),
        ("resolution:", "resolution\t:"),
        ("negate: 0", "negate: 0\t# no\n\t\nlayer:\n  a:\t1"),
        ("[1, 2, 0.5]", "[1,\t2,\n\t0.5]"),
        ("[1, 2, 0.5]", "\n-\t1\n- 2\n- 0.5"),
        ("[1, 2, 0.5]", "[\n1,\n  '2', 5e-1,\n]"),
        ("resolution: 0.1", 'resolution: "1e-1"'),
        ("mode: raw", "mode: 'RAW'\n...\n- more"),
        ("mode: raw", "mode: Raw\n---\nimage: other.pgm"),
        ("image", "\ufeffimage"),
        ("\n", "\r\n"),
        ("origin", "base: &base {resolution: 5}\n<<: *base\norigin"),
    ],
)
def test_yaml_is_read_as_yaml_cpp_reads_it(change: tuple[str, str], tmp_path: Path) -> None:
    text = "image: m.png\nresolution: 0.1\norigin: [1, 2, 0.5]\nnegate: 0\nmode: raw\n"
    path = tmp_path / "m.yaml"
    for encoding in ("utf-8", "utf-16"):
        path.write_bytes(text.replace(*change).encode(encoding))
        assert read_metadata(path) == MapMetadata(
            image=tmp_path / "m.png", resolution=0.1, origin=Pose2(1, 2, 0.5), mode="raw"
        )


def test_the_first_of_two_keys_counts(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match=r"text\.yaml: image stands twice; the first is taken: 'a\.png'"):
        read = read_text(f"image: a.png\n{KEYS}image: b.png\nnegate: 0\nnegate: 0\n", tmp_path)
    assert read.image.name == "a.png"


def test_umlauts_of_windows(tmp_path: Path) -> None:
    text = f"# 0\u20ac, Gr\u00f6\u00dfe\nimage: Geb\u00e4ude.png\n{KEYS}"
    for encoding in ("cp1252", "utf-8"):
        (tmp_path / "m.yaml").write_bytes(text.encode(encoding))
        assert read_metadata(tmp_path / "m.yaml").image.name == "Geb\u00e4ude.png"


def test_names_that_look_like_other_things_stay_names(tmp_path: Path) -> None:
    for name in ("2020-01-01", "1.0", "yes", "null", "0x10", "12:30"):
        read = read_text(f"image: {name}\nresolution: 010\norigin: [1_0, 0, 0]\n", tmp_path)
        assert (read.image.name, read.resolution, read.origin.x) == (name, 10.0, 10.0)


def test_yaml_is_read_as_pyyaml_reads_it(shared_data: Path, tmp_path: Path) -> None:
    texts = [path.read_text() for path in sorted(shared_data.glob("maps/*/*.yaml"))]
    texts += [
        "image: 'a # b.pgm'  # it\nresolution: 1\norigin:\n- 1\n- -2.5\n- 0.3\nnegate: 0\n",
        '---\nimage: "x y.png"\nresolution: 5.0e-2\norigin: [ -1.5,2 , .5 ]\nmode: scale\n',
        "image: it's.pgm\nresolution: 1\norigin: [0, 0]\nfree_thresh:   0.196\n\n# end\n",
    ]
    assert len(texts) > 12
    for text in texts:
        expected, ours = yaml.safe_load(text), read_text(text, tmp_path)
        assert ours.image == tmp_path / expected["image"]
        assert ours.origin == Pose2(*expected["origin"])
        for key in {"resolution", "occupied_thresh", "free_thresh", "negate", "mode"} & set(expected):
            assert getattr(ours, key) == expected[key], (key, text)


# ---- every pixel by the rules of nav2's map_server


def nav2_cells(text: str, picture: Image.Image) -> list[list[int]]:
    """Return the cells of nav2's map_server, as written in its map_io.cpp: 0 to 100, -1 = unknown."""
    keys: dict[str, str] = {}
    for line in text.splitlines():
        key, _, value = line.partition(":")
        keys.setdefault(key.strip("\t '"), value.partition("#")[0].strip("\t '"))
    mode, negate = keys["mode"].lower(), keys["negate"].lower() in ("1", "yes", "on", "true")
    occupied, free = float(keys["occupied_thresh"]), float(keys["free_thresh"])

    def cell(red: int, green: int, blue: int, alpha: int) -> int:
        gray = (299 * red + 587 * green + 114 * blue + 1) // 1000
        if mode == "raw":
            return gray if gray <= 100 else -1
        if alpha < 255:
            return -1
        p = np.float32(gray) / np.float32(255)
        p = p if negate else 1 - p
        if p <= np.float32(free):
            return 0
        if p >= np.float32(occupied):
            return 100
        if mode == "trinary":
            return -1
        return math.floor((p - np.float32(free)) / np.float32(occupied - free) * 100 + np.float32(0.5))

    colors = picture.convert("RGBA")
    width, height = colors.size
    return [[cell(*colors.getpixel((x, y))) for x in range(width)] for y in range(height)]


def a_picture(kind: str, seed: int) -> Image.Image:
    rng = np.random.default_rng(seed)
    levels = (0, 51, 89, 90, 100, 101, 102, 153, 191, 192, 204, 205, 254, 255, *rng.integers(0, 256, 9))
    gray, red, blue = (Image.fromarray(rng.choice(levels, (9, 14)).astype(np.uint8)) for _ in range(3))
    alpha = Image.fromarray(rng.choice((0, 128, 254, 255, 255), (9, 14)).astype(np.uint8))
    if kind.startswith("P"):
        palette = gray.quantize(8)
        palette.putpalette(rng.permutation(256)[:24].tolist())
        if kind == "P+tRNS":
            palette.info["transparency"] = bytes((255, 0, 254, 255, 128, 255, 255, 255))
        return palette
    bands = {"L": (gray,), "LA": (gray, alpha), "RGB": (red, gray, blue), "RGBA": (red, gray, blue, alpha)}
    return Image.merge(kind, bands[kind])


KINDS = ("L", "RGB", "RGBA", "LA", "P", "P+tRNS")
SPELLED_MODES = ("trinary", "Scale", "'raw'", "TRINARY # all", "\tscale\t")
NEGATES = ("0", "1", "yes", "No", "on", "OFF", "True")
THRESHOLDS = ((0.65, 0.196), (0.65, 0.25), (0.6, 0.4), (0.4, 0.2), (0.8, 0.2), (0.2, 0.2), (0.1, 0.9))
THRESHOLDS += ((1.0, 0.0), (0.0, 1.0), (0.4, 0.6), (9e-1, 1e-2))
PAIRS = list(
    zip(range(40), cycle(KINDS), cycle(SPELLED_MODES), cycle(NEGATES), cycle(THRESHOLDS), strict=False)
)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("seed", "kind", "mode", "negate", "thresholds"), PAIRS)
def test_a_map_is_read_as_nav2_reads_it(
    seed: int, kind: str, mode: str, negate: str, thresholds: tuple[float, float], tmp_path: Path
) -> None:
    picture = a_picture(kind, seed)
    picture.save(tmp_path / "m.png")
    text = (
        f"image: m.png\nresolution: 0.5\norigin: [1.0, -2.0, 0.5]\nmode: {mode}\nnegate:\t{negate}\n"
        f"'occupied_thresh': {thresholds[0]}\nfree_thresh : {thresholds[1]}\n"
    )
    (tmp_path / "m.yaml").write_text(text)
    grid = read_map(tmp_path / "m.yaml")
    found = np.where(grid.known, grid.probability * 100, -1)[::-1]
    # nav2 publishes whole percents.
    np.testing.assert_allclose(found, nav2_cells(text, picture), atol=0.501 if "cale" in mode else 1e-3)


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
@pytest.mark.parametrize("negate", ["0", "1"])
@pytest.mark.parametrize("bands", [(), (3,), (4,)])
def test_16_bits_are_cut_to_8_as_nav2_cuts_them(
    tmp_path: Path, mode: str, negate: str, bands: tuple[int, ...]
) -> None:
    pixels = np.random.default_rng(5).integers(0, 65536, (7, 9, *bands)).astype(np.uint16)
    if bands == (4,):
        pixels[::2, :, 3] = 65535
    cv2.imwrite(str(tmp_path / "m.png"), pixels)
    (tmp_path / "m.yaml").write_text(
        f"image: m.png\nresolution: 0.2\norigin: [3, -4, 0.5]\nmode: {mode}\n"
        f"negate: {negate}\noccupied_thresh: 0.6\nfree_thresh: 0.3\n"
    )
    with warnings.catch_warnings(action="ignore"):
        grid = read_map(tmp_path / "m.yaml")
    assert (grid.shape, grid.resolution, grid.origin) == ((7, 9), 0.2, Pose2(3, -4, 0.5))
    shade = (np.round(pixels[..., :3] @ (0.114, 0.587, 0.299)) if bands else pixels) // 257 / 255
    p = shade if negate == "1" else 1 - shade
    between = (p - 0.3) / 0.3 if mode == "scale" else np.nan
    expected = np.where(p >= 0.6, 1.0, np.where(p <= 0.3, 0.0, between))
    if mode == "raw":
        expected = np.where(np.round(shade * 255) <= 100, np.round(shade * 255) / 100, np.nan)
    elif bands == (4,):
        expected[pixels[..., 3] < 65535] = np.nan
    np.testing.assert_allclose(grid.probability[::-1], np.clip(expected, 0, 1), atol=6e-5)


@pytest.mark.parametrize("maximum", [1, 15, 160, 255, 1000, 65535])
@pytest.mark.parametrize("bands", [1, 3])
def test_any_white_of_a_pnm(tmp_path: Path, maximum: int, bands: int) -> None:
    shades = np.repeat([[0.0, 0.4, 0.8, 1.0]] * 2, bands) * maximum
    body = shades.astype(">u2" if maximum > 255 else "u1").tobytes()
    (tmp_path / "m.pnm").write_bytes(b"P%d 4 2 %d\n" % (5 + bands // 3, maximum) + body)
    with warnings.catch_warnings(action="error"):
        found = states(read_map_picture(tmp_path / "m.pnm", 0.1))
    assert found == [["#", "?", "?", "."] if maximum > 1 else ["#", "#", "#", "."]] * 2


@pytest.mark.parametrize("profile", [{"nbits": 4}, {"nbits": 4, "photometric": "MINISWHITE"}, {"masked": 1}])
def test_any_white_of_a_tiff(tmp_path: Path, profile: dict[str, Any]) -> None:
    pixels = np.array([[0, 6, 12, 15]] * 3, np.uint8)
    masked, white_first = profile.pop("masked", 0), "photometric" in profile
    pixels = 15 - pixels if white_first else pixels * 17 if masked else pixels
    shape = {"width": 4, "height": 3, "count": 1, "dtype": "uint8"}
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(tmp_path / "m.tif", "w", driver="GTiff", **shape, **profile) as file,
    ):
        file.write(pixels, 1)
        if masked:
            file.write_mask(np.arange(3)[:, None] + np.zeros(4) > 0)
    first = ["?"] * 4 if masked else ["#", "?", "?", "."]
    assert states(read_map_picture(tmp_path / "m.tif", 0.1)) == [first] + [["#", "?", "?", "."]] * 2


def a_framed_map(folder: Path, keys: str, outside: tuple[int, int, int, int]) -> OccupancyGrid:
    pixels = np.full((12, 16, 4), 255, np.uint8)
    pixels[:4] = outside
    pixels[5, 2:10] = (0, 0, 0, 255)
    return a_map(folder, pixels, keys)


def test_transparent_is_unknown_and_the_older_rule_is_told(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="in Humble and ROS 1") as caught:
        grid = a_framed_map(tmp_path, "", (0, 0, 0, 0))
    assert [len(caught), grid.occupied.sum(), grid.free.sum(), (~grid.known).sum()] == [1, 8, 120, 64]
    assert str(caught[0].message).startswith(f"{tmp_path / 'm.png'}: 8 occupied and 120 free cells")
    assert "; 72 and 120 in Humble and ROS 1" in str(caught[0].message)


def test_no_word_where_both_rules_agree(tmp_path: Path) -> None:
    with warnings.catch_warnings(action="error"):
        assert a_framed_map(tmp_path, "", (255, 255, 255, 0)).occupied.sum() == 8
        assert a_framed_map(tmp_path, "mode: raw\n", (0, 0, 0, 0)).free.sum() == 72
        assert a_framed_map(tmp_path, "mode: scale\n", (0, 0, 0, 0)).occupied.sum() == 8


def test_free_wins_where_thresholds_cross(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "m.png"), np.array([[0, 10, 100, 255]] * 2, np.uint8))
    (tmp_path / "m.yaml").write_text(
        "image: m.png\nresolution: 1\norigin: [0, 0, 0]\noccupied_thresh: 0.1\nfree_thresh: 0.9\n"
    )
    with pytest.warns(UserWarning, match=r"m\.yaml: occupied_thresh 0\.1 is below free_thresh 0\.9"):
        assert states(read_map(tmp_path / "m.yaml")) == [["#", "#", ".", "."]] * 2


def test_what_a_yaml_leaves_out(tmp_path: Path) -> None:
    read = read_text("image: m.pgm\nresolution: 0.5\norigin: [1, 2]\n", tmp_path)
    assert read == MapMetadata(
        image=tmp_path / "m.pgm",
        resolution=0.5,
        origin=Pose2(1.0, 2.0, 0.0),
        occupied_thresh=0.65,
        free_thresh=0.196,
        negate=False,
        mode="trinary",
    )
    assert read_text("image: m.pgm\nresolution: 0.5\norigin: [1, 2]\nnegate: true\n", tmp_path).negate


def test_a_map_is_written_pixel_by_pixel(tmp_path: Path) -> None:
    p = np.array([[0.1, 0.24, 0.26], [0.64, 0.66, np.nan]])  # row 0 = south
    write_map(tmp_path / "m", OccupancyGrid.from_probability(p, 0.05, Pose2(-1.5, 2.0, 0.25)))
    pixels = cv2.imread(str(tmp_path / "m.pgm"), cv2.IMREAD_UNCHANGED)
    assert pixels.tolist() == [[205, 0, 205], [254, 254, 205]]
    assert yaml.safe_load((tmp_path / "m.yaml").read_text()) == {
        "image": "m.pgm",
        "mode": "trinary",
        "resolution": 0.05,
        "origin": [-1.5, 2.0, 0.25],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }


def test_a_picture_alone_is_read_by_the_defaults(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "m.pgm"), np.array([[0, 89, 90], [204, 206, 255]], np.uint8))
    grid = read_map_picture(tmp_path / "m.pgm", 0.25)
    assert (grid.resolution, grid.origin) == (0.25, Pose2())
    assert states(grid) == [["#", "#", "?"], ["?", ".", "."]]
    with pytest.raises(SourceError, match="at most 5 are allowed"):
        read_map_picture(tmp_path / "m.pgm", 0.25, max_pixels=5)
