"""The lidar for any MuJoCo model: against brute force, and what it leaves alone."""

import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from lirs_envs.lidar import TerrainLidar
from lirs_envs.lidar.presets import LIDARS
from lirs_wct.errors import ConfigError, SimulationError
from tests.kit import refused
from tests.lirs_envs.lidar.foreign_models import NAMES, Array, BruteForce, model_of, place, random_beams

DOWN = np.array(((0.0, 0.0, -1.0),))


def misses(name: str, poses: int, beams: int) -> tuple[int, int]:
    """Return how many beams differ from brute force by more than 1e-6 of the range, and how many have one."""
    model, rng, wrong, met = model_of(name), np.random.default_rng(NAMES.index(name)), 0, 0
    brute, pattern = BruteForce(model, model_of(name, fields=False)), random_beams(beams, rng)
    lidar = TerrainLidar(model, "lidar", pattern)
    for _ in range(poses):
        data = place(model, rng)
        expected, found = brute.ranges(data, pattern), lidar.trace(data)
        both = np.isfinite(expected)
        wrong += int((np.isfinite(found) != both).sum())
        wrong += int((np.abs(found[both] - expected[both]) > 1e-6 * expected[both]).sum())
        met += int(both.sum())
    return wrong, met


@pytest.mark.parametrize("name", NAMES)
def test_no_beam_misses_what_brute_force_hits(name: str) -> None:
    wrong, met = misses(name, 10, 100)
    assert wrong == 0
    assert met > 150


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_twenty_thousand_beams_a_model(name: str) -> None:
    assert misses(name, 50, 400)[0] == 0


def hills(**geom: str) -> mujoco.MjModel:
    """Return a square field of 400 cells a side, where bundles of beams go together, below a lidar."""
    attributes = " ".join(f'{key}="{value}"' for key, value in geom.items())
    model = mujoco.MjModel.from_xml_string(f"""
      <mujoco><asset>
        <hfield name="h" nrow="401" ncol="401" size="8 8 1 .1"/><material name="glass" rgba="1 1 1 0"/>
      </asset><worldbody><geom type="hfield" hfield="h" {attributes}/>
      <body name="robot" pos="0 0 1.5"><freejoint/><geom size=".1"/><site name="lidar"/>
        <body name="arm" pos=".4 0 0"><geom name="arm" size=".1"/></body></body></worldbody></mujoco>""")
    x = np.linspace(0, 20, 401)
    model.hfield_data[:] = (0.5 + 0.25 * (np.sin(x)[:, None] + np.cos(1.3 * x))).ravel()
    return model


def settled(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def test_from_above_a_square_field_it_agrees_with_mujoco() -> None:
    model = hills()
    data = settled(model)
    pattern = LIDARS["os1_32"].all_directions[5::337]
    found, rays = TerrainLidar(model, "lidar", pattern).trace(data), np.empty(len(pattern))
    geoms, beams = np.empty(len(pattern), np.int32), pattern.ravel()
    mujoco.mj_multiRay(
        model, data, data.site_xpos[0], beams, None, True, 1, geoms, rays, None, len(pattern), 1e9
    )
    rays[geoms < 0] = np.inf
    np.testing.assert_allclose(found, rays, rtol=1e-9)
    assert 0.3 < np.isfinite(rays).mean() < 1


def arrays(thing: Any) -> dict[str, bytes]:
    names = [name for name in dir(thing) if not name.startswith("_")]
    values = {name: getattr(thing, name) for name in names if name not in ("contact", "model")}
    return {name: value.tobytes() for name, value in values.items() if isinstance(value, np.ndarray)}


@pytest.mark.parametrize("name", ["arm-several", "rover-moving"])
def test_model_and_data_stay_as_they_are(name: str) -> None:
    model = model_of(name)
    data = place(model, np.random.default_rng(3))
    before = arrays(model), arrays(data)
    assert len(before[0]) > 300
    assert len(before[1]) > 50
    TerrainLidar(model, "lidar", "vlp16", noise="datasheet", rng=np.random.default_rng(0)).trace(data)
    assert (arrays(model), arrays(data)) == before


def test_beams_pass_through_what_mujoco_looks_through() -> None:
    """Own body, other bodies by name, groups, and transparent geoms and materials."""
    ahead = np.array(((1.0, 0.0, 0.0), (0.0, 0.0, -1.0)))

    def seen(model: mujoco.MjModel, **options: Any) -> Array:
        return TerrainLidar(model, "lidar", ahead, **options).trace(settled(model))

    ground = 1.5 - 0.75 + 0.25 * (1 - np.sin(10) - np.cos(13))
    np.testing.assert_allclose(seen(hills()), (0.3, ground), rtol=1e-3)
    assert seen(hills(), exclude=["robot", "arm"])[0] == np.inf
    assert seen(hills(), exclude=[])[1] == pytest.approx(0.1)
    assert seen(hills(group="3"), groups=[0])[1] == np.inf
    assert seen(hills(group="3"), groups=[3])[0] == np.inf
    assert seen(hills(rgba="1 1 1 0"))[1] == np.inf
    assert seen(hills(material="glass"))[1] == np.inf
    assert seen(hills(), exclude=["world", "robot"])[1] == np.inf


@pytest.mark.parametrize(
    ("exclude", "seen"),
    [
        (None, [0.9, 0.9, 4.9]),
        ("trunk", [np.inf, np.inf, 4.9]),
        (["trunk", "foot"], [np.inf, np.inf, 4.9]),
        (1, [np.inf, np.inf, 4.9]),
        ("world", [0.1, 0.1, 0.1]),
        (np.array((1, 2)), [np.inf, np.inf, 4.9]),
        ([1, 2, 4], [np.inf, np.inf, 4.9]),
        (["trunk", "", ""], [np.inf, np.inf, np.inf]),
        ([1, "", "world"], [np.inf, np.inf, np.inf]),
        ((body for body in (2, 1)), [np.inf, np.inf, 4.9]),
    ],
)
def test_excluded_bodies_take_those_below_with_them(exclude: Any, seen: list[float]) -> None:
    """A trunk with two legs that have no name, one with a foot, and a stone without a name.

    Where the site's own body is not among them, beams end in it.
    """
    leg = '<body pos="{} 0 0"><joint axis="0 1 0"/><geom size=".1"/>{}</body>'
    foot = '<body name="foot" pos="1 0 0"><geom size=".1"/></body>'
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="trunk"><freejoint/><geom size=".1"/><site name="lidar"/>'
        + leg.format(1, foot)
        + leg.format(-1, "")
        + '</body><body pos="0 5 0"><geom size=".1"/></body></worldbody></mujoco>'
    )
    beams = np.array([(1.0, 0, 0), (-1.0, 0, 0), (0, 1.0, 0)])
    found = TerrainLidar(model, "lidar", beams, exclude=exclude).trace(settled(model))
    np.testing.assert_allclose(found, seen)


