"""Coordinate systems by their WKT, as far as they are known without PROJ: projection files, LAS headers."""

from __future__ import annotations

import re

from lirs_wct.geometry.geodesy.earth import CoordinateSystem

_NAMED = re.compile(r'(?:AUTHORITY|ID)\["EPSG",\s*"?(\d+)"?\]\]\s*$')
"""The code of the whole system, which stands last in its WKT."""
_UTM = re.compile(r"UTM[_ ]zone[_ ](\d+)[_ ]?([NS])", re.IGNORECASE)

_UNIT = re.compile(r'(?:LENGTH)?UNIT\["([^"]*)",\s*([0-9.eE+-]+)')
_VERTICAL = re.compile(r"VERT_?CR?S\[")


def units_of_text(text: str) -> tuple[float, float]:
    """Return meters a unit of x and y, and of z, by a projected system's WKT.

    Where it says nothing of z, that is in the unit of x and y.
    """
    plane, _, upright = text.partition(found[0] if (found := _VERTICAL.search(text)) else "\0")
    # The last is the system's own: those of its angles, ellipsoid and parameters stand before it.
    lengths, heights = (
        [float(size) for name, size in _UNIT.findall(part) if not name.lower().startswith(("deg", "rad"))]
        for part in (plane, upright)
    )
    unit = lengths[-1] if lengths else 1.0
    return unit, heights[-1] if heights else unit


def system_of_text(text: str) -> CoordinateSystem:
    """Return the coordinate system of a .prj file's WKT, as far as it is known without PROJ."""
    named = _NAMED.search(text)
    if named or "MERCATOR_AUXILIARY_SPHERE" in text.upper():
        return CoordinateSystem.of_code(int(named[1]) if named else 3857, units_of_text(text)[0])
    zone = _UTM.search(text)
    if zone and "WGS" in text.upper():
        return CoordinateSystem.of_code((32600 if zone[2].upper() == "N" else 32700) + int(zone[1]))
    if zone and "ETRS" in text.upper():
        return CoordinateSystem.of_code(25800 + int(zone[1]))
    if text.lstrip().upper().startswith(("GEOGCS", "GEOGCRS")):
        known = {"WGS_1984": 4326, "NORTH_AMERICAN_1983": 4269, "ETRS": 4258}
        code = next((code for word, code in known.items() if word in text.upper().replace(" ", "_")), 0)
        return CoordinateSystem.of_code(code) if code else CoordinateSystem(text.strip(), "geographic")
    return CoordinateSystem(text.strip(), "other", units_of_text(text)[0])
