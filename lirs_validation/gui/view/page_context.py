"""What all tabs of a page work with."""

from __future__ import annotations

from dataclasses import dataclass

import viser

from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.session.uploads import Limits, Uploads
from lirs_validation.gui.session.worker import Worker
from lirs_validation.gui.view.drive_scene import DriveScene
from lirs_validation.gui.view.guard import Guard
from lirs_validation.gui.view.scene import Scene


@dataclass(frozen=True)
class PageContext:
    """The parts of one page.

    Attributes:
        client: whose page it is.
        worker: does the page's work.
        guard: shows its errors.
        scene: shows its world.
        drive_scene: shows its drive.
        uploads: keeps its files.
        scenarios: its worlds.
        limits: of the server.
    """

    client: viser.ClientHandle
    worker: Worker
    guard: Guard
    scene: Scene
    drive_scene: DriveScene
    uploads: Uploads
    scenarios: ScenarioCache
    limits: Limits
