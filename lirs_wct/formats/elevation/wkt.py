"""Coordinate systems by their WKT, as far as they are known without PROJ: projection files, LAS headers."""

from __future__ import annotations

import re

from lirs_wct.geometry.geodesy.earth import CoordinateSystem

_NAMED = re.compile(r'(?:AUTHORITY|ID)\["EPSG",\s*"?(\d+)"?\]\]\s*$')
"""The code of the whole system, which stands last in its WKT."""
_UTM = re.compile(r"UTM[_ ]zone[_ ](\d+)[_ ]?([NS])", re.IGNORECASE)


def system_of_text(text: str) -> CoordinateSystem:
    """Return the coordinate system of a .prj file's WKT, as far as it is known without PROJ."""
    named = _NAMED.search(text)
    if named or "MERCATOR_AUXILIARY_SPHERE" in text.upper():
        return CoordinateSystem.of_code(int(named[1]) if named else 3857)
    zone = _UTM.search(text)
    if zone and "WGS" in text.upper():
        return CoordinateSystem.of_code((32600 if zone[2].upper() == "N" else 32700) + int(zone[1]))
    if zone and "ETRS" in text.upper():
        return CoordinateSystem.of_code(25800 + int(zone[1]))
    if text.lstrip().upper().startswith(("GEOGCS", "GEOGCRS")):
        known = {"WGS_1984": 4326, "NORTH_AMERICAN_1983": 4269, "ETRS": 4258}
        code = next((code for word, code in known.items() if word in text.upper().replace(" ", "_")), 0)
        return CoordinateSystem.of_code(code) if code else CoordinateSystem(text.strip(), "geographic")
    return CoordinateSystem(text.strip(), "other")
