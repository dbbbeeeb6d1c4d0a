"""Wrappers: a difficulty that follows success, and what a mapper makes of the scans."""

from typing import Any

import numpy as np
import pytest

from lirs_envs.env import RobotEnv
from lirs_envs.episodes.observations import GROUPS
from lirs_envs.vector_env import RobotVectorEnv
from lirs_envs.wrappers import FREE, OCCUPIED, UNKNOWN, Curriculum, local_map, map_groups
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.world import World
from slam_baselines.mapper import make_mapper


@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_curriculum_of_a_vector(mode: str, plane: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """Robot 0 always succeeds, the others never; then all do."""
    vector = RobotVectorEnv(
        4, "navigation", world=plane, time_limit=0.2, autoreset_mode=mode, observe=["attitude"]
    )
    good, episodes, infos = np.array((True, False, False, False)), vector.episodes, vector.episodes.infos
    monkeypatch.setattr(
        episodes, "infos", lambda: infos() | {"success": good & (episodes.terminated | episodes.truncated)}
    )
    env = Curriculum(vector, difficulty=0.5, step=0.1, episodes=8, raise_at=0.75, lower_at=0.25)
    env.reset(seed=0)
    seen = [0.5]

    def drive(ends: int) -> None:
        count = 0
        while count < ends:
            *_, terminated, truncated, _ = env.step(np.zeros((4, 2), np.float32))
            count += int((terminated | truncated).sum())
            if env.difficulty != seen[-1]:
                seen.append(env.difficulty)

    drive(16)
    assert seen == pytest.approx([0.5, 0.4, 0.3])
    good[:] = True
    drive(8)
    assert seen == pytest.approx([0.5, 0.4, 0.3, 0.4])
    assert vector.get_attr("difficulty") == pytest.approx((0.4,) * 4)


class Corner:
    """A mapper that knows its pose by odometry, and one wall: north of y = 1, free south of it."""

    def __init__(self) -> None:
        self.stamps: list[float] = []

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        assert odometry is not None
        assert imu is not None
        self.stamps.append(scan.stamp)
        return odometry

    def map(self) -> OccupancyGrid:
        p = np.full((40, 40), 0.02)
        p[24:] = 0.98
        p[:, :4] = np.nan
        return OccupancyGrid.from_probability(p, 0.25, Pose2(-5.0, -5.0))


def test_maps_of_a_vector_are_those_of_single_environments(
    rough: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Row by row, also those of an episode's end."""
    made = []

    def mapper() -> Any:
        made.append(make_mapper("hector"))
        return made[-1]

    for name, group in map_groups(mapper, cells=32).items():
        monkeypatch.setitem(GROUPS, name, group)
    options: dict[str, Any] = {"world": rough, "time_limit": 0.8, "observe": ["local_map", "map_pose"]}
    vector = RobotVectorEnv(2, "mapping", autoreset_mode="SameStep", **options)
    singles = [RobotEnv("mapping", **options) for _ in "ab"]
    together, _ = vector.reset(seed=3)
    alone = [env.reset(seed=3 + i)[0] for i, env in enumerate(singles)]
    actions, ends, values = np.array(((1.0, 0.3), (-0.8, 0.5)), np.float32), 0, set()
    for _ in range(12):
        for i in range(2):
            for name in ("local_map", "map_pose"):
                np.testing.assert_array_equal(together[name][i], alone[i][name])
        values |= set(np.unique(together["local_map"]).tolist())
        together, *_, infos = vector.step(actions)
        for i, env in enumerate(singles):
            alone[i], _, _, over, _ = env.step(actions[i])
            if over:
                np.testing.assert_array_equal(infos["final_obs"][i]["local_map"], alone[i]["local_map"])
                alone[i], ends = env.reset()[0], ends + 1
    assert ends == 2
    assert len(made) == 8, "map and pose come from one mapper an episode"
    assert np.ptp(together["map_pose"]) > 0.05
    assert {UNKNOWN, FREE} <= values
    with pytest.raises(ConfigError, match="size above 0"):
        map_groups(mapper, cells=0)


def test_local_map_around_a_pose() -> None:
    grid = Corner().map()
    north = local_map(grid, Pose2(0.0, 0.0, np.pi / 2), 8, 0.25)[0]
    # Row 0 is 0.875 m ahead, and the wall begins 1 m ahead.
    assert (north == FREE).all()
    north = local_map(grid, Pose2(0.0, 0.5, np.pi / 2), 8, 0.25)[0]
    assert (north[:2] == OCCUPIED).all()
    assert (north[2:] == FREE).all()
    east = local_map(grid, Pose2(0.0, 0.5, 0.0), 8, 0.25)[0]
    assert (east[:, :2] == OCCUPIED).all()
    assert (east[:, 2:] == FREE).all()
    west = local_map(grid, Pose2(-4.0, -4.0, np.pi), 16, 0.25)[0]
    assert (west[:8] == UNKNOWN).all()


def test_a_mapper_receives_each_new_scan(plane: World, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    def mapper() -> Corner:
        made.append(Corner())
        return made[-1]

    for name, group in map_groups(mapper, cells=16).items():
        monkeypatch.setitem(GROUPS, name, group)
    env = RobotEnv("mapping", world=plane, control_hz=50, observe=["local_map", "map_pose"])
    observation, _ = env.reset(seed=0)
    for _ in range(10):
        observation, *_ = env.step(np.array((0.5, 0.2), np.float32))
        assert env.observation_space.contains(observation)
        assert observation["map_pose"] == pytest.approx(env.view.reading().odometry.as_array(), abs=0.03)
    # The lidar's 25 Hz, not the 50 of the steps.
    assert made[0].stamps == pytest.approx([0.0, 0.04, 0.08, 0.12, 0.16, 0.2])
    env.reset()
    assert len(made) == 2
