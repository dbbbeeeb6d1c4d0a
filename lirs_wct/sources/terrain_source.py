"""A picture as a source: a file, or one of the bundled ones."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import cv2

from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.sources.bundled import SIZE, bundled_picture
from lirs_wct.sources.options import BuildOptions
from lirs_wct.sources.picture import read_height_field, read_scaled
from lirs_wct.sources.source import Source, SourceKind


def read_terrain(source: Source, options: BuildOptions) -> tuple[HeightField, str]:
    """Return the ground of a picture or of a bundled world, and where its metres come from, in words."""
    if source.kind is not SourceKind.BUNDLED:
        return read_scaled(source.path, options)
    resized = options.size or options.pixel_size or options.height
    return _bundled_surface(str(source.path), options), "as given" if resized else "as bundled"


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
