"""Reader of elevation rasters, gray pictures and bundled worlds as terrain."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import scipy  # its modules load on first use
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError, MapPictureWarning, SourceError
from lirs_wct.formats import ENCODINGS
from lirs_wct.formats.elevation import (
    Raster,
    RasterInfo,
    decode,
    missing_heights,
    read_raster,
    tile_georeference,
)
from lirs_wct.geometry import Float32Array, HeightField, nearest_values, resample
from lirs_wct.geometry.geodesy import Place
from lirs_wct.ground import Terrain, Window, cut_terrain
from lirs_wct.sources.bundled import SIZE, bundled_picture
from lirs_wct.sources.source import DEFAULT_HEIGHT, DEFAULT_SIZE, BuildOptions, Reading, Source, SourceKind

Rectangle = tuple[slice, slice]
"""Rows and columns of a raster."""
GRAY_TOLERANCE = 2
"""Levels of 255 by which the channels of a gray picture may differ (rounding of color conversions)."""
LUMA = (0.114, 0.587, 0.299)
"""Weights of blue, green, red (ITU-R BT.601)."""
MAP_LEVELS, MAP_SHARE = 5, 0.85
"""Grays of an occupancy map, and the share of the pixels that they cover."""
SLOPE_CHANGE = 0.01
"""Relative change of slopes above which a given extent without given heights causes a warning."""
BORDER_SHARE, CLIFF_HEIGHT, CLIFF_STEPS = 0.02, 50.0, 10.0
"""Limits for the lowest value on the border as undeclared "no data": share of the border, height of the cliff
next to it (meters), and ratio of the cliff to the usual step between neighbors."""
MEDIAN_WINDOW = 5
"""Side of the median filter, pixels."""
BILATERAL_REACH, BILATERAL_CONTRAST = 3.0, 0.05
"""Standard deviations of the bilateral filter: pixels, and share of the picture's range."""
COARSEST_SIDE, ITERATIONS = 8, 40
"""Least side of the coarsest level of a pyramid, and steps on each level; more hardly reduce triangles."""
DESCENT = 1 / 64
"""One over the largest eigenvalue of the squared five-point Laplacian."""


def read_terrain(source: Source, options: BuildOptions) -> Reading:
    """Read a picture or a bundled world as terrain.

    Bright is high, the lowest point is z = 0 unless `zero` is given, and the center is the origin.

    A GeoTIFF keeps its own pixel size and heights unless the options change them; any other picture is scaled
    to the options or their defaults. The pixels are the nodes. Options act in this order: crop, nodata,
    invert, dequantize, denoise, smoothing, sharpness, resize, meters, scale, window.
    """
    path = source.path
    if source.kind is SourceKind.BUNDLED:
        raster, scale, options = _bundled_raster(path, options)
    else:
        sized = bool(options.size or options.resolution)
        raster = _decode_colors(path, read_raster(path, options.max_pixels, sized=sized), options)
        scale = _scale_text(raster.info, options)
    pixels = _crop(path, raster.pixels, options.crop)
    width, depth = _extent(pixels.shape, raster.info, options)
    values = _known_heights(path, pixels, raster.info, options, (width, depth))
    z, height = _meters(path, values, pixels, raster.info, options)
    try:
        surface = HeightField.centered(z, (width / (z.shape[1] - 1), depth / (z.shape[0] - 1)))
    except ConfigError as error:
        raise SourceError(f"{path}: {error}") from error
    _warn_slope_change(path, raster, surface, options)
    if options.kind is None and looks_like_map(raster.pixels):
        text = "looks like a laser map: give its YAML file, or --kind map with --resolution"
        warnings.warn(MapPictureWarning(f"{path}: {text}"), stacklevel=4)
    terrain, place = Terrain(surface), _place(raster, surface, height, options)
    if options.window is not None:
        terrain, lift = cut_terrain(terrain, options.window, level=options.zero is None)
        place = place and place.raised(lift)
    return terrain, scale, place


