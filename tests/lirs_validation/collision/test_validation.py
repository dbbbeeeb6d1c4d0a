"""Collision validation finds what it is for, and lets pass what is sound."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from lirs_envs.robot_model import RobotModel
from lirs_envs.robots.robot import ROBOTS, make_robot
from lirs_envs.simulation_config import SimulationConfig
from lirs_validation.cli.command import PROGRAM
from lirs_validation.collision.drives import PERIOD, ContactRecorder, Leg, climb
from lirs_validation.collision.validation import (
    CollisionVerdict,
    check_collisions,
    energy_gain,
    inside_test,
    penetrations,
    stuck_seconds,
    write_verdicts,
)
from lirs_validation.report.run_tables import verdicts_table
from lirs_wct.contact import ContactGeometry
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import HeightField, WallGrid
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.ground import LaserMap, Terrain
from lirs_wct.sources.build import build_world
from lirs_wct.world import World

Heights = Callable[[np.ndarray, np.ndarray], np.ndarray]


def terrain(z: Heights, nodes: int = 201, cell: float = 0.1) -> World:
    axis = (np.arange(nodes) - (nodes - 1) / 2) * cell
    x, y = np.meshgrid(axis, -axis)
    heights = np.broadcast_to(z(x, y), x.shape).astype(np.float32)
    return World("made-up", Terrain(HeightField.centered(heights, (cell, cell))), spawn_poses=(Pose2(),))


@pytest.fixture(scope="module")
def blocks() -> World:
    """Waves with blocks 1 m tall, 3 m apart, and a rim."""

    def z(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        waves = 0.2 * np.sin(x) * np.cos(y)
        block = (np.mod(x, 3.0) < 0.4) & (np.mod(y, 3.0) < 0.4) & (np.hypot(x, y) > 1.5)
        return np.where(block | (np.maximum(abs(x), abs(y)) > 9.5), 1.2, waves)

    return terrain(z)


def body_in(world: World, name: str, kind: ContactGeometry = "hfield") -> RobotModel:
    return RobotModel(world, SimulationConfig(robot=make_robot(name), contact_geometry=kind), PERIOD)


def left_alone(body: RobotModel, pose: Pose3, seconds: float) -> Leg:
    """Let a robot fall with its wheels held, every step noted."""
    body.settle(pose, seconds=0.0)
    body.ctrl[:] = 0.0
    recorder = ContactRecorder(body)
    for _ in range(round(seconds / body.timestep)):
        recorder.step()
    return recorder.leg()


@pytest.mark.parametrize(
    "name", ["husky", *(pytest.param(n, marks=pytest.mark.slow) for n in ROBOTS if n != "husky")]
)
def test_every_robot_among_blocks(name: str, blocks: World) -> None:
    verdict = check_collisions(blocks, make_robot(name), seconds=12.0, seed=1)
    assert verdict.passed, verdict.checks
    assert verdict.driven > 2
    assert verdict.legs >= 2
    assert verdict.force_peak > 0
    assert verdict.force_mean > 0


@pytest.mark.shared
@pytest.mark.parametrize(
    "path", ["height/vrc_driving_heightmap.png", "maps/navigation2/depot.yaml"], ids=["picture", "map"]
)
def test_real_worlds(path: str, shared_data: Path) -> None:
    verdict = check_collisions(build_world(shared_data / path), make_robot("husky"), seconds=8.0)
    assert verdict.passed, verdict.checks


def test_same_seed_same_verdict(blocks: World) -> None:
    first, again, other = (
        check_collisions(blocks, make_robot("jackal"), seconds=4.0, seed=seed) for seed in (1, 1, 2)
    )
    assert first == again
    assert first != other


def test_a_soft_ground_is_found_out(blocks: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tyres as soft as cushions sink in for good: too deep in most steps, whatever the impacts."""
    make = RobotModel.__init__

    def soft(self: RobotModel, *given: Any, **options: Any) -> None:
        make(self, *given, **options)
        self.model.geom_solref[:, 0] = 0.3

    monkeypatch.setattr(RobotModel, "__init__", soft)
    verdict = check_collisions(blocks, make_robot("husky"), seconds=4.0)
    assert not verdict.passed
    assert verdict.penetration_p999 > 0.010


def test_a_robot_under_the_ground_is_found_out(blocks: World) -> None:
    inside = inside_test(blocks, body_in(blocks, "husky"), "hfield")
    ground = float(blocks.surface.height_at(0.3, 0.2))
    points = np.array([(0.3, 0.2, ground + 0.01), (0.3, 0.2, ground - 0.02), (30.0, 0.0, -5.0)])
    assert inside(points).tolist() == [False, True, False]


