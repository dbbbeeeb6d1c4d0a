"""A picture, a file or a bundled one, becomes a height field in metres."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lirs_wct.arrays import Float32Array
from lirs_wct.errors import SourceError
from lirs_wct.formats.images import tiff
from lirs_wct.formats.images.picture import Picture, check_size, read_picture
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.ground import Terrain
from lirs_wct.sources.bundled import SIZE, bundled_picture
from lirs_wct.sources.dequantize import dequantize
from lirs_wct.sources.filters import apply_filters
from lirs_wct.sources.options import DEFAULT_HEIGHT, DEFAULT_SIZE, BuildOptions
from lirs_wct.sources.source import Source
from lirs_wct.sources.source_kind import SourceKind
from lirs_wct.sources.window import cut_surface

GRAY_TOLERANCE = 2
"""Levels of 255 by which the channels of a gray picture may differ (rounding of colour conversions)."""
LUMA = (0.114, 0.587, 0.299)
"""Weights of blue, green, red (ITU-R BT.601)."""
UNTAGGED_NODATA = (-9999.0, -32768.0)
"""What elevation rasters hold where nothing was measured, even without a tag; below -1e30 likewise."""


def read_terrain(source: Source, options: BuildOptions) -> tuple[Terrain, str]:
    """Return a picture or a bundled world as ground, and a text that says where its metres come from.

    Raises:
        SourceError: the picture cannot be used.
        ConfigError: the window lies outside the terrain.
    """
    surface, scale = _scaled(source.path, open_picture(source, options.max_pixels), options)
    if options.window is not None:
        surface = cut_surface(surface, options.window)
    return Terrain(surface), scale


@dataclass(frozen=True)
class TerrainPicture:
    """A picture of a terrain, and the metres that it brings.

    Attributes:
        picture: decoded.
        size: longer side in metres; None = as the picture's tags say, else the default.
        height: metres between its darkest and its brightest pixel; None = the same.
    """

    picture: Picture
    size: float | None = None
    height: float | None = None

    def with_own_metres(self, options: BuildOptions) -> BuildOptions:
        """Return the options with the picture's own metres where they give none."""
        size = options.size if options.size or options.pixel_size else self.size
        return replace(options, size=size, height=options.height or self.height)


def open_picture(source: Source, max_pixels: int) -> TerrainPicture:
    """Decode the picture of a terrain, or make that of a bundled world.

    Raises:
        SourceError: the picture cannot be used.
    """
    if source.kind is not SourceKind.BUNDLED:
        return TerrainPicture(read_picture(source.path, max_pixels))
    bundled = bundled_picture(source.path.name)
    rows, cols = bundled.pixels.shape
    check_size(source.path, cols, rows, max_pixels)
    return TerrainPicture(Picture(bundled.pixels, {}), SIZE, bundled.height)


def read_height_field(path: Path, options: BuildOptions) -> HeightField:
    """Read a picture as a terrain (see `read_scaled`)."""
    return read_scaled(path, options)[0]


def read_scaled(path: Path, options: BuildOptions) -> tuple[HeightField, str]:
    """Read a picture as a terrain, and a text that says where its metres come from.

    Bright is high, the lowest point is z = 0, the centre is the origin.

    A GeoTIFF keeps its own pixel size and heights unless the options say otherwise; any other picture
    is scaled to the options or their defaults. The pixels are the nodes. Options act in this order: crop,
    nodata, invert, dequantize, denoise, smoothing, sharpness, resize, metres, scale.

    Raises:
        SourceError: the file cannot be used, is in colour without `grayscale`, or is more than half
            nodata.
    """
    return _scaled(path, TerrainPicture(read_picture(path, options.max_pixels)), options)


def _scaled(path: Path, found: TerrainPicture, options: BuildOptions) -> tuple[HeightField, str]:
    surface = height_field(path, found.picture, found.with_own_metres(options))
    if found.size is not None:
        resized = options.size or options.pixel_size or options.height
        return surface, "as given" if resized else "as bundled"
    return surface, _scale_text(own=_metric_pixel(path, found.picture) is not None, options=options)


def decimated(
    path: Path, picture: Picture, options: BuildOptions, nodes: int
) -> tuple[Picture, BuildOptions]:
    """Return a smaller picture, and the options that make nearly the same terrain of it, for a preview.

    Pixels are left out and none is averaged, so gray levels and "no data" stay what they are.

    Args:
        path: of the picture, for errors.
        picture: the whole one.
        options: for the whole one.
        nodes: along the longer side, at most.

    Raises:
        SourceError: the crop lies outside the picture, or its scale cannot be used.
    """
    pixels = _cropped(path, picture.pixels, options.crop)
    size = _extent(pixels.shape, _metric_pixel(path, picture), options)
    rows, cols = pixels.shape[:2]
    share = min(1.0, nodes / max(rows, cols))
    at = [np.linspace(0, n - 1, max(2, round(n * share))).round().astype(int) for n in (rows, cols)]
    small = Picture(np.ascontiguousarray(pixels[np.ix_(*at)]), picture.tags)
    resize = options.resize and (min(options.resize[0], nodes), min(options.resize[1], nodes))
    smoothing = options.smoothing and options.smoothing * share
    return small, replace(options, crop=None, size=size, pixel_size=None, smoothing=smoothing, resize=resize)


