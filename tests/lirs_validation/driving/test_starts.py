"""Where robots start: at the pose that was asked for, or where the largest that fits can drive."""

import math
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from lirs_envs.generators.terrain import EDGE, NATURAL_TERRAINS, NODES
from lirs_envs.robots.robot import make_robot
from lirs_envs.simulation_config import standing_pose
from lirs_validation.collision.drives import places
from lirs_validation.config import RunConfig
from lirs_validation.driving.choice import CLEARANCE, check_driver, make_driver, plan_tour
from lirs_validation.experiment.run import run
from lirs_validation.experiment.scenario import build_scenario
from lirs_wct.errors import ConfigError, SimulationError, SourceError
from lirs_wct.geometry import HeightField, OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import Terrain
from lirs_wct.sources.build import build_world
from lirs_wct.sources.source import BuildOptions
from lirs_wct.world import World


@pytest.fixture
def corridor(tmp_path: Path) -> Path:
    """A map picture of a corridor 1 m wide and 10 m long, with its YAML."""
    picture = np.zeros((40, 240), np.uint8)
    picture[10:30, 20:220] = 254
    cv2.imwrite(str(tmp_path / "corridor.png"), picture)
    (tmp_path / "corridor.yaml").write_text(
        "image: corridor.png\nresolution: 0.05\norigin: [-6, -1, 0]\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.25\nnegate: 0\n",
        encoding="utf-8",
    )
    return tmp_path / "corridor.yaml"


def no_map() -> OccupancyGrid:
    raise AssertionError("a tour needs no map")


def test_a_goal_is_reached_from_the_start_or_named(corridor: Path) -> None:
    config = RunConfig(source=str(corridor), robot="jackal", driver="goal:3,0", seconds=60)
    config = replace(config, build=replace(config.build, start=Pose2(-3.0, 0.0, 3.0)))
    found = run(config)
    assert found.log.truth[0].to_pose2().x == pytest.approx(-3.0, abs=0.01)
    end = found.log.truth[-1].to_pose2()
    assert math.hypot(end.x - 3.0, end.y) < 0.4
    assert found.record.reason.startswith("the last waypoint is reached at ")
    assert "-goal-s1-" in found.record.name
    with pytest.raises(SourceError, match=r"^goal:3,5: waypoint 2 \(3, 5\) is off the map"):
        run(replace(config, driver="goal:3,5"))


def test_the_pretrained_policy_drives_to_a_goal_and_repeats(corridor: Path) -> None:
    config = RunConfig(source=str(corridor), robot="jackal", driver="pretrained:0,0", seconds=60)
    config = replace(config, build=replace(config.build, start=Pose2(-3.0, 0.0, 3.0)))
    first = run(config)
    end = first.log.truth[-1].to_pose2()
    assert math.hypot(end.x, end.y) < 0.7
    assert first.record.reason.startswith("the last goal is reached at ")
    second = run(replace(config, seconds=2.0)).log.truth
    assert [p.to_pose2() for p in second] == [p.to_pose2() for p in list(first.log.truth)[: len(second)]]
    with pytest.raises(SourceError, match=r"^pretrained:3,5: waypoint 2 \(3, 5\) is off the map"):
        run(replace(config, driver="pretrained:3,5"))


@pytest.mark.parametrize("kind", ["goal", "pretrained"])
@pytest.mark.parametrize("goal", ["3", "3,4,5", "a,b", "nan,1"])
def test_a_bad_goal_is_refused_before_the_world_is_built(goal: str, kind: str) -> None:
    with pytest.raises(ConfigError, match=f"{kind}:X,Y"):
        check_driver(RunConfig(source="simple", driver=f"{kind}:{goal}"))


def test_who_does_not_fit_is_told_who_would(corridor: Path) -> None:
    world = build_world(corridor)
    with pytest.raises(ConfigError) as caught:
        make_driver(world, make_robot("husky"), RunConfig(source="corridor"), no_map)
    assert "no place for husky: it needs 1.5 m" in str(caught.value)
    assert "jackal, turtlebot2, turtlebot3_burger, turtlebot3_waffle would fit" in str(caught.value)
    assert "--size" not in str(caught.value)


