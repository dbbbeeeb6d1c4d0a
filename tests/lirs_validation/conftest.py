"""Small places that build and drive within a tenth of a second, and what a robot senses there."""

from typing import Any

import cv2
import numpy as np
import pytest

from lirs_envs.robots.robot import Twist, make_robot
from lirs_envs.sensing.sensors import Observation
from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import build_scenario
from lirs_wct.geometry import Pose2
from lirs_wct.sources.source import BuildOptions


@pytest.fixture(scope="session")
def room(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A map of a room of 10 x 8 m with two boxes."""
    cells = np.full((160, 200), 254, np.uint8)
    cells[[0, 1, -2, -1]] = cells[:, [0, 1, -2, -1]] = 0
    cells[50:60, 60:80] = cells[110:120, 120:130] = 0
    path = tmp_path_factory.mktemp("room") / "room.yaml"
    cv2.imwrite(str(path.with_suffix(".png")), cells)
    path.write_text(
        "image: room.png\nresolution: 0.05\norigin: [-5, -4, 0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return str(path)


@pytest.fixture(scope="session")
def hills(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A picture of hills of 0.1 m between walls, 12 x 12 m: the source and its options."""
    x, y = np.meshgrid(*[np.linspace(0, 12, 129)] * 2)
    heights = 0.05 * (1 + np.sin(x) * np.cos(y))
    heights[:4] = heights[-4:] = heights[:, :4] = heights[:, -4:] = 1.5
    heights[40:48, 50:60] = heights[80:90, 90:96] = 1.5
    path = tmp_path_factory.mktemp("hills") / "hills.png"
    cv2.imwrite(str(path), np.round(4e4 * heights).astype(np.uint16))
    return {"source": str(path), "options": BuildOptions(size=12.0, height=1.5)}


@pytest.fixture(scope="session")
def observations(room: str) -> list[Observation]:
    """What a husky senses in the room on a curve of 20 scans."""
    simulation = build_scenario(RunConfig(source=room)).simulation(make_robot("husky"))
    return [
        simulation.reset(Pose2(-2.0, -1.0, 0.3)),
        *(simulation.advance(Twist(0.5, 0.2)) for _ in range(19)),
    ]
