"""The folder of a run: record, maps, trajectories, recorded scans, RTF over time, overview picture."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from lirs_validation.driving.replay import COMMANDS
from lirs_validation.experiment.drive_log import DriveLog
from lirs_validation.experiment.evaluation import Maps
from lirs_validation.metrics.elevation import ELEVATION, write_elevation
from lirs_validation.record.run_record import RunRecord, file_sizes
from lirs_wct.files import atomic_folder
from lirs_wct.formats.carmen.writer import write_log
from lirs_wct.formats.drive_csv import Commands, write_commands, write_imu
from lirs_wct.formats.map_server import write_map
from lirs_wct.formats.tum import write_tum
from lirs_wct.world import World


def write_results(
    folder: Path, record: RunRecord, log: DriveLog, maps: Maps, world: World, bag: Sequence[Path] = ()
) -> RunRecord:
    """Write a run's folder atomically; return the record as written.

    An older folder is replaced.

    Args:
        folder: of the run.
        record: without the sizes of files.
        log: of the drive.
        maps: of the run.
        world: where it took place.
        bag: files of its recording, which are moved into the folder.

    Raises:
        OutputError: the folder cannot be written.
    """
    # Matplotlib takes 25 MB and half a second, which a drive that nobody draws can do without.
    from lirs_validation.drawing.run_overview import overview_figure

    truth, estimate, odometry = log.trajectories()
    period = record.rtf["simulated_seconds"] / len(log.walls)
    with atomic_folder(folder) as temporary:
        if maps.built is not None:
            write_map(temporary / "map", maps.built)
        if maps.elevation is not None:
            write_elevation(temporary / ELEVATION, maps.elevation.built, maps.elevation.true_pose)
        write_map(temporary / "map_true_pose", maps.true_pose)
        for name, trajectory in (("truth", truth), ("estimate", estimate), ("odometry", odometry)):
            write_tum(temporary / f"{name}.tum", trajectory)
        times = np.arange(len(log.commands)) * period
        commands = np.column_stack((times, [(c.v, c.omega) for c in log.commands]))
        write_commands(temporary / COMMANDS, Commands(log.start, commands))
        write_log(temporary / "scans.clf.gz", ((o.scan, o.odometry) for o in log.observations))
        write_imu(temporary / "imu.csv.gz", [o.imu for o in log.observations])
        lines = [f"{second},{rtf:.4f}" for second, rtf in enumerate(record.rtf["series"], start=1)]
        (temporary / "rtf.csv").write_text("\n".join(["second,rtf", *lines]) + "\n", encoding="utf-8")
        elevation = None if maps.elevation is None else maps.elevation.built
        drawn = (maps.true_pose, maps.built, maps.aligned, elevation)
        overview = overview_figure(world, record, truth, estimate, *drawn)
        overview.savefig(temporary / "overview.png")
        for file in bag:
            shutil.move(file, temporary / file.name)
        record = replace(record, file_sizes=file_sizes(temporary))
        record.save(temporary)
    return record
