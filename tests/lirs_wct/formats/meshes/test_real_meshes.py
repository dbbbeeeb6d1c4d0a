"""Meshes of other programs have the extent, area and triangles that they state, also by Assimp."""

import shutil
import subprocess
import warnings
from pathlib import Path

import numpy as np
import pytest

from lirs_wct.errors import SourceError
from lirs_wct.formats.meshes.mesh_reader import read_mesh, read_upright
from lirs_wct.formats.suffixes import MESHES
from lirs_wct.geometry.mesh import TriangleMesh

CASES = {
    "door_ngon.obj": ((4, 0.2, 3), 28, 23.6),
    "door_polylist.dae": ((4, 0.2, 3), 28, 23.6),
    "window_ph.dae": ((4, 0.2, 3), 32, 25.6),
    "negidx.obj": ((12, 3, 1), 36, 66),
    "tab.obj": ((2, 3, 1), 12, 22),
    "trail.stl": ((2, 3, 1), 12, 22),
    "mat_partial.dae": ((12, 3, 1), 24, 44),
    "ctl.dae": ((12, 3, 1), 24, 44),
    "quantn.glb": ((2, 1, 3), 12, 22),
}
"""Size, triangles and area."""
WRONG = {
    "quantn.glb": "does not scale normalized integers",
    "trail.stl": "refuses bytes behind the triangles",
    "window_ph.dae": "refuses holes",
    "draco.glb": "is refused by both",
    "node_missing.dae": "leaves the missing node out",
}
"""Files in which Assimp 5.2 is no oracle, and the reason."""


def area(mesh: TriangleMesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2


@pytest.mark.shared
@pytest.mark.parametrize("name", CASES)
def test_reported_files(shared_data: Path, name: str) -> None:
    size, triangles, expected = CASES[name]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*(left out|plain shape)")
        mesh = read_upright(shared_data / "reports/worlds" / name)
    np.testing.assert_allclose(np.ptp(mesh.bounds, axis=0), size, atol=1e-4)
    assert len(mesh.faces) == triangles
    assert area(mesh) == pytest.approx(expected, rel=1e-4)
    assert mesh.is_watertight


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "named"),
    [("draco.glb", "KHR_draco_mesh_compression"), ("node_missing.dae", "the node `nonode`")],
)
def test_refused_files(shared_data: Path, name: str, named: str) -> None:
    with pytest.raises(SourceError, match=f"{name}: .*{named}"):
        read_upright(shared_data / "reports/worlds" / name)


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
    for path in (p for p in sorted(shared_data.rglob("*")) if p.suffix.lower() in MESHES):
        if path.name in WRONG or path.stat().st_size > 5e6:
            continue
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", ".*(left out|plain shape)")
            mesh = read_mesh(path)
        other = by_assimp(path, tmp_path)
        sizes = [sorted(np.ptp(m.vertices[m.faces].reshape(-1, 3), axis=0)) for m in (mesh, other)]
        np.testing.assert_allclose(*sizes, rtol=1e-5, atol=1e-4, err_msg=path.name)
        assert len(mesh.faces) == len(other.faces), path.name
        assert area(mesh) == pytest.approx(area(other), rel=1e-4), path.name
