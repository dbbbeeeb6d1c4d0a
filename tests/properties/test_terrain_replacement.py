"""A simulation whose terrain was replaced equals one that was made with that terrain."""

import copy
import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lirs_envs.generators.terrain import HEIGHT_RANGE, KINDS, GeneratedTerrain, generate
from lirs_envs.lidar.ray_casting import mujoco_hits
from lirs_envs.robots.robot import Twist, make_robot
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.arrays import Float32Array
from lirs_wct.contact.spec import TERRAIN_GROUP
from lirs_wct.errors import ConfigError, SimulationError
from lirs_wct.geometry import HeightField
from lirs_wct.ground import Terrain
from lirs_wct.world import World

courses = st.builds(
    lambda kind, difficulty, seed: generate(kind, difficulty, np.random.default_rng(seed)),
    st.sampled_from(KINDS),
    st.floats(0, 1),
    st.integers(0, 2**31),
)


def simulation(terrain: GeneratedTerrain, robot: str = "husky", **config: object) -> Simulation:
    return Simulation(
        terrain.world(),
        SimulationConfig(robot=make_robot(robot), height_range=HEIGHT_RANGE, **config),  # type: ignore[arg-type]
    )


def driven(it: Simulation, ticks: int = 12) -> tuple[bytes, bytes]:
    scans = [it.reset().scan.ranges]
    scans += [it.advance(Twist(0.8, 0.6)).scan.ranges for _ in range(ticks)]
    return it.body.state().tobytes(), np.concatenate(scans).tobytes()


@settings(max_examples=8)
@given(courses, courses, st.sampled_from(["husky", "quadrotor"]))
def test_rays_and_physics_are_those_of_a_simulation_made_anew(
    first: GeneratedTerrain, second: GeneratedTerrain, robot: str
) -> None:
    replaced = simulation(first, robot)
    driven(replaced, ticks=2)
    replaced.replace_terrain(second.world())
    assert replaced.worlds[0].spawn_poses == (second.start,)
    fresh = simulation(second, robot)
    assert driven(replaced) == driven(fresh)
    assert replaced.body.contact == fresh.body.contact


@settings(max_examples=5)
@given(courses, st.integers(0, 1000))
def test_mujoco_sees_and_holds_the_heights_that_the_lidar_sees(course: GeneratedTerrain, seed: int) -> None:
    it = simulation(generate("waves", 0.5, np.random.default_rng(0)))
    it.replace_terrain(course.world())
    it.reset()
    surface, rng = course.surface, np.random.default_rng(seed)
    x, y = rng.uniform(-12, 12, (2, 200))
    origins = np.column_stack((x, y, np.full(200, 6.0)))
    down = np.tile((0.0, 0.0, -1.0), (200, 1))
    builtin = it.casters[0].ranges(origins, down, math.inf)
    assert 6.0 - builtin == pytest.approx(surface.height_at(x, y), abs=1e-6)
    touched = mujoco_hits(it.body.model, it.body.data, origins, down, math.inf, groups=(TERRAIN_GROUP,))[0]
    assert touched == pytest.approx(builtin, abs=1e-5)


def test_a_copy_keeps_its_terrain() -> None:
    first, second = (generate("gaps", 0.5, np.random.default_rng(seed)) for seed in (1, 2))
    it = simulation(first)
    before = driven(it)
    kept = copy.deepcopy(it)
    it.replace_terrain(second.world())
    assert driven(kept) == before
    assert driven(copy.deepcopy(it)) == driven(pickle.loads(pickle.dumps(it))) == driven(simulation(second))


def test_mujoco_rays_follow_the_terrain() -> None:
    first, second = (generate("stones", 0.8, np.random.default_rng(seed)) for seed in (1, 2))
    replaced = simulation(first, rays="mujoco", lidar="lds01")
    replaced.replace_terrain(second.world())
    assert driven(replaced, 3) == driven(simulation(second, rays="mujoco", lidar="lds01"), 3)


def world_of(heights: Float32Array) -> World:
    return World("flat", Terrain(HeightField.centered(heights, (0.1, 0.1))))


def test_what_does_not_fit_is_refused_and_changes_nothing() -> None:
    course = generate("waves", 0.5, np.random.default_rng(1))
    it = simulation(course)
    before = driven(it)
    with pytest.raises(ConfigError, match=r"heights must be \(257, 257\) nodes.*got \(129, 257\)"):
        it.replace_terrain(world_of(np.zeros((129, 257), np.float32)))
    with pytest.raises(ConfigError, match=r"within -2.8 to 3.4 m, the height range, got 0.000 to 9.000"):
        it.replace_terrain(world_of(np.float32(9) * np.eye(257, dtype=np.float32)))
    assert driven(it) == before
    it.replace_terrain(course.world())
    with pytest.raises(SimulationError, match="must be reset"):
        it.advance(Twist(0, 0))


def test_a_config_says_that_terrains_are_replaced() -> None:
    course, robot = generate("waves", 0.5, np.random.default_rng(1)), make_robot("husky")
    with pytest.raises(ConfigError, match="has no height range"):
        Simulation(course.world(), SimulationConfig(robot=robot)).replace_terrain(course.world())
    for bad in ((1.0, 1.0), (2.0, -1.0), (0.0, math.nan), (0.0,)):
        with pytest.raises(ConfigError, match="height_range must be"):
            SimulationConfig(robot=robot, height_range=bad)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="contact geometry hfield alone, got prisms"):
        SimulationConfig(robot=robot, height_range=HEIGHT_RANGE, contact_geometry="prisms")


def test_a_flat_world_has_room_for_hills() -> None:
    flat = world_of(np.zeros((257, 257), np.float32))
    it = Simulation(flat, SimulationConfig(robot=make_robot("husky"), height_range=HEIGHT_RANGE))
    course = generate("slopes", 1.0, np.random.default_rng(3))
    it.replace_terrain(course.world())
    assert driven(it) == driven(simulation(course))
