"""Tiles: together the mesh, none too large, no cracks."""

import numpy as np
import trimesh

from lirs_wct.geometry.mesh import split_tiles
from lirs_wct.meshing.uv import cube_uv
from tests.kit import hills


def test_tiles_are_the_mesh() -> None:
    mesh = hills()
    tiles = list(split_tiles(mesh, aim=400))
    assert len(tiles) > 8
    together = np.concatenate([t.vertices[t.faces] for t in tiles])
    order = np.lexsort(together.reshape(-1, 9).T)
    corners = mesh.vertices[mesh.faces]
    np.testing.assert_array_equal(together[order], corners[np.lexsort(corners.reshape(-1, 9).T)])
    joined = trimesh.util.concatenate([trimesh.Trimesh(t.vertices, t.faces) for t in tiles])
    joined.merge_vertices()
    assert joined.is_watertight


def test_tiles_hold_no_vertex_twice_or_in_vain() -> None:
    for tile in split_tiles(hills(), aim=400):
        assert set(tile.faces.ravel()) == set(range(len(tile.vertices)))
        assert len(np.unique(tile.vertices, axis=0)) == len(tile.vertices)
        assert len(tile.faces) < 1200


def test_never_more_than_the_cap() -> None:
    sizes = [len(t.faces) for t in split_tiles(hills(), aim=10**9, most=1000)]
    assert max(sizes) == 1000
    assert sum(sizes) == len(hills().faces)


def test_attributes_go_along() -> None:
    mesh = cube_uv(hills())
    assert mesh.uv is not None
    assert mesh.normals is not None
    kept = np.concatenate((mesh.vertices, mesh.uv, mesh.normals), axis=1)
    seen = []
    for tile in split_tiles(mesh, aim=400):
        assert tile.normals is not None
        assert tile.uv is not None
        seen.append(np.concatenate((tile.vertices, tile.uv, tile.normals), axis=1)[tile.faces])
    together, whole = np.concatenate(seen).reshape(-1, 24), kept[mesh.faces].reshape(-1, 24)
    np.testing.assert_array_equal(together[np.lexsort(together.T)], whole[np.lexsort(whole.T)])
