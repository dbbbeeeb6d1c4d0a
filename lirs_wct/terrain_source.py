"""A picture as a source: a file, or one of the bundled ones."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import cv2

from lirs_wct.bundled import SIZE, bundled_picture
from lirs_wct.heightfield import HeightField
from lirs_wct.image import read_height_field
from lirs_wct.options import BuildOptions
from lirs_wct.source import Source, SourceKind


def read_terrain(source: Source, options: BuildOptions) -> HeightField:
    """Return the ground of a picture or of a bundled world (see `read_height_field`)."""
    if source.kind is SourceKind.BUNDLED:
        return _bundled_surface(str(source.path), options)
    return read_height_field(source.path, options)


def scale_in_words(source: Source, options: BuildOptions) -> str:
    """Say where the metres come from."""
    if source.kind is SourceKind.BUNDLED:
        return "as bundled" if not (options.size or options.pixel_size or options.height) else "as given"
    given = (options.size or options.pixel_size) is not None, options.height is not None
    return {
        (True, True): "as given",
        (False, False): "the file's own, else longer side 50 m, heights 6 m",
    }.get(given, "as given, the rest the file's own or the default")


def _bundled_surface(name: str, options: BuildOptions) -> HeightField:
    """Send a bundled picture down the way of every picture: through a file."""
    picture = bundled_picture(name)
    own = replace(
        options,
        size=options.size if options.size or options.pixel_size else SIZE,
        height=options.height or picture.height,
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.png"
        cv2.imwrite(str(path), picture.pixels, [cv2.IMWRITE_PNG_COMPRESSION, 0])
        return read_height_field(path, own)
