"""Meshes of other programs have the extent, area and triangles that Assimp reads."""

import shutil
import subprocess
import warnings
from pathlib import Path

import numpy as np
import pytest

from lirs_wct.formats.meshes.reader import read_mesh
from lirs_wct.formats.suffixes import MESHES
from lirs_wct.geometry.mesh import TriangleMesh

WRONG = {
    "quantn.glb": "does not scale normalized integers",
    "trail.stl": "refuses bytes behind the triangles",
    "window_ph.dae": "refuses holes",
    "draco.glb": "is refused by both",
    "node_missing.dae": "leaves the missing node out",
}
"""Files in which Assimp 5.2 is no oracle, and the reason."""


def by_assimp(path: Path, folder: Path) -> TriangleMesh:
    tool = shutil.which("assimp")
    if tool is None:
        pytest.skip("assimp is not installed")
    out = folder / "out.obj"
    subprocess.run([tool, "export", path, out, "-tri"], check=True, capture_output=True)
    rows = [line.split() for line in out.read_text().splitlines()]
    faces = [[int(corner.split("/")[0]) - 1 for corner in row[1:]] for row in rows if row[:1] == ["f"]]
    places = [row[1:4] for row in rows if row[:1] == ["v"]]
    return TriangleMesh(np.array(places, np.float64), np.array(faces, np.int32))


@pytest.mark.shared
def test_assimp_reads_the_same(shared_data: Path, tmp_path: Path) -> None:
    files = [path for path in sorted(shared_data.rglob("*")) if path.suffix.lower() in MESHES]
    assert files
    for path in files:
        if path.name in WRONG or path.stat().st_size > 5e6:
            continue
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", ".*(left out|plain shape)")
            mesh = read_mesh(path)
        other = by_assimp(path, tmp_path)
        sizes = [sorted(np.ptp(m.vertices[m.faces].reshape(-1, 3), axis=0)) for m in (mesh, other)]
        np.testing.assert_allclose(*sizes, rtol=1e-5, atol=1e-4, err_msg=path.name)
        assert len(mesh.faces) == len(other.faces), path.name
        assert mesh.face_areas.sum() == pytest.approx(other.face_areas.sum(), rel=1e-4), path.name
