"""Names of the contact geometries, and the check that one fits a world."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

from lirs_wct.errors import ConfigError, unknown_name

if TYPE_CHECKING:
    from lirs_wct.world import World

ContactGeometry = Literal["hfield", "mesh", "prisms", "convex"]
CONTACT_GEOMETRIES: tuple[ContactGeometry, ...] = get_args(ContactGeometry)
"""Contact as a height field; as a height field with a visible mesh; as prisms; as convex parts."""


def check_contact_geometry(geometry: str, world: World) -> None:
    """Check that a contact geometry fits a world.

    Raises:
        ConfigError: the geometry is unknown or does not fit the world.
    """
    if geometry not in CONTACT_GEOMETRIES:
        raise unknown_name("terrain for MuJoCo", geometry, CONTACT_GEOMETRIES)
    if world.walls is not None and geometry in ("prisms", "convex"):
        raise ConfigError(
            f"{world.name}: a laser map's walls are convex boxes already; legal terrains: hfield, mesh"
        )
    if world.overhangs and geometry != "convex":
        raise ConfigError(f"{world.name}: has overhangs, which terrain {geometry} cannot hold; take convex")
    if geometry == "convex" and world.solid is None:
        raise ConfigError(f"{world.name}: terrain convex is for closed meshes; take hfield, mesh or prisms")
