"""Files rebuilt from public bug reports: each gives its right world, or one line that names the fault."""

import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_wct import BuildOptions, World, build_world
from tests.kit import refused

pytestmark = pytest.mark.shared
Check = Callable[[World], bool]


def near(*expected: float, rel: float = 2e-3) -> Any:
    return pytest.approx(expected, rel=rel, abs=1e-3)


def extent(world: World) -> tuple[float, ...]:
    return tuple(np.ptp(world.solid.bounds, axis=0).tolist())


def area(world: World) -> float:
    return float(world.solid.face_areas.sum())


def cells(world: World) -> tuple[int, int]:
    return int(world.truth.occupied.sum()), int(world.truth.free.sum())


def size(world: World) -> tuple[float, ...]:
    return (*world.surface.size, world.surface.relief)


# file: options, what the world is, words of the lines about it
WORLDS: dict[str, tuple[dict[str, Any], Check, tuple[str, ...]]] = {
    "door_ngon.obj": ({}, lambda w: area(w) == pytest.approx(23.6) and extent(w) == near(4, 0.2, 3), ()),
    "door_polylist.dae": ({}, lambda w: area(w) == pytest.approx(23.6) and extent(w) == near(4, 0.2, 3), ()),
    "window_ph.dae": ({}, lambda w: area(w) == pytest.approx(25.6) and w.mesh.is_watertight, ()),
    "far_mesh.obj": (
        {},
        lambda w: size(w) == near(20, 20, 0.399, rel=2e-2) and w.place is not None,
        ("lies far", "is not closed"),
    ),
    "far_map.yaml": ({}, lambda w: cells(w)[0] == 276 and w.mesh.is_watertight_as_written, ("lies far",)),
    "alpha_065.yaml": ({}, lambda w: cells(w)[0] == 232, ("2,632 and",)),
    "alpha_090.yaml": ({}, lambda w: cells(w)[0] == 232, ("Humble and ROS 1",)),
    "raw_alpha.yaml": ({}, lambda w: cells(w)[0] == 80, ()),
    "maxval_100.yaml": ({}, lambda w: cells(w) == (59, 1541), ()),
    "maxval_1023.yaml": ({}, lambda w: cells(w) == (59, 1541), ()),
    "hole_-32767.tif": ({}, lambda w: size(w) == near(99, 79, 20), ("-32767 among them: an isolated level",)),
    "hole_9999.tif": ({}, lambda w: size(w) == near(99, 79, 20), ("9999 among them: an isolated level",)),
    "nocrs_1cm.tif": ({}, lambda w: size(w) == near(0.99, 0.79, 0.2), ("usual are 1 m",)),
    "nocrs_2arcmin.tif": (
        {},
        lambda w: size(w) == near(252_541, 292_733, 20),
        ("taken for degrees", "100 km"),
    ),
    "worldfile.tif": ({}, lambda w: size(w) == near(198, 158, 20), ()),
    "feet_2263.tif": ({}, lambda w: size(w) == near(90.53, 72.24, 6.096), ("its heights have no unit",)),
    "feet_2263.las": (
        {},
        lambda w: size(w) == near(92.2, 72.3, 6.07),
        ("lies far", "its heights have no unit", "nodes at 1.81 m have no point"),
    ),
    "geotiff_named.dem": ({}, lambda w: size(w) == near(99.04, 79.03, 20), ()),
    "strip.tif": (
        {"window": (0.0, 0.0, 20.0)},
        lambda w: size(w)[0] == pytest.approx(20, abs=1.1),
        ("4191 of",),
    ),
    "oldprj.asc": ({}, lambda w: size(w) == near(6501, 7316, 20), ()),
    "quantn.glb": ({}, lambda w: extent(w) == near(2, 1, 3), ()),
    "negidx.obj": (
        {},
        lambda w: extent(w) == near(12, 3, 1) and len(w.mesh.faces) == 36,
        ("have no ground",),
    ),
    "mat_partial.dae": ({}, lambda w: extent(w) == near(12, 3, 1), ("have no ground",)),
    "ctl.dae": (
        {},
        lambda w: extent(w) == near(12, 3, 1) and len(w.mesh.faces) == 24,
        ("skin `c` is read as its plain shape", "have no ground"),
    ),
    "tab.obj": ({}, lambda w: len(w.mesh.faces) == 12, ()),
    "trail.stl": ({}, lambda w: len(w.mesh.faces) == 12, ()),
    "yaml_swapped.yaml": (
        {},
        lambda w: cells(w)[0] == 206,
        ("occupied_thresh 0.1 is below free_thresh 0.9",),
    ),
    "yaml_nested.yaml": ({}, lambda w: cells(w)[0] == 206, ()),
    "yaml_mode_case.yaml": ({}, lambda w: cells(w)[0] == 206, ()),
    "yup.obj": ({"up": "y"}, lambda w: size(w) == near(20, 20, 1.6, rel=1e-2), ("is not closed",)),
    "grid.xyz": ({}, lambda w: size(w) == near(99, 79, 20), ()),
}
REFUSED = {
    "draco.glb": "KHR_draco_mesh_compression",
    "node_missing.dae": "nonode",
    "wall_diagonal.pcd": "are a line or a vertical sheet in plan",
    "strip.tif": "4191 of 8000 pixels have no height",
}


@pytest.mark.parametrize("name", WORLDS)
def test_the_right_world(name: str, shared_data: Path) -> None:
    options, right, words = WORLDS[name]
    with warnings.catch_warnings(record=True, action="always") as told:
        world = build_world(shared_data / "reports" / "worlds" / name, BuildOptions(**options))
    lines = [str(warning.message) for warning in told if warning.category is UserWarning]
    assert right(world)
    assert all(any(word in line for line in lines) for word in words), lines
    assert len(lines) == len(words), lines


@pytest.mark.parametrize("name", REFUSED)
def test_one_line_names_the_fault(name: str, shared_data: Path) -> None:
    path = shared_data / "reports" / "worlds" / name
    with refused(f"{path}: ", re.escape(REFUSED[name])):
        build_world(path)


def test_y_up_is_suggested(shared_data: Path) -> None:
    with pytest.warns(UserWarning, match=r"Y up\? --up y"):
        build_world(shared_data / "reports" / "worlds" / "yup.obj")
