"""Export of a run: ROS bag, CSV, NumPy archive, CARMEN log or dataset of evalio."""

from __future__ import annotations

import math
import os
import re
import shutil
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader

from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.robots.robot import make_robot
from lirs_envs.sensing.imu import STANDARD_GRAVITY, InertialNoise
from lirs_validation.analysis.results import RunFolder, read_sensors, recorded_config
from lirs_validation.experiment.run import sensor_errors
from lirs_validation.record.run_record import maps_clouds
from lirs_wct import FloatArray, Pose2, Pose3, SourceError, require_known
from lirs_wct.files import atomic_write
from lirs_wct.formats import Storage, carmen_log, drive_files, map_server
from lirs_wct.formats.rosbag.messages import BagDrive, BagTick

POSE_HEADER = "stamp,x,y,z,qw,qx,qy,qz"
MODULE = "lirs_wct_run"
"""Name of the written module and of its data set."""
POINTS, INERTIAL, TRUTH = "/points", "/imu/data_raw", "/ground_truth"
DATASET = Path(__file__).with_name("evalio_dataset.txt")
"""Text of the module with the data set, whose {fields} a run fills."""


def export_run(
    run: RunFolder, out: Path, formats: tuple[str, ...], *, storage: Storage = "mcap", slam: bool = True
) -> list[Path]:
    """Export a run in formats (bag, csv, npz, carmen, evalio); return the written paths.

    The bag holds the mapper's results, the frame `map` on /tf and /map, if `slam` is set.
    """
    exporters: Mapping[str, Callable[[RunFolder, Path], Path]] = {
        "bag": partial(_export_bag, storage=storage, slam=slam),
        "csv": _export_csv,
        "npz": _export_npz,
        "carmen": _export_carmen,
        "evalio": _export_evalio,
    }
    for name in formats:
        require_known("format", name, exporters)
    return [exporters[name](run, out) for name in formats]


def recorded_drive(run: RunFolder, *, slam: bool = True) -> BagDrive:
    """Return a recorded drive in the map frame, that of the first base pose.

    Ranges have the millimeter steps of `scans.clf.gz`; the estimates are the mapper's final ones.
    """
    config = recorded_config(run.entry)
    truth, log, imu = read_sensors(run.folder, config)
    estimate = drive_files.read_tum(run.folder / "estimate.tum")
    T_map_world = truth.pose2(0).inverse()
    in_map, estimate = truth.moved(T_map_world), estimate.moved(T_map_world)
    estimates = [Pose2(*row) for row in estimate.planar_at(log.stamps).tolist()]
    ticks = [
        BagTick(
            scan=scan,
            odometry=log.odometry[k] or Pose2(),
            imu=imu[k],
            truth=Pose3.from_arrays(in_map.positions[k], in_map.quaternions[k]),
            estimate=estimates[k] if slam else None,
        )
        for k, scan in enumerate(log.scans)
    ]
    mapped = slam and not maps_clouds(run.entry)
    grid = map_server.read_map(run.folder / "map.yaml").moved(T_map_world) if mapped else None
    return BagDrive(ticks=ticks, grid=grid, errors=sensor_errors(config))


def _export_bag(run: RunFolder, out: Path, *, storage: Storage, slam: bool) -> Path:
    from lirs_wct.formats.rosbag.writer import write_bag

    write_bag(out / "bag", recorded_drive(run, slam=slam), storage)
    return out / "bag"


def _export_csv(run: RunFolder, out: Path) -> Path:
    tables = _tables(run)
    beams = ",".join(f"range_{k}" for k in range(len(tables["beams"])))
    headers = {"scans": f"stamp,{beams}", "imu": drive_files.IMU_HEADER, "beams": "angle"}
    for name, table in tables.items():
        with atomic_write(out / "csv" / f"{name}.csv") as path:
            header = headers.get(name, POSE_HEADER)
            np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments="")
    return out / "csv"


def _export_npz(run: RunFolder, out: Path) -> Path:
    with atomic_write(out / "run.npz") as path:
        np.savez_compressed(path, allow_pickle=False, **_tables(run))
    return out / "run.npz"


def _export_carmen(run: RunFolder, out: Path) -> Path:
    carmen_log.read_carmen(run.folder / "scans.clf.gz")
    with atomic_write(out / "scans.clf.gz") as path:
        shutil.copyfile(run.folder / "scans.clf.gz", path)
    return out / "scans.clf.gz"


def _tables(run: RunFolder) -> dict[str, FloatArray]:
    """Return the recorded data as tables, one row per scan; trajectories in the world frame."""
    log = carmen_log.read_carmen(run.folder / "scans.clf.gz")
    tables = {"scans": np.column_stack((log.stamps, np.array([scan.ranges for scan in log.scans])))}
    tables["beams"] = log.scans[0].angles
    for name in ("truth", "estimate", "odometry"):
        t = drive_files.read_tum(run.folder / f"{name}.tum")
        tables[name] = np.column_stack((t.stamps, t.positions, t.quaternions))
    rows = [
        (r.stamp, r.roll, r.pitch, *r.angular_velocity, *r.linear_acceleration)
        for r in drive_files.read_imu(run.folder / "imu.csv.gz")
    ]
    return tables | {"imu": np.array(rows)}


def _export_evalio(run: RunFolder, out: Path) -> Path:
    """Write a dataset of a run's bag for evalio; return the path of its module.

    The bag holds point clouds, their truth, and inertial readings.
    """
    config, (clouds, rate) = recorded_config(run.entry), _bag_counts(run.folder)
    robot, folder = make_robot(config.robot), out / "evalio"
    lidar, mount = make_lidar_preset(config.lidar or robot.lidar), robot.T_base_laser
    noise = InertialNoise()
    text = DATASET.read_text(encoding="utf-8").format(
        module=MODULE,
        sequence=re.sub(r"\W", "_", run.folder.resolve().name.lower()),
        bag=os.path.relpath(run.folder, folder),
        points=POINTS,
        inertial=INERTIAL,
        truth=TRUTH,
        p=mount.position.tolist(),
        q=mount.quaternion.tolist(),
        gyro=noise.rate_density,
        accel=noise.acceleration_density,
        gravity=STANDARD_GRAVITY,
        rate=rate,
        rows=lidar.rings,
        columns=lidar.beams,
        near=lidar.range_min,
        far=lidar.range_max,
        sweeps=1 / lidar.period,
        clouds=clouds,
    )
    with atomic_write(folder / f"{MODULE}.py") as path:
        path.write_text(text, encoding="utf-8")
    return folder / f"{MODULE}.py"


def _bag_counts(folder: Path) -> tuple[int, float]:
    """Return the number of clouds and of inertial readings a second."""
    try:
        with AnyReader([folder]) as reader:
            counts = {connection.topic: connection.msgcount for connection in reader.connections}
            seconds = reader.duration * 1e-9
    except Exception as error:  # the reader's own errors have no common base
        raise SourceError(f"{folder}: holds no bag that can be read; lirs-wct record makes one") from error
    lacking = [topic for topic in (POINTS, INERTIAL, TRUTH) if not counts.get(topic)]
    if lacking:
        raise SourceError(
            f"{folder}: its bag has no {' and no '.join(lacking)}: record with a lidar with rings"
        )
    return counts[POINTS], float(math.floor(counts[INERTIAL] / seconds + 0.5))