def _bundled_raster(path: Path, options: BuildOptions) -> tuple[Raster, str, BuildOptions]:
    """Return a bundled world's picture, the origin of its meters, and its options."""
    bundled = bundled_picture(path.name)
    resized = options.size or options.resolution or options.height
    size = options.size if options.size or options.resolution else SIZE
    own = replace(options, size=size, height=options.height or bundled.height)
    return Raster(bundled.pixels), "as given" if resized else "as bundled", own


def _decode_colors(path: Path, raster: Raster, options: BuildOptions) -> Raster:
    """Return the raster with colors of elevation tiles decoded to heights."""
    if options.encoding == "gray":
        return raster
    if raster.pixels.ndim != 3 or raster.pixels.dtype != np.uint8:
        raise SourceError(f"{path}: {options.encoding} is 8-bit color, this is {raster.pixels.dtype} gray")
    shape = raster.pixels.shape[:2]
    georeference = raster.info.georeference or tile_georeference(path, (shape[0], shape[1]))
    if georeference is None and options.size is None and options.resolution is None:
        raise ConfigError(
            f"{path}: its heights are in meters, its extent is not known: give --resolution or --size"
        )
    return Raster(decode(raster.pixels, options.encoding), RasterInfo(georeference, unit=1.0))


def _scale_text(info: RasterInfo, options: BuildOptions) -> str:
    """Return the origin of the meters as text."""
    size = height = "the file's own"
    if info.georeference is None:
        size = f"{DEFAULT_SIZE:g} m on the longer side by default"
    if info.unit is None:
        height = f"{DEFAULT_HEIGHT:g} m by default"
    if options.size is not None or options.resolution is not None:
        size = "as given"
    if options.height is not None:
        height = "as given"
    return size if size == height else f"size {size}, height {height}"


def looks_like_map(pixels: NDArray[Any]) -> bool:
    """Return whether a picture has the few grays of an occupancy map.

    The five most common grays cover 85 % of the pixels, and two of occupied, unknown and free are among them.
    """
    if pixels.dtype != np.uint8 or pixels.ndim != 2:
        return False
    counts = np.bincount(pixels.ravel(), minlength=256)
    common = np.argsort(-counts, kind="stable")[:MAP_LEVELS]
    meanings = {
        meaning
        for meaning, grays in (("occupied", (0,)), ("unknown", (205,)), ("free", (254, 255)))
        if any(counts[gray] and abs(gray - level) <= GRAY_TOLERANCE for gray in common for level in grays)
    }
    return len(meanings) > 1 and bool(counts[common].sum() >= MAP_SHARE * pixels.size)


def _crop(path: Path, pixels: NDArray[Any], crop: tuple[int, int, int, int] | None) -> NDArray[Any]:
    if crop is None:
        return pixels
    (col, row, width, height), (rows, cols) = crop, pixels.shape[:2]
    if col + width > cols or row + height > rows:
        raise SourceError(
            f"{path}: image is {cols}x{rows} px, a crop of {width}x{height} at {col},{row} is not within it"
        )
    return pixels[row : row + height, col : col + width]


def _extent(shape: tuple[int, ...], info: RasterInfo, options: BuildOptions) -> tuple[float, float]:
    """Return width and depth of the ground, meters, between the outermost pixels."""
    if options.size is not None and options.resolution is not None:
        raise ConfigError("both set the extent of a picture: give one of --size, --resolution")
    x, y, _ = options.scale or (1.0, 1.0, 1.0)
    if isinstance(options.size, tuple):
        return options.size[0] * x, options.size[1] * y
    rows, cols = shape[:2]
    sx, sy = info.georeference.pixel if info.georeference else (1.0, 1.0)
    if options.resolution is not None:
        sx = sy = options.resolution
    elif options.size is not None or info.georeference is None:
        factor = (options.size or DEFAULT_SIZE) / max((cols - 1) * sx, (rows - 1) * sy)
        sx, sy = sx * factor, sy * factor
    return (cols - 1) * sx * x, (rows - 1) * sy * y


