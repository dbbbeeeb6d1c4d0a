"""A true mesh cut into convex parts, body by body."""

import numpy as np
import pytest
import trimesh

from lirs_wct.contact.contact_parts import bodies, convex_parts
from lirs_wct.geometry.mesh import TriangleMesh


@pytest.fixture
def overlapping() -> TriangleMesh:
    """A slab with four boxes sunk into it, two of them into each other."""
    slab = trimesh.creation.box((10, 10, 1))
    boxes = [trimesh.creation.box((2, 2, 3)).apply_translation((x, 0, 1)) for x in (-3, -2, 0, 3)]
    whole = trimesh.util.concatenate([slab, *boxes])
    return TriangleMesh(np.asarray(whole.vertices, np.float64), np.asarray(whole.faces, np.int32))


def test_bodies_are_closed_and_together_the_mesh(overlapping: TriangleMesh) -> None:
    pieces = list(bodies(overlapping))
    assert [len(piece.faces) for piece in pieces] == [12] * 5
    assert all(piece.is_watertight for piece in pieces)
    assert sum(piece.volume for piece in pieces) == pytest.approx(overlapping.volume)


def test_overlapping_bodies_come_apart(overlapping: TriangleMesh) -> None:
    """All at once, CoACD crashed or did not come to an end."""
    pytest.importorskip("coacd", reason="coacd, the extra [mesh], is not installed")
    parts = list(convex_parts(overlapping))
    assert len(parts) == 5
    low = np.array([part.min(axis=0) for part in parts])
    assert low[:, 2].min() == pytest.approx(-0.5)
    volumes = sorted(trimesh.convex.convex_hull(part).volume for part in parts)
    np.testing.assert_allclose(volumes, [12, 12, 12, 12, 100], rtol=1e-6)