def test_inside_of_walls_holes_and_floors() -> None:
    solid, hole = np.zeros((40, 40), np.bool_), np.zeros((40, 40), np.bool_)
    solid[20, :], hole[5, :] = True, True
    walls = WallGrid(solid, 0.1, Pose2(1.0, 2.0, 0.5), 1.5, hole)
    floor = HeightField(np.zeros((2, 2), np.float32), (8.0, 8.0), (-4.0, -1.0))
    world = World("walled", LaserMap(floor, walls))
    inside = inside_test(world, body_in(world, "turtlebot2"), "hfield")
    middle = walls.origin.apply(np.array([(2.0, 2.05), (2.0, 1.0), (2.0, 0.55), (9.0, 9.0)]))
    for z, expected in ((0.5, [True, False, False, False]), (-0.1, [True, True, False, False])):
        points = np.column_stack((middle, np.full(4, z)))
        assert inside(points).tolist() == expected
    assert not inside(np.array([(*middle[0], 1.6)])).any()


def test_energy_of_a_fall_is_kept_and_a_push_is_found_out() -> None:
    world = terrain(lambda x, y: 0.01 * (x > 9.9))
    body = body_in(world, "husky")
    weight = float(body.model.body_mass.sum()) * body.gravity
    leg = left_alone(body, Pose3(0.0, 0.0, 1.0), 1.5)
    gain = energy_gain([leg], weight)
    assert gain.ratio < 1
    assert energy_gain([leg], weight / 6).limit < gain.limit, "on the Moon"
    # By hand: all that the height gave is gone when it lies still.
    lost = weight * (leg.position[0, 2] - leg.position[-1, 2])
    assert leg.energy[0] - leg.energy[-1] == pytest.approx(lost, rel=0.02)
    # Work by no motor: 8 J a tenth of a second before the end.
    k = len(leg.energy) - 25
    pushed = leg.energy + np.where(np.arange(len(leg.energy)) >= k, 8.0, 0.0)
    assert energy_gain([replace(leg, energy=pushed)], weight).ratio > 1
    motors = replace(leg, energy=pushed, work=np.append(np.diff(pushed), 0.0))
    assert energy_gain([motors], weight).ratio < 1


def test_motors_work_is_what_the_robot_gains() -> None:
    """Speeding up on the level: kinetic energy is the motors' work less what slip takes, a few per cent."""
    world = terrain(lambda x, y: 0.01 * (x > 9.9))
    body, robot = body_in(world, "husky"), make_robot("husky")
    body.settle(Pose3(0.0, 0.0, robot.base_height), seconds=0.6)
    recorder = ContactRecorder(body)
    for k in range(150):
        speed = min(1.0, k / 100) / robot.wheel_radius
        body.ctrl[:] = speed
        recorder.step()
    leg = recorder.leg()
    work, gained = float(leg.work.sum()), float(leg.energy[-1] - leg.energy[0])
    assert gained > 0.5 * mass_of(body) * 0.9
    assert work == pytest.approx(gained, rel=0.1)
    assert work >= gained


def mass_of(body: RobotModel) -> float:
    return float(body.model.body_mass.sum())


def test_an_impact_may_go_as_deep_as_its_speed_allows() -> None:
    world = terrain(lambda x, y: 0.01 * (x > 9.9))
    body = body_in(world, "jackal")
    leg = left_alone(body, Pose3(0.0, 0.0, 2.0), 1.2)
    p999, peak = penetrations([leg])
    speed = math.sqrt(2 * 9.81 * (2.0 - 0.0635))
    assert peak.value > 0.010
    assert peak.limit == pytest.approx(0.010 * speed, rel=0.05)
    assert peak.ratio < 1
    assert p999 == pytest.approx(np.quantile(leg.depth, 0.999))
    # The same depths at a tenth of the speed are no impact.
    slow = replace(leg, velocity=leg.velocity / 10, spin=leg.spin / 10)
    assert penetrations([slow])[1].ratio > 1


def test_standing_before_a_wall_is_stuck() -> None:
    world = terrain(lambda x, y: 0.01 * (x > 9.9))
    leg = left_alone(body_in(world, "turtlebot2"), Pose3(0.0, 0.0, 0.02), 3.2)
    assert stuck_seconds([leg]) == 0
    assert stuck_seconds([replace(leg, commanded=np.full(len(leg.commanded), 0.5))]) == 3


