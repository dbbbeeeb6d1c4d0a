"""Gazebo's heightmap: a square 8-bit picture of 2^n + 1 pixels and the model that shows it.

What the paper compares its solid worlds with; 8 bits, since 16 read as infinite heights in Gazebo.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from lirs_wct.arrays import ByteArray
from lirs_wct.errors import ConfigError
from lirs_wct.formats.gazebo.sdf import VERSION, model_uri
from lirs_wct.formats.images.image_writer import write_image
from lirs_wct.geometry.grid_sampling import resized
from lirs_wct.geometry.heightfield import HeightField

SIDES = tuple(2**n + 1 for n in range(4, 13))
"""Legal pixels a side: 17 to 4097."""


def heightmap_side(surface: HeightField) -> int:
    """Return the smallest legal side that is not coarser than the surface, at most 4097."""
    side: int = next((side for side in SIDES if side >= max(surface.shape)), SIDES[-1])
    return side


def heightmap_pixels(surface: HeightField, side: int | None = None) -> ByteArray:
    """Return (side, side) gray levels: 0 is the lowest point, 255 the highest.

    Raises:
        ConfigError: side is not 2^n + 1.
    """
    side = side or heightmap_side(surface)
    if side not in SIDES:
        raise ConfigError(f"a heightmap has 2^n + 1 pixels a side, got {side}; legal: {SIDES}")
    above = surface.z - surface.z.min()
    levels = resized(above, side, side) * np.float32(255 / max(surface.relief, 1e-9))
    pixels: ByteArray = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    return pixels


def write_heightmap(path: Path, surface: HeightField, side: int | None = None) -> None:
    """Write the picture as PNG.

    Raises:
        ConfigError: side is not 2^n + 1.
        OutputError: the file cannot be written.
    """
    write_image(path, heightmap_pixels(surface, side))


@dataclass(frozen=True)
class Layer:
    """What a heightmap wears.

    Attributes:
        diffuse: path of the texture inside the package.
        normal: path of its normal map inside the package; `flat_normals` where it has none.
        span: meters that the texture spans before it repeats.
    """

    diffuse: str
    normal: str
    span: float


def flat_normals() -> ByteArray:
    """Return (16, 16, 3) BGR: the normal map of a texture that is flat (x 0, y 0, z 1)."""
    return np.full((16, 16, 3), (255, 128, 128), np.uint8)


def heightmap_sdf(name: str, surface: HeightField, picture: str, layer: Layer | None = None) -> str:
    """Return `model.sdf` of a heightmap model.

    Args:
        name: of the model and of its folder.
        surface: gives the meters.
        picture: path of the heightmap inside the package.
        layer: what it wears; None = Gazebo's gray.
    """
    width, depth = surface.size
    west, south, east, north = surface.bounds
    # Gazebo divides by the height: level ground gets a millimeter.
    size = f"<size>{width:.9g} {depth:.9g} {max(surface.relief, 1e-3):.9g}</size>"
    place = f"<pos>{(west + east) / 2:.9g} {(south + north) / 2:.9g} {float(surface.z.min()):.9g}</pos>"
    uri = f"<uri>{escape(model_uri(name, picture))}</uri>"
    look = ""
    if layer is not None:
        diffuse, normal = (escape(model_uri(name, path)) for path in (layer.diffuse, layer.normal))
        look = (
            f"<texture><diffuse>{diffuse}</diffuse><normal>{normal}</normal>"
            f"<size>{layer.span:.9g}</size></texture>"
        )
    return f"""<?xml version="1.0"?>
<sdf version="{VERSION}">
  <model name={quoteattr(name)}>
    <static>true</static>
    <link name="ground">
      <visual name="visual">
        <geometry><heightmap>{uri}{look}{size}{place}</heightmap></geometry>
      </visual>
      <collision name="collision">
        <geometry><heightmap>{uri}{size}{place}</heightmap></geometry>
      </collision>
    </link>
  </model>
</sdf>
"""
