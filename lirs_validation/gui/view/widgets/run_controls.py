"""What is chosen of a run before it starts: robot, LRF, mapper, driver and the rest of `validate`."""

from __future__ import annotations

from typing import Any

import viser

from lirs_envs.lidar.presets import LIDARS
from lirs_envs.robots.catalog import ROBOTS
from lirs_validation.config import ATTITUDES, THREADS, RunConfig, SourceOptions
from lirs_wct.contact.contact_geometry import CONTACT_GEOMETRIES
from lirs_wct.errors import ConfigError
from slam_baselines.mapper import MAPPERS

OWN = "the robot's own"
DRIVERS = ("tour", "frontier")
"""That need no file of the server."""
LONGEST, WALKERS = 3600.0, 100
"""Simulated seconds of a drive, and walkers, at most."""


class RunControls:
    """Controls of a run.

    Args:
        gui: of the page.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        self._robot = gui.add_dropdown("robot", tuple(ROBOTS), initial_value="husky")
        self._lidar = gui.add_dropdown("LRF", (OWN, *LIDARS))
        self._mapper = gui.add_dropdown("mapper", tuple(MAPPERS), initial_value="hector")
        self._driver = gui.add_dropdown(
            "driver", DRIVERS, hint="A tour over the true ground, or an explorer on the mapper's own map."
        )
        with gui.add_folder("More of the run", expand_by_default=False):
            self._seconds = gui.add_number("seconds", 120.0, min=1.0, max=LONGEST, step=1.0)
            self._seed = gui.add_number("seed", 1, min=0, max=2**31 - 1, step=1)
            self._attitude = gui.add_dropdown(
                "attitude", ATTITUDES, hint="What the mapper is told of roll and pitch."
            )
            self._terrain = gui.add_dropdown(
                "terrain", tuple(CONTACT_GEOMETRIES), hint="What MuJoCo touches."
            )
            self._walkers = gui.add_number("walkers", 0, min=0, max=WALKERS, step=1)
            self._threads = gui.add_dropdown(
                "threads", tuple(map(str, THREADS)), hint="With 2 the mapper has a process of its own."
            )

    def config(self, source: str, options: SourceOptions) -> RunConfig:
        """Return the run that is chosen, in a world.

        Raises:
            ConfigError: a value is not legal.
        """
        if not (0 < self._seconds.value <= LONGEST and 0 <= self._walkers.value <= WALKERS):
            raise ConfigError(f"a page drives up to {LONGEST:g} s with up to {WALKERS} walkers")
        terrain: Any = self._terrain.value
        attitude: Any = self._attitude.value
        return RunConfig(
            source=source,
            build=options,
            robot=self._robot.value,
            lidar=None if self._lidar.value == OWN else self._lidar.value,
            mapper=self._mapper.value,
            driver=self._driver.value,
            seconds=float(self._seconds.value),
            seed=int(self._seed.value),
            attitude=attitude,
            terrain=terrain,
            actors=int(self._walkers.value),
            threads=int(self._threads.value),
        )