def test_the_steepest_legal_slope_is_found_and_climbed() -> None:
    """A ramp of 20 deg, and one of 40 that no Husky may be set down on."""

    def z(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.maximum(x, 0) * np.where(y > 0, math.tan(math.radians(20)), math.tan(math.radians(40)))

    world, robot = terrain(z), make_robot("husky")
    found = climb(body_in(world, "husky"), world, robot)
    assert found is not None
    assert found.slope == pytest.approx(20, abs=1.5)
    assert found.slid < 0.05
    assert 0.8 < found.climbed < 1.1
    slippery = body_in(world, "husky")
    slippery.model.geom_friction[:, 0] = 0.2
    lost = climb(slippery, world, robot)
    assert lost is not None
    assert lost.slid > 0.05
    assert lost.climbed < 0.8


@pytest.mark.parametrize("name", [name for name, robot in ROBOTS.items() if not robot.flies])
def test_no_robot_slides_on_the_steepest_slope_that_it_drives(name: str) -> None:
    robot = make_robot(name)
    world = terrain(lambda x, y: math.tan(robot.max_slope - 1e-3) * (0.8 * x + 0.6 * y))
    found = climb(body_in(world, name), world, robot)
    assert found is not None
    assert found.slope == pytest.approx(math.degrees(robot.max_slope), abs=0.1)
    assert found.slid < 0.03
    assert 0.9 < found.climbed < 1.1


def test_nowhere_to_stand() -> None:
    steep = terrain(lambda x, y: 2.0 * x)
    with pytest.raises(ConfigError, match=r"made-up: no place for turtlebot2: it needs 0\.6 m of free"):
        check_collisions(steep, make_robot("turtlebot2"), seconds=1.0)


def test_bad_arguments(blocks: World) -> None:
    robot = make_robot("husky")
    for options, words in (
        ({"seconds": 0.0}, "seconds must be a finite number above 0"),
        ({"seconds": math.nan}, "seconds must be"),
        ({"seed": -1}, "seed must be a whole number at least 0"),
        ({"seed": "one"}, "seed must be a whole number"),
        ({"terrain": "mud"}, "'mud'; legal"),
    ):
        with pytest.raises(ConfigError, match=words):
            check_collisions(blocks, robot, **options)
    with pytest.raises(ConfigError, match="robot must be of type Robot"):
        check_collisions(blocks, "husky")  # type: ignore[arg-type]


def test_a_divergence_fails(blocks: World, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file where it stands
    step, calls = RobotModel.step, []

    def kick(self: RobotModel, steps: int) -> None:
        calls.append(1)
        if len(calls) == 500:
            self.data.qvel[0] = 1e20
        step(self, steps)

    monkeypatch.setattr(RobotModel, "step", kick)
    verdict = check_collisions(blocks, make_robot("husky"), seconds=10.0)
    assert not verdict.passed
    assert "diverged at" in verdict.diverged
    assert verdict.seconds < 10


def test_files_and_table(blocks: World, tmp_path: Path) -> None:
    good = check_collisions(blocks, make_robot("turtlebot3_burger"), seconds=2.0)
    bad = replace(good, seed=2, penetration_p999=0.02, inside_steps=3)
    folder, sheet = write_verdicts(tmp_path, [good, bad])
    entries = json.loads(folder.read_text())["collisions"]
    assert [entry["passed"] for entry in entries] == [True, False]
    over = [check["name"] for check in entries[1]["checks"] if not check["passed"]]
    assert over == ["penetration, 99.9 %", "centers inside"]
    assert CollisionVerdict(**{key: entries[0][key] for key in vars(good)}) == good
    lines = sheet.read_text().splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("world,robot,terrain")
    caption = verdicts_table([good, bad]).caption
    assert "seed 2: penetration, 99.9 % 20 mm, legal: at most 10 mm" in caption


QUICK = ("simple", "--robot", "turtlebot2", "--seconds", "0.5", "--size", "20", "--option", "resize=129,129")


def collide(folder: Path, *words: str) -> tuple[int, str, list[dict[str, Any]]]:
    """Run `lirs-wct collide`; return its exit code, what went wrong and the written entries."""
    result = CliRunner().invoke(PROGRAM, ["collide", *words, "-o", str(folder)], standalone_mode=False)
    code = getattr(result.exception, "exit_code", None)
    written = folder / "collisions.json"
    entries = json.loads(written.read_text())["collisions"] if written.exists() else []
    return result.return_value or code or 0, str(result.exception), entries


def test_the_command(tmp_path: Path) -> None:
    code, _, entries = collide(tmp_path, *QUICK, "--seed", "1,3")
    assert code == 0
    assert [entry["seed"] for entry in entries] == [1, 3]
    code, _, entries = collide(tmp_path, "nope.png", *QUICK)
    assert (code, len(entries)) == (3, 1)


def test_a_wrong_option_is_named(tmp_path: Path) -> None:
    for words, says in (
        (("simple", "--robot", "huksy"), "unknown robot 'huksy'"),
        (("simple", "--robot", ","), "--robot must be a list such as a,b,c"),
        (("simple", "--seed", "5-1"), "--seed must be a list such as 1-5"),
        (("simple", "--terrain", "mud"), "terrain must be hfield, mesh, prisms or convex"),
        (("simple", "--seconds", "0"), "seconds must be within (0, 1e6] simulated seconds, got 0.0"),
        (("nope.png",), "no such file"),
    ):
        assert says in collide(tmp_path, *words)[1]
