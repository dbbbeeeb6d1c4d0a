"""A mapped log: its record, and the values that its metrics come from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lirs_validation.metrics.log_accuracy import Accuracy
from lirs_validation.record.map_record import MapRecord
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.geometry import OccupancyGrid, Trajectory

if TYPE_CHECKING:
    from lirs_wct.drawing.style import Drawing


from lirs_wct.files import atomic_folder
from lirs_wct.formats.map_server import write_map
from lirs_wct.formats.tum import write_tum


@dataclass(frozen=True)
class MappedLog:
    """Result of mapping a log.

    Attributes:
        record: config and metrics.
        log: as read.
        grid: the map; its frame is the first base pose.
        trajectory: pose of every scan in the map, by the log's stamps.
        reference: in its own frame; None where none was given.
        accuracy: errors pose by pose.
        folder: where it was written; None = nowhere.
    """

    record: MapRecord
    log: LaserLog
    grid: OccupancyGrid
    trajectory: Trajectory
    reference: Trajectory | None
    accuracy: Accuracy
    folder: Path | None = None

    def overview(self) -> Drawing:
        """Draw the mapped log on one page."""
        # Loaded here: the first scan of a log does not wait for matplotlib.
        from lirs_validation.drawing.map_overview import map_overview

        return map_overview(self.record, self.grid, self.trajectory, self.reference, self.accuracy)

    def __repr__(self) -> str:
        return f"MappedLog({self.record.config.log!r}, {self.trajectory!r}, folder={self.folder})"

    def _repr_png_(self) -> bytes:
        return self.overview()._repr_png_()


def write_mapped(folder: Path, mapped: MappedLog) -> Path:
    """Write the folder atomically, replacing an older one; return it.

    Raises:
        OutputError: the folder cannot be written.
    """
    with atomic_folder(folder) as temporary:
        mapped.record.save(temporary)
        write_map(temporary / "map", mapped.grid)
        write_tum(temporary / "estimate.tum", mapped.trajectory)
        mapped.overview().savefig(temporary / "overview.png")
    return folder
