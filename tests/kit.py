"""What tests of several packages share."""

import numpy as np

from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.meshing.solid import solid_mesh
from lirs_wct.sources.options import BuildOptions

SMALL = BuildOptions(size=(20.0, 20.0), height=2.0, resize=(129, 129))
"""Options that make of a bundled world one of 20 m and 129 x 129 pixels, which is built at once."""


def hills(rows: int = 40, cols: int = 60) -> TriangleMesh:
    """Return a closed mesh over rough heights of up to 1 m."""
    z = np.random.default_rng(5).random((rows, cols)).astype(np.float32)
    return solid_mesh(HeightField.centered(z - z.min(), (1.0, 0.8)))