def _known_heights(
    path: Path, pixels: NDArray[Any], info: RasterInfo, options: BuildOptions, size: tuple[float, float]
) -> NDArray[np.floating[Any]]:
    """Return (rows, cols) values; a pixel without height takes that of its nearest neighbor.

    At most half of the pixels within a window may lack a height. The size is width and depth, meters.
    """
    values = _gray(path, pixels, options.grayscale)
    nodata = info.nodata if options.nodata is None else options.nodata
    # Unsigned levels have no value for "no data" unless they are heights or the file declares one.
    if nodata is not None or info.unit is not None or pixels.dtype.kind != "u":
        search = info.unit is not None and options.nodata is None
        missing, codes = missing_heights(values, nodata, search=search)
        if missing.any():
            _report_missing(path, values, missing, codes, _kept(pixels.shape, size, options.window))
            values = nearest_values(values, missing)
    if nodata is None and info.unit is not None:
        warn_nodata_border(path, values, info.unit)
    return values


def _kept(shape: tuple[int, ...], size: tuple[float, float], window: Window | None) -> Rectangle:
    """Return the rows and columns of a picture that a window keeps."""
    if window is None:
        return slice(None), slice(None)
    (x, y, side), spans = window, []
    for middle, length, count in ((-y, size[1], shape[0]), (x, size[0], shape[1])):
        first, last = (((middle + half) / length + 0.5) * (count - 1) for half in (-side / 2, side / 2))
        start = min(max(int(first), 0), count - 1)
        spans.append(slice(start, max(start + 1, int(last) + 2)))
    return spans[0], spans[1]


def _report_missing(
    path: Path,
    values: NDArray[np.floating[Any]],
    missing: NDArray[np.bool_],
    codes: tuple[float, ...],
    kept: Rectangle,
) -> None:
    """Warn of pixels without a height; refuse more than half of the kept ones."""
    if missing[kept].mean() > 0.5:
        raise SourceError(
            f"{path}: {int(missing[kept].sum())} of {missing[kept].size} pixels have no height (NaN or "
            "nodata), at most half may lack one; --window X,Y,SIDE keeps a part"
        )
    share = f"{int(missing.sum())} of {values.size} pixels have no height (NaN or nodata)"
    if codes:
        known = values[~missing]
        share += (
            f", {' and '.join(f'{code:g}' for code in codes)} among them: an isolated level, the others are "
            f"{known.min():.6g} to {known.max():.6g}"
        )
    warnings.warn(f"{path}: {share}, filled from their nearest neighbors", stacklevel=3)


def _gray(path: Path, pixels: NDArray[Any], grayscale: bool) -> NDArray[np.floating[Any]]:
    """Return (rows, cols) float32, or float64 where float32 would lose levels."""
    kind = np.float64 if pixels.dtype in (np.int32, np.uint32, np.float64) else np.float32
    gray: NDArray[np.floating[Any]]
    if pixels.ndim == 2:
        gray = pixels.astype(kind)
        return gray
    span = pixels.max(axis=2).astype(kind) - pixels.min(axis=2)
    full = np.iinfo(pixels.dtype).max if pixels.dtype.kind in "iu" else float(np.nanmax(np.abs(pixels)))
    if not grayscale and (span > GRAY_TOLERANCE * full / 255).any():
        if pixels.dtype.kind == "f":
            raise SourceError(
                f"{path}: has {pixels.shape[2]} different bands of {pixels.dtype}, a terrain needs one band "
                "of heights: cut that out (gdal_translate -b 1 IN OUT), or mix them with --grayscale"
            )
        raise SourceError(
            f"{path}: is in color, a terrain needs a gray picture; --grayscale makes it gray, "
            f"--option encoding reads the colors of elevation tiles ({' or '.join(ENCODINGS[1:])})"
        )
    if not span.any():
        gray = pixels[..., 0].astype(kind)
        return gray
    gray = np.zeros(pixels.shape[:2], dtype=kind)
    for channel, weight in enumerate(LUMA):
        gray += pixels[..., channel] * float(weight)
    return gray


