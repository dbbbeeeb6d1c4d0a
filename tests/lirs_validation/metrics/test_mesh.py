"""The distance of a world's mesh from its surface."""

from dataclasses import replace

import numpy as np
import pytest

from lirs_validation.metrics.world_geometry import mesh_error
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.ground import MeshGround, Terrain
from lirs_wct.meshing.solid import solid_mesh
from lirs_wct.world import World


def test_the_largest_distance_up_or_down() -> None:
    z = np.random.default_rng(2).uniform(0, 1, (5, 8)).astype(np.float32)
    surface = HeightField(z, (0.5, 0.25), (3.0, -7.0))
    world = World("hill", Terrain(surface))
    assert mesh_error(world) == pytest.approx(0.0, abs=1e-6)
    for shift in (0.125, -0.25):
        moved = solid_mesh(surface)
        node = int(
            np.argmin(np.linalg.norm(moved.vertices - (4.0, -6.5, surface.height_at(4.0, -6.5)), axis=1))
        )
        vertices = moved.vertices.copy()
        vertices[node, 2] += shift
        bent = MeshGround(surface, TriangleMesh(vertices, moved.faces))
        assert mesh_error(replace(world, ground=bent)) == pytest.approx(abs(shift), abs=1e-6)
