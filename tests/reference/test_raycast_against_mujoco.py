"""Our traversal against MuJoCo's own hfield rays, in general position and from outside the solid.

Elsewhere MuJoCo is no oracle: along the border, from inside the solid and on exact diagonals its rays
differ from the triangles.
"""

import mujoco
import numpy as np
import pytest

from lirs_envs.lidar.ray_casting import RayCaster, mujoco_hits
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import HeightField


def compiled(surface: HeightField) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = mujoco.MjSpec()
    rows, cols = surface.shape
    low, relief = float(surface.z.min()), surface.relief
    spec.add_hfield(
        name="ground",
        nrow=rows,
        ncol=cols,
        size=[surface.size[0] / 2, surface.size[1] / 2, relief, 0.5],
        userdata=((surface.south_up - low) / relief).ravel(),
    )
    west, south, east, north = surface.bounds
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname="ground",
        pos=[(west + east) / 2, (south + north) / 2, low],
        group=3,
    )
    body = spec.worldbody.add_body(name="ball", pos=[0.3, 0.2, 2.0])
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.25, 0, 0], group=1)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.fixture(scope="module")
def surface() -> HeightField:
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(np.linspace(0, 9, 61), np.linspace(0, 7, 47))
    z = np.sin(x) * np.cos(y) + 0.05 * rng.standard_normal(x.shape)
    return HeightField.centered((z + 0.7).astype(np.float32), (0.1, 0.13))


def test_equals_mujoco_from_above(surface: HeightField) -> None:
    model, data = compiled(surface)
    caster, rng = RayCaster(surface), np.random.default_rng(8)
    west, south, east, north = surface.bounds
    hits = 0
    for _ in range(20):
        xy = rng.uniform((west + 0.5, south + 0.5), (east - 0.5, north - 0.5))
        origin = np.array((*xy, float(surface.height_at(*xy)) + rng.uniform(0.05, 1.5)))
        d = rng.standard_normal((100, 3)) * (1.0, 1.0, 0.3) - (0.0, 0.0, 0.2)
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        theirs = mujoco_hits(model, data, origin, d, np.inf, groups=[3])[0]
        ours = caster.cast(origin, d)
        end = origin + d * np.where(np.isfinite(theirs), theirs, 0.0)[:, None]
        edge = np.minimum(abs(end[:, :2] - (west, south)), abs(end[:, :2] - (east, north))).min(axis=1)
        # Through the skirt and the base of MuJoCo's solid a ray does not see the surface.
        general = (edge > 1e-3) & np.isfinite(theirs)
        np.testing.assert_allclose(ours[general], theirs[general], atol=1e-5)
        hits += general.sum()
    assert hits > 800


def test_robots_and_props_by_mujoco(surface: HeightField) -> None:
    model, data = compiled(surface)
    origin = np.array((-2.0, 0.2, 2.0))
    ahead = np.array(((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0)))
    ranges = mujoco_hits(model, data, origin, ahead, 10.0)[0]
    assert ranges[0] == pytest.approx(2.05)
    assert ranges[1:].tolist() == [np.inf, np.inf], "the terrain's group is not seen"
    assert mujoco_hits(model, data, origin, ahead[:1], 2.0)[0][0] == np.inf
    assert mujoco_hits(model, data, origin, ahead[:1], 10.0, groups=[2])[0][0] == np.inf
    assert mujoco_hits(model, data, origin, np.empty((0, 3)), 10.0)[0].shape == (0,)
    with pytest.raises(ConfigError, match="0 to 5"):
        mujoco_hits(model, data, origin, ahead, 10.0, groups=[6])[0]