def warn_nodata_border(path: Path, values: NDArray[np.floating[Any]], unit: float) -> None:
    """Warn of a border of the lowest value next to a cliff, likely no data."""
    lowest = values.min()
    low = values == lowest
    border = np.concatenate((low[0], low[-1], low[1:-1, 0], low[1:-1, -1]))
    if np.count_nonzero(border) < max(4, BORDER_SHARE * border.size):
        return
    label, _ = scipy.ndimage.label(low)
    edge = np.concatenate((label[0], label[-1], label[:, 0], label[:, -1]))
    low = np.isin(label, np.unique(edge[edge > 0]))
    beside = scipy.ndimage.binary_dilation(low) & ~low
    if not beside.any():
        return
    cliff = float(np.median(values[beside] - lowest)) * unit
    steps = np.abs(np.diff(values, axis=1))[~low[:, 1:] & ~low[:, :-1]]
    usual_step = float(np.median(steps)) * unit if steps.size else 0.0
    if cliff > max(CLIFF_HEIGHT, CLIFF_STEPS * usual_step):
        warnings.warn(
            f"{path}: {int(low.sum())} pixels of {lowest:g} along the border stand beside heights "
            f"{cliff:.0f} m above them; where {lowest:g} means no height, say --option nodata={lowest:g}",
            stacklevel=4,
        )


def _warn_slope_change(path: Path, raster: Raster, surface: HeightField, options: BuildOptions) -> None:
    """Warn if the extent is given and the heights are not, because slopes change."""
    georeference = raster.info.georeference
    if georeference is None or options.height or options.z_scale or options.scale:
        return
    cols = options.crop[2] if options.crop else raster.pixels.shape[1]
    steeper = (cols - 1) * georeference.pixel[0] / surface.size[0]
    if abs(steeper - 1) > SLOPE_CHANGE:
        warnings.warn(
            f"{path}: slopes become {steeper:.4g} times as steep: the extent was given, the heights stay the "
            f"file's own ({surface.relief:.4g} m); --height or --scale changes them as well",
            stacklevel=4,
        )


def _place(raster: Raster, surface: HeightField, height: float | None, options: BuildOptions) -> Place | None:
    """Return the georeference of the terrain, if the raster has one."""
    georeference = raster.info.georeference
    if georeference is None:
        return None
    left, top, cols, rows = options.crop or (0, 0, *raster.pixels.shape[1::-1])
    (west, south), (width, depth) = surface.origin, surface.size
    across, down = (cols - 1) / width, (rows - 1) / depth
    a, b, _, d, e, _ = georeference.affine
    # The column at x = 0, and the row at y = 0, of the whole raster.
    x0, y0 = georeference.coordinates(left - west * across, top + (south + depth) * down)
    return Place(georeference.system, (a * across, -b * down, x0, d * across, -e * down, y0), height)


def _meters(
    path: Path,
    values: NDArray[np.floating[Any]],
    pixels: NDArray[Any],
    info: RasterInfo,
    options: BuildOptions,
) -> tuple[Float32Array, float | None]:
    """Return filtered heights, meters, and the file's height of z = 0 unless rescaled."""
    unit, factor = info.unit or 1.0, (options.scale or (1.0, 1.0, 1.0))[2] * (options.z_scale or 1.0)
    own = info.unit is not None and options.height is None and factor == 1.0 and not options.invert
    if options.zero is not None and not own:
        raise ConfigError(f"{path}: --option zero needs the file's own heights, which these are not")
    if info.scale != 1.0 or info.offset != 0.0:
        values = values.astype(np.float64) * info.scale + info.offset
    if options.invert:
        np.negative(values, out=values)
    base = float(values.min()) if options.zero is None else options.zero / unit
    values -= base
    above = values.astype(np.float32, copy=False)
    if options.deterrace:
        above = dequantize(above, _level_step(path, pixels) * abs(info.scale))
    above = apply_filters(above, options)
    if options.zero is None:
        lowest = float(above.min())
        above -= np.float32(lowest)
        base += lowest
        relief = above.max()
        if relief > 0 and (info.unit is None or options.height is not None):
            # Division first: the highest point is exactly `height`.
            above /= relief
            unit = options.height or DEFAULT_HEIGHT
    above *= np.float32(unit)
    above *= np.float32(factor)
    return above, base * unit if own else None


