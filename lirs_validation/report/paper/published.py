"""What the LIRS-WCT paper published of its experiments (Section V), as data."""

from __future__ import annotations

from typing import Final

HEIGHTMAP, SOLID, OURS = "heightmap-based", "solid-based", "ours"
VIEWS: Final = {HEIGHTMAP: ("hfield", "mujoco"), SOLID: ("mesh", "mujoco"), OURS: ("hfield", "builtin")}
"""Ways to represent a terrain: what is touched, and whose rays meet it. The first two are the paper's."""
MAPPERS: Final = {"gmapping": "GMapping", "hector": "HectorSLAM", "cartographer": "Cartographer"}
WORLDS: Final = {"simple": "II", "medium": "III", "advanced": "IV"}
"""Worlds, and the tables that hold their RTF."""
RTF: Final[dict[tuple[str, str, str], float]] = {
    ("medium", "gmapping", HEIGHTMAP): 0.04,
    ("medium", "gmapping", SOLID): 0.46,
    ("medium", "hector", HEIGHTMAP): 0.06,
    ("medium", "hector", SOLID): 0.64,
    ("medium", "cartographer", HEIGHTMAP): 0.05,
    ("medium", "cartographer", SOLID): 0.59,
    ("advanced", "gmapping", HEIGHTMAP): 0.010,
    ("advanced", "gmapping", SOLID): 0.42,
    ("advanced", "hector", HEIGHTMAP): 0.012,
    ("advanced", "hector", SOLID): 0.60,
    ("advanced", "cartographer", HEIGHTMAP): 0.011,
    ("advanced", "cartographer", SOLID): 0.57,
}
"""Tables III and IV, by world, mapper and view. Table II (`simple`) was printed without its values: lost."""
HUSKY = "husky"
"""Whose tables these are."""
ROBOT_MEANS: Final = {"husky": 0.38, "turtlebot2": 0.52, "jackal": 0.47}
"""Average RTF over the three methods (Section III-D)."""
COMFORTABLE = 0.3
"""Below this RTF the paper calls navigation infeasible (Section V-B)."""