def test_a_terrain_that_is_too_steep_names_the_limit(tmp_path: Path) -> None:
    ramp = np.tile(np.linspace(0, 255, 201).astype(np.uint8)[:, None], (1, 201))
    cv2.imwrite(str(tmp_path / "ramp.png"), ramp)
    world = build_world(tmp_path / "ramp.png", BuildOptions(size=6, height=6))
    assert world.spawn_poses == ()
    assert world.spawn_for == ""
    with pytest.raises(ConfigError, match=r"no place for husky: .* no steeper than \d+ deg; no other robot"):
        make_driver(world, make_robot("husky"), RunConfig(source="ramp"), no_map)


def test_the_start_that_was_asked_for_is_everyones(tmp_path: Path) -> None:
    start = Pose2(3.0, -4.0, 0.5)
    options = BuildOptions(start=start)
    world = build_scenario(RunConfig(source="simple", build=options)).world
    robot = make_robot("husky")
    for seed in (1, 2):
        config = RunConfig(source="simple", seed=seed, seconds=1, build=options)
        assert make_driver(world, robot, config, no_map).start == start
    assert places(world, robot, np.random.default_rng(0)) == [start]
    assert world.spawn_poses[0] == start
    kept = World.load(world.save(tmp_path / "kept"))
    assert kept.start == start
    assert build_world(tmp_path / "kept", BuildOptions(start=Pose2(1.0, 1.0))).start == Pose2(1.0, 1.0)


def test_a_start_where_nobody_can_stand_is_refused(corridor: Path) -> None:
    near = r"0,0\.45: it is 0\.05 m from a wall or a hole, .* needs 0\.29 m; nearest place: -?0\.05,0\.25 "
    with pytest.raises(ConfigError, match=near):
        build_world(corridor, BuildOptions(start=Pose2(0.0, 0.45)))
    build_world(corridor, BuildOptions(start=Pose2(-0.05, 0.25)))
    world = build_world(corridor, BuildOptions(start=Pose2(0.0, 0.0)))
    with pytest.raises(ConfigError, match=r"no place for husky: it needs 1\.5 m"):
        make_driver(world, make_robot("husky"), RunConfig(source="corridor"), no_map)
    with pytest.raises(SimulationError, match="husky cannot start"):
        places(world, make_robot("husky"), np.random.default_rng(0))
    with pytest.raises(ConfigError, match="a start must be finite"):
        BuildOptions(start=Pose2(math.nan, 0.0))


def test_a_refused_start_says_its_slope_and_the_nearest_place(tmp_path: Path) -> None:
    z = np.zeros((101, 101))
    z[:, 50:61] = np.arange(11) / 10
    z[:, 61:] = 1
    cv2.imwrite(str(tmp_path / "ramp.png"), (65535 * z).astype(np.uint16))
    options = BuildOptions(size=20, height=2 * math.tan(math.radians(34)))
    with pytest.raises(ConfigError) as caught:
        build_world(tmp_path / "ramp.png", replace(options, start=Pose2(1.0, 0.0)))
    said = str(caught.value)
    found = re.search(r"it is on ground of ([\d.]+) deg \(limit 30\); nearest place: (\S+) \(jackal\)", said)
    assert found, said
    assert float(found[1]) == pytest.approx(34, abs=1)
    free = build_world(tmp_path / "ramp.png", options).traversable(clearance=0.46, max_slope=math.radians(30))
    assert free.free_at(*map(float, found[2].split(",")))
    with pytest.raises(ConfigError, match=r"outside the world.*; nearest place: "):
        build_world(tmp_path / "ramp.png", replace(options, start=Pose2(11.0, 0.0)))


def test_a_robot_can_be_set_down_at_every_start() -> None:
    z = NATURAL_TERRAINS["rough hills"](np.random.default_rng(11)).astype(np.float32)
    cell = EDGE / (NODES - 1)
    world = World("rough", Terrain(HeightField.centered(z - z.min(), (cell, cell))))
    jackal = make_robot("jackal")
    config = RunConfig(source="rough", robot="jackal", seconds=1)
    free = world.traversable(clearance=jackal.radius + CLEARANCE, max_slope=jackal.max_slope)
    refused = 0
    for start in world.starts(free):
        try:
            standing_pose(world, jackal, start)
        except SimulationError:
            refused += 1
    assert refused
    for seed in range(1, 9):
        standing_pose(world, jackal, plan_tour(world, jackal, replace(config, seed=seed)).start)