def test_poses_that_are_not_computed_are_refused() -> None:
    model = hills()
    data, lidar = mujoco.MjData(model), TerrainLidar(model, "lidar", DOWN)
    with pytest.raises(SimulationError, match="mj_kinematics"):
        lidar.trace(data)
    mujoco.mj_kinematics(model, data)
    exact = lidar.trace(data)
    data.site_xmat[:] = data.site_xmat * (1 + 3e-6)  # of a program that computes in float32
    np.testing.assert_allclose(lidar.trace(data), exact, rtol=1e-4)
    other = settled(model)
    mujoco.mj_resetData(model, other)
    with pytest.raises(SimulationError, match="mj_kinematics"):
        lidar.trace([data, other])


def test_noise_of_a_device_by_name() -> None:
    model = hills()
    data, pattern = settled(model), np.repeat(DOWN, 20_000, axis=0)
    exact = TerrainLidar(model, "lidar", pattern).trace(data)[0]

    def drawn(seed: int) -> Array:
        rng = np.random.default_rng(seed)
        return TerrainLidar(model, "lidar", pattern, noise="rplidar_a1", rng=rng).trace(data)

    found = drawn(1)
    np.testing.assert_array_equal(found, drawn(1))
    assert np.nanstd(found) == pytest.approx(0.01 * exact, rel=0.03)
    assert np.isnan(found).mean() == pytest.approx(0.01, rel=0.3)
    up = TerrainLidar(model, "lidar", -pattern, noise="rplidar_a1", rng=np.random.default_rng(0)).trace(data)
    assert (np.isnan(up) | (up == np.inf)).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"site": "lidr"}, "unknown site 'lidr'; legal: lidar"),
        ({"site": 4}, "unknown site '4'"),
        ({"pattern": "vlp17"}, "did you mean vlp16"),
        ({"pattern": np.zeros((0, 3))}, "unit vectors"),
        ({"pattern": [1.0, 0.0, 0.0]}, "unit vectors"),
        ({"pattern": 1.0}, "unit vectors"),
        ({"pattern": [(2.0, 0.0, 0.0)]}, "length 1, got 2"),
        ({"pattern": [(np.nan, 0.0, 0.0)]}, "length 1, got nan"),
        ({"noise": "datasheet"}, "needs rng"),
        ({"noise": "simulated", "pattern": DOWN}, "name the device"),
        ({"noise": "sick"}, "unknown noise 'sick'"),
        ({"range_min": 2.0, "range_max": 1.0}, "got 2 and 1 m"),
        ({"exclude": ["leg"]}, "unknown body 'leg'"),
        ({"exclude": "leg"}, "unknown body 'leg'"),
        ({"exclude": [1, 9]}, "unknown body '9'"),
        ({"exclude": -1}, "unknown body '-1'"),
        ({"exclude": [1.5]}, "unknown body '1.5'"),
        ({"exclude": 1.5}, "unknown body '1.5'"),
        ({"groups": [6]}, "0 to 5"),
    ],
)
def test_bad_arguments_get_one_line(options: dict[str, Any], message: str) -> None:
    arguments = {"site": "lidar", "pattern": "vlp16"} | options
    with refused(words=message, kind=ConfigError):
        TerrainLidar(hills(), **arguments)


def test_data_of_another_model_and_lost_poses_are_refused() -> None:
    model = hills()
    lidar = TerrainLidar(model, "lidar", DOWN)
    with pytest.raises(ConfigError, match="1 sites and 3 geoms, got 1 and 10"):
        lidar.trace(place(model_of("drone-long"), np.random.default_rng(0)))
    data = settled(model)
    data.site_xpos[0, 2] = np.nan
    with pytest.raises(SimulationError, match="finite"):
        lidar.trace(data)


def test_the_program_of_the_how_to_runs() -> None:
    page = Path(__file__).parents[3] / "docs" / "howto" / "lidar_for_your_quadruped.md"
    program = re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)[0]
    names: dict[str, Any] = {}
    exec(program, names)
    assert names["ranges"].shape == (32 * 1024,)
    assert 0.3 < np.isfinite(names["ranges"]).mean() < 0.9
