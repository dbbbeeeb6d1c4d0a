"""Names of the contact geometries."""

from typing import Literal, get_args

ContactGeometry = Literal["hfield", "mesh", "prisms", "convex"]
CONTACT_GEOMETRIES: tuple[ContactGeometry, ...] = get_args(ContactGeometry)
"""Contact as a height field; as a height field with a visible mesh; as prisms; as convex parts."""