def height_field(path: Path, picture: Picture, options: BuildOptions) -> HeightField:
    """Return a decoded picture as a terrain (see `read_scaled`).

    Raises:
        SourceError: as `read_scaled` says.
    """
    pixels = _cropped(path, picture.pixels, options.crop)
    above = _above_lowest(path, pixels, tiff.nodata(picture.tags), options)
    if options.deterrace:
        above = dequantize(above, _level_step(path, pixels))
    above = apply_filters(above, options)
    pixel = _metric_pixel(path, picture)
    unit = None if pixel is None else tiff.height_unit(picture.tags)
    width, depth = _extent(pixels.shape, pixel, options)
    sx, sy, sz = options.scale or (1.0, 1.0, 1.0)
    z = _heights(above, unit, options.height, sz * (options.z_scale or 1.0))
    rows, cols = z.shape
    return HeightField.centered(z, (width * sx / (cols - 1), depth * sy / (rows - 1)))


def _metric_pixel(path: Path, picture: Picture) -> tuple[float, float] | None:
    """Return a GeoTIFF's metres a pixel, None for other pictures."""
    try:
        return tiff.metric_pixel(picture.tags)
    except ValueError as error:
        raise SourceError(f"{path}: {error}") from error


def _scale_text(*, own: bool, options: BuildOptions) -> str:
    """Say where the metres come from."""
    size = height = "the file's own"
    if not own:
        size, height = f"{DEFAULT_SIZE:g} m on the longer side by default", f"{DEFAULT_HEIGHT:g} m by default"
    if options.size is not None or options.pixel_size is not None:
        size = "as given"
    if options.height is not None:
        height = "as given"
    return size if size == height else f"size {size}, height {height}"


def _cropped(path: Path, pixels: NDArray[Any], crop: tuple[int, int, int, int] | None) -> NDArray[Any]:
    if crop is None:
        return pixels
    (col, row, width, height), (rows, cols) = crop, pixels.shape[:2]
    if col + width > cols or row + height > rows:
        raise SourceError(
            f"{path}: image is {cols}x{rows} px, a crop of {width}x{height} at {col},{row} lies not within it"
        )
    return pixels[row : row + height, col : col + width]


def _level_step(path: Path, pixels: NDArray[Any]) -> float:
    """Return the distance of neighbouring gray levels: 257 for 8 bits stored as 16."""
    if pixels.dtype.kind not in "iu":
        raise SourceError(f"{path}: holds floating-point heights, --deterrace needs gray levels")
    steps = np.diff(np.unique(pixels))
    return float(np.gcd.reduce(steps)) if len(steps) else 1.0


def _above_lowest(
    path: Path, pixels: NDArray[Any], nodata: float | None, options: BuildOptions
) -> Float32Array:
    """Return (rows, cols) values above the lowest one, every hole filled; an array of its own."""
    values = _gray(path, pixels, options.grayscale)
    # Unsigned levels hold no heights that mean "none", unless the file says so.
    if nodata is not None or pixels.dtype.kind != "u":
        values = _fill(path, values, nodata)
    if options.invert:
        np.negative(values, out=values)
    values -= values.min()
    return values.astype(np.float32, copy=False)


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
        raise SourceError(f"{path}: is in colour, a terrain needs a gray picture; --grayscale makes it gray")
    if not span.any():
        gray = pixels[..., 0].astype(kind)
        return gray
    gray = np.zeros(pixels.shape[:2], dtype=kind)
    for channel, weight in enumerate(LUMA):
        gray += pixels[..., channel] * float(weight)
    return gray


def _fill(path: Path, values: NDArray[np.floating[Any]], nodata: float | None) -> NDArray[np.floating[Any]]:
    """Give every pixel without a height that of the nearest pixel with one; warns how many."""
    missing = ~np.isfinite(values) | (values < -1e30)
    if nodata is not None:
        missing |= values == values.dtype.type(nodata)
    for value in UNTAGGED_NODATA:
        missing |= values == value
    count = int(missing.sum())
    if count == 0:
        return values
    share = f"{count} of {values.size} pixels have no height (NaN or nodata)"
    if count > values.size / 2:
        raise SourceError(f"{path}: {share}, at most half may lack one")
    warnings.warn(f"{path}: {share}, filled from their nearest neighbours", stacklevel=3)
    nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    filled: NDArray[np.floating[Any]] = values[tuple(nearest)]
    return filled


def _heights(above: Float32Array, unit: float | None, height: float | None, factor: float) -> Float32Array:
    """Turn values into metres above the lowest point, in place; a flat picture stays flat."""
    above -= above.min()
    relief = above.max()
    if relief > 0 and (unit is None or height is not None):
        # The division first: the top comes out as exactly `height`.
        above /= relief
        above *= np.float32(height or DEFAULT_HEIGHT)
    elif unit is not None:
        above *= np.float32(unit)
    above *= np.float32(factor)
    return above


def _extent(
    shape: tuple[int, ...], pixel: tuple[float, float] | None, options: BuildOptions
) -> tuple[float, float]:
    """Return width and depth of the ground, metres: the pixels are nodes, so one less than pixels."""
    rows, cols = shape[:2]
    sx, sy = pixel or (1.0, 1.0)
    if isinstance(options.size, tuple):
        return options.size
    if options.pixel_size is not None:
        sx = sy = options.pixel_size
    elif options.size is not None or pixel is None:
        factor = (options.size or DEFAULT_SIZE) / max((cols - 1) * sx, (rows - 1) * sy)
        sx, sy = sx * factor, sy * factor
    return (cols - 1) * sx, (rows - 1) * sy
