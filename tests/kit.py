"""What tests of several packages share."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.errors import SourceError, WctError
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.geometry.pose import Pose2
from lirs_wct.meshing.solid import solid_mesh
from lirs_wct.sources.build import build_world
from lirs_wct.sources.picture import read_terrain
from lirs_wct.sources.source import BuildOptions, Source, SourceKind
from lirs_wct.world import World

SMALL = BuildOptions(size=(20.0, 20.0), height=2.0, resize=(129, 129))
"""Options that make of a bundled world one of 20 m and 129 x 129 pixels, which is built at once."""


def hills(rows: int = 40, cols: int = 60) -> TriangleMesh:
    """Return a closed mesh over rough heights of up to 1 m."""
    z = np.random.default_rng(5).random((rows, cols)).astype(np.float32)
    return solid_mesh(HeightField.centered(z - z.min(), (1.0, 0.8)))


def read_heights(path: Path, **options: object) -> HeightField:
    """Return the heights of a picture file."""
    source = Source(SourceKind.PICTURE, path, "picture")
    return read_terrain(source, BuildOptions(**options))[0].surface  # type: ignore[arg-type]


def built(source: str | Path, **options: Any) -> tuple[World, list[str]]:
    """Return the world of a source, and the lines about it."""
    with warnings.catch_warnings(record=True, action="always") as told:
        world = build_world(source, BuildOptions(**options))
    return world, [str(warning.message) for warning in told if warning.category is UserWarning]


@contextmanager
def refused(start: object = "", words: str = "", kind: type[WctError] = SourceError) -> Iterator[Any]:
    """Check for an error of one line: it begins with the path and holds the words (a regular expression)."""
    with pytest.raises(kind, match=words) as error:
        yield error
    assert str(error.value).startswith(str(start))
    assert "\n" not in str(error.value)


def started(world: World, start: Pose2 | None = None, *, seed: int = 0, **config: Any) -> Simulation:
    """Return a simulation after its reset; the rest is of its config."""
    simulation = Simulation(world, SimulationConfig(**config), seed=seed)
    simulation.reset(start)
    return simulation
