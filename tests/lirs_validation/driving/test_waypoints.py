"""Waypoints from a file to the drive: formats, bad files, bad places, the order and the yaw."""

import math
from pathlib import Path

import numpy as np
import pytest

from lirs_validation.driving.path_driver import DriverConfig, PathDriver
from lirs_validation.driving.routes import WaypointRoute, check_waypoints
from lirs_wct.errors import SourceError
from lirs_wct.formats.drive_files import RoutePoint, read_waypoints
from lirs_wct.geometry import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from tests.kit import refused
from tests.lirs_validation.driving.ride import DT, corridor, field, ride

THREE = (RoutePoint(1.0, 2.0), RoutePoint(-3.0, 4.5, 1.5), RoutePoint(0.0, 0.0))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("w.txt", "# a loop\n1 2\n\n-3, 4.5, 1.5  # look at the gate\n0 0\n"),
        ("w.csv", "x,y,yaw\n1,2\n-3,4.5,1.5\n0,0\n"),
        ("w.yaml", "- [1, 2]\n- [-3, 4.5, 1.5]\n- {y: 0, x: 0}\n"),
        ("w.yml", "waypoints:\n  - {x: 1, y: 2}\n  - {x: -3, y: 4.5, yaw: 1.5}\n  - [0, 0]\n"),
    ],
)
def test_every_form_of_file_is_read(name: str, text: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    assert read_waypoints(tmp_path / name) == THREE


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("w.txt", "1 2\n3\n", "line 2: a waypoint is x, y and perhaps yaw"),
        ("w.txt", "1 2\n3 4 5 6\n", "line 2"),
        ("w.csv", "1,2\n3,nan\n", "line 2"),
        ("w.csv", "1,2\na,b\n", "line 2"),
        ("w.txt", "1 2\n", "at least 2 waypoints"),
        ("w.yaml", "- [1, 2]\n- {x: 1}\n", "waypoint 2"),
        ("w.yaml", "- [1, 2]\n- [true, 2]\n", "waypoint 2"),
        ("w.yaml", "- [1, 2]\n- 3\n", "waypoint 2"),
        ("w.yaml", "- {x: 1, x: 2, y: 3}\n", "line 1: the key 'x' stands on line 1, too"),
        ("w.yaml", f"- [{'9' * 5000}, 1]\n", "too many digits"),
        ("w.yaml", "x: 3\n", "a YAML list"),
        ("w.yaml", "- [1, 2\n", "line 2: "),
    ],
)
def test_a_bad_file_is_one_line_with_its_path_first(name: str, text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with refused(f"{tmp_path / name}: ", says):
        read_waypoints(tmp_path / name)


def test_no_file_and_no_text_are_named(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"none\.csv: cannot be read"):
        read_waypoints(tmp_path / "none.csv")
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(SourceError, match=r"picture\.png: no text"):
        read_waypoints(tmp_path / "picture.png")


def two_rooms() -> OccupancyGrid:
    p = np.zeros((60, 60))
    p[:, 30] = 1.0
    return OccupancyGrid.from_probability(p, 0.1)


@pytest.mark.parametrize(
    ("place", "says"),
    [
        ((7.0, 1.0), "is off the map.*"),
        ((3.05, 1.0), "is no place for husky: it is on a wall"),
        ((5.0, 1.0), "no way leads.*"),
    ],
)
def test_places_where_the_robot_cannot_be_are_named(place: tuple[float, float], says: str) -> None:
    given = (RoutePoint(1.0, 1.0), RoutePoint(2.0, 5.0), RoutePoint(*place))
    with pytest.raises(
        SourceError, match=rf"^way\.csv: waypoint 3 \(.*\):? {says}; nearest place: 2\.95,[\d.]+$"
    ):
        check_waypoints(Path("way.csv"), given, two_rooms(), "husky", lambda place: "it is on a wall")
    check_waypoints(Path("way.csv"), given[:2], two_rooms(), "husky", str)


def drive(free: OccupancyGrid, way: tuple[RoutePoint, ...], seconds: float) -> tuple[PathDriver, np.ndarray]:
    config = DriverConfig()
    start = Pose2(way[0].x, way[0].y, way[0].yaw or 0.0)
    driver = PathDriver(WaypointRoute(way[1:], free, config, None), start, config)
    return driver, ride(driver, start, seconds).poses


@pytest.mark.parametrize("seed", [1, 3])
@pytest.mark.slow
def test_waypoints_are_passed_in_their_order_round_obstacles(seed: int) -> None:
    free, touching = field(seed)
    config, cells = DriverConfig(), np.argwhere(free.free)
    rng = np.random.default_rng(seed)
    picked: list[RoutePoint] = []
    while len(picked) < 5:
        x, y = free.centers(cells[rng.integers(len(cells))]).tolist()
        if abs(x) < 12 and abs(y) < 12:
            picked.append(RoutePoint(x, y))
    check_waypoints(Path("w"), tuple(picked), free, "husky", str)
    driver, poses = drive(free, tuple(picked), 240.0)
    assert driver.finished == "the last waypoint is reached"
    at = 0
    for waypoint in picked:
        away = np.hypot(poses[at:, 0] - waypoint.x, poses[at:, 1] - waypoint.y)
        assert away.min() < 0.5 + config.step, "each after the one before"
        at += int(np.argmax(away < 0.5 + config.step))
    cells = np.clip(touching.cells(poses[:, :2]), 0, np.array(touching.shape) - 1)
    assert touching.free[cells[:, 0], cells[:, 1]].all()


def test_the_robot_faces_where_a_waypoint_says_and_then_goes_on() -> None:
    way = (RoutePoint(1.0, 1.5), RoutePoint(6.0, 1.5, math.pi / 2), RoutePoint(12.0, 1.5, math.pi))
    driver, poses = drive(corridor(width=3.0), way, 60.0)
    assert driver.finished
    for waypoint in way[1:]:
        near = np.hypot(poses[:, 0] - waypoint.x, poses[:, 1] - waypoint.y) < 0.5
        error = np.abs(np.angle(np.exp(1j * (poses[near, 2] - waypoint.yaw))))
        assert error.min() <= DriverConfig().facing + 0.02
    assert driver.command(Pose2(*poses[-1]), 60.0 + DT).v == 0.0


def test_a_blocked_way_ends_stuck_and_not_finished() -> None:
    config, start = DriverConfig(), Pose2(1.0, 1.5)
    route = WaypointRoute((RoutePoint(12.0, 1.5),), corridor(width=3.0), config, None)
    driver = PathDriver(route, start, config)
    ride(driver, start, 120.0, blocked=lambda pose: pose.x > 5.0)
    assert driver.stuck
    assert not driver.finished