def apply_filters(values: Float32Array, options: BuildOptions) -> Float32Array:
    """Return the values after denoising, smoothing, sharpening and resizing, in this order.

    Denoising removes single wrong pixels (median), or smooths noise and keeps edges (bilateral). Sharpening
    adds a multiple of the difference to a blur (unsharp mask).
    """
    if options.denoise == "median":
        values = np.asarray(cv2.medianBlur(values, MEDIAN_WINDOW), np.float32)
    elif options.denoise == "bilateral":
        contrast = max(float(np.ptp(values)) * BILATERAL_CONTRAST, 1e-12)
        values = np.asarray(cv2.bilateralFilter(values, -1, contrast, BILATERAL_REACH), np.float32)
    if options.smoothing is not None:
        values = _blur(values, options.smoothing)
    if options.sharpness is not None:
        blurred = _blur(values, max(options.smoothing or 0.0, 1.0))
        values = values + np.float32(options.sharpness) * (values - blurred)
    if options.resize is not None:
        values = resample(values, *options.resize)
    return values


def _blur(values: Float32Array, sigma: float) -> Float32Array:
    blurred = cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred, dtype=np.float32)


def dequantize(levels: Float32Array, step: float = 1.0) -> Float32Array:
    """Return the smoothest surface within half a gray level of every pixel.

    It minimizes the thin-plate energy, the sum of squared Laplacians, under |z - levels| <= step / 2. The
    method is projected gradients with momentum (Beck and Teboulle 2009, algorithm FISTA; restarted after
    O'Donoghue and Candes 2015, section 3.2), from coarse to fine: wide terraces converge on coarse levels.
    The step is the distance of neighboring levels.
    """
    half = np.float32(step / 2)
    pyramid = [levels]
    while min(pyramid[-1].shape) >= 2 * COARSEST_SIDE:
        rows, cols = pyramid[-1].shape
        smaller = cv2.resize(pyramid[-1], ((cols + 1) // 2, (rows + 1) // 2), interpolation=cv2.INTER_AREA)
        pyramid.append(np.asarray(smaller, dtype=np.float32))
    z = pyramid[-1]
    for level in reversed(pyramid):
        if z.shape != level.shape:
            z = cv2.resize(z, (level.shape[1], level.shape[0]), interpolation=cv2.INTER_CUBIC)
        z = _smoothest(np.clip(z, level - half, level + half), level - half, level + half)
    return z


def _smoothest(z: Float32Array, low: Float32Array, high: Float32Array) -> Float32Array:
    """Descend from a surface to smoother ones between two bounds."""
    ahead, momentum = z, 1.0
    for _ in range(ITERATIONS):
        gradient = ahead
        for _ in range(2):
            gradient = cv2.Laplacian(gradient, cv2.CV_32F, ksize=1, borderType=cv2.BORDER_REPLICATE)
        gradient *= -DESCENT
        gradient += ahead
        following = np.clip(gradient, low, high, out=gradient)
        moved = following - z
        # A step against the momentum resets the momentum.
        if np.vdot(ahead - following, moved) > 0:
            momentum = 1.0
        after = (1 + (1 + 4 * momentum**2) ** 0.5) / 2
        moved *= np.float32((momentum - 1) / after)
        moved += following
        z, ahead, momentum = following, moved, after
    return z


def _level_step(path: Path, pixels: NDArray[Any]) -> float:
    """Return the distance of neighboring gray levels; 257 for 8 bits stored as 16."""
    if pixels.dtype.kind not in "iu":
        raise SourceError(f"{path}: holds floating-point heights, --option deterrace=true needs gray levels")
    steps = np.diff(np.unique(pixels))
    return float(np.gcd.reduce(steps)) if len(steps) else 1.0
