"""An experiment that checks contacts: one collision validation."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, get_args

from lirs_envs.robots.catalog import make_robot
from lirs_validation.config import RunConfig, run_name
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.record.provenance import is_stale, versions, world_files
from lirs_validation.record.run_record import Status
from lirs_validation.sweep.experiment import Outcome
from lirs_validation.sweep.slam_experiment import world_name
from lirs_wct.contact.contact_geometry import ContactGeometry
from lirs_wct.errors import SourceError, reason_of
from lirs_wct.files import atomic_folder
from lirs_wct.progress import Progress

if TYPE_CHECKING:
    from lirs_validation.collision.validation import CollisionVerdict

TEXTS = ("world", "robot", "terrain", "diverged")
"""Fields of a verdict that are text."""
STATUS = "cell.json"
"""File with the experiment's outcome and the versions of the code that wrote it."""


@dataclass(frozen=True, kw_only=True)
class CollisionExperiment:
    """The collision validation of a robot in a world.

    Attributes:
        source: the world.
        robot: name.
        terrain: contact geometry.
        seconds: simulated time of the random drive.
        seed: of the random drive.
    """

    source: str
    robot: str
    terrain: ContactGeometry = "hfield"
    seconds: float = 60.0
    seed: int = 1

    @property
    def name(self) -> str:
        """Name of its folder."""
        return run_name(self.world_config, world_name(self.world_config))

    @property
    def world_config(self) -> RunConfig:
        """Config that gives the world and the name; its mapper is called `collisions`."""
        return RunConfig(
            source=self.source,
            robot=self.robot,
            mapper="collisions",
            terrain=self.terrain,
            seconds=self.seconds,
            seed=self.seed,
        )

    def check(self) -> None:
        """Check that source and robot exist."""
        make_robot(self.robot)
        world_name(self.world_config)

    def perform(
        self, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool
    ) -> Outcome:
        """Check the contacts. A metric over its limit is no failure of the experiment."""
        from lirs_validation.collision.validation import check_collisions, write_verdicts

        progress("build", 0.0)
        world = scenarios.scenario(self.world_config).world
        progress("collide", 0.0)
        verdict = check_collisions(
            world, make_robot(self.robot), terrain=self.terrain, seconds=self.seconds, seed=self.seed
        )
        outcome = Outcome(experiment=self.name, status="ok", written=True)
        with atomic_folder(out / self.name) as folder:
            write_verdicts(folder, [verdict])
            self._write_status(folder, outcome)
        return outcome

    def write_failure(self, out: Path, outcome: Outcome) -> None:
        """Write the outcome and the traceback of a failed experiment."""
        with atomic_folder(out / self.name) as folder:
            self._write_status(folder, outcome)
            (folder / "error.txt").write_text(outcome.trace or outcome.reason, encoding="utf-8")

    def find_outcome(self, out: Path) -> Outcome | None:
        """Return the recorded outcome, if this code wrote it after the source's last change."""
        path = out / self.name / STATUS
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            status, reason, written_by = found["status"], found["reason"], found["versions"]
            if is_stale(path, written_by, world_files(self.world_config)):
                return None
            if status == "ok":
                read_verdict(out / self.name)
        except (OSError, ValueError, KeyError, TypeError, RecursionError, SourceError):
            return None
        if status not in get_args(Status) or not isinstance(reason, str):
            return None
        return Outcome(experiment=self.name, status=status, reason=reason, written=True)

    def describe(self) -> dict[str, Any]:
        """Return name and config."""
        return {"name": self.name, "world": world_name(self.world_config), "tables": ["collisions"]} | asdict(
            self
        )

    def _write_status(self, folder: Path, outcome: Outcome) -> None:
        entry = {"status": outcome.status, "reason": outcome.reason, "versions": versions()}
        text = json.dumps({"config": asdict(self)} | entry, indent=1)
        (folder / STATUS).write_text(text + "\n", encoding="utf-8")


def read_verdict(folder: Path) -> CollisionVerdict:
    """Read the verdict that an experiment wrote.

    Raises:
        SourceError: it is missing or damaged.
    """
    from lirs_validation.collision.validation import CollisionVerdict

    path = folder / "collisions.json"
    try:
        entry = json.loads(path.read_text(encoding="utf-8"))["collisions"][0]
        verdict = CollisionVerdict(**{f.name: entry[f.name] for f in fields(CollisionVerdict)})
    except (OSError, ValueError, KeyError, IndexError, TypeError, RecursionError) as error:
        raise SourceError(f"{path}: not a collision check, or damaged: {reason_of(error)}") from error
    for name, value in vars(verdict).items():
        if not isinstance(value, (str, int, float, NoneType)) or isinstance(value, str) != (name in TEXTS):
            raise SourceError(f"{path}: damaged: {name} is {value!r}")
    return verdict
