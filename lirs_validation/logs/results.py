"""The folder of a mapped log: record, map, trajectory, overview picture."""

from __future__ import annotations

from pathlib import Path

from lirs_validation.logs.mapped_log import MappedLog
from lirs_wct.files import atomic_folder
from lirs_wct.formats.map_server import write_map
from lirs_wct.formats.tum import write_tum


def write_mapped(folder: Path, mapped: MappedLog) -> Path:
    """Write the folder, whole or not at all, in place of an older one; return it.

    Raises:
        OutputError: the folder cannot be written.
    """
    with atomic_folder(folder) as temporary:
        mapped.record.save(temporary)
        write_map(temporary / "map", mapped.grid)
        write_tum(temporary / "estimate.tum", mapped.trajectory)
        mapped.overview().savefig(temporary / "overview.png")
    return folder
