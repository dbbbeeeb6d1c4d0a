"""Export of a recorded bag as a dataset of evalio."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path

from rosbags.highlevel import AnyReader

from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.robots.robot import make_robot
from lirs_envs.sensing.inertial import STANDARD_GRAVITY, InertialNoise
from lirs_validation.analysis.result_folders import RunFolder
from lirs_validation.config import RunConfig
from lirs_wct.errors import SourceError
from lirs_wct.files import atomic_write

MODULE = "lirs_wct_run"
"""Name of the written module and of its data set."""
POINTS, INERTIAL, TRUTH = "/points", "/imu/data_raw", "/ground_truth"
TEXT = '''"""A run of LIRS-WCT as a data set of evalio.

    export EVALIO_CUSTOM={module} PYTHONPATH=.
    evalio run -d {module}/{sequence} -p genz -o results
    evalio stats results

Run all in this folder. The frame of the inertial unit and of the truth is base_link.
"""

from enum import auto
from pathlib import Path

import numpy as np
from evalio.datasets.base import Dataset
from evalio.datasets.loaders import (
    LidarDensity, LidarFormatParams, LidarMajor, LidarPointStamp, LidarStamp, RosbagIter,
)
from evalio.types import SE3, SO3, ImuParams, LidarParams, Stamp, Trajectory
from rosbags.highlevel import AnyReader

BAG = (Path(__file__).resolve().parent / {bag!r}).resolve()


class LirsWctRun(Dataset):
    {sequence} = auto()

    @property
    def folder(self):
        return BAG

    def files(self):
        return [BAG / "metadata.yaml"]

    def data_iter(self):
        layout = LidarFormatParams(
            LidarStamp.Start, LidarPointStamp.Start, LidarMajor.Row, LidarDensity.AllPoints
        )
        return RosbagIter(BAG, {points!r}, {inertial!r}, self.lidar_params(), lidar_format=layout)

    def ground_truth_raw(self):
        stamps, poses = [], []
        with AnyReader([BAG]) as reader:
            topic = [c for c in reader.connections if c.topic == {truth!r}]
            for connection, _, data in reader.messages(connections=topic):
                message = reader.deserialize(data, connection.msgtype)
                p, q, t = message.pose.position, message.pose.orientation, message.header.stamp
                stamps.append(Stamp(sec=t.sec, nsec=t.nanosec))
                poses.append(SE3(SO3(qx=q.x, qy=q.y, qz=q.z, qw=q.w), np.array([p.x, p.y, p.z])))
        return Trajectory(stamps=stamps, poses=poses)

    def imu_T_lidar(self):
        return SE3(SO3(qx={q[1]!r}, qy={q[2]!r}, qz={q[3]!r}, qw={q[0]!r}), np.array({p!r}))

    def imu_T_gt(self):
        return SE3.identity()

    def imu_params(self):
        gravity = np.array([0, 0, -{gravity!r}])
        return ImuParams(gyro={gyro!r}, accel={accel!r}, gravity=gravity, rate={rate!r})

    def lidar_params(self):
        return LidarParams(
            num_rows={rows}, num_columns={columns}, min_range={near!r}, max_range={far!r}, rate={sweeps!r}
        )

    def quick_len(self):
        return {clouds}
'''


def export_evalio(run: RunFolder, config: RunConfig, out: Path) -> Path:
    """Write a module with a dataset of a run's bag; return its path.

    Args:
        run: whose folder holds a bag with point clouds, their truth, and inertial readings.
        config: of the run.
        out: folder that receives the folder `evalio`.

    Raises:
        SourceError: the run holds no such bag.
    """
    clouds, rate = _bag_counts(run.folder)
    robot, folder = make_robot(config.robot), out / "evalio"
    lidar, mount = make_lidar_preset(config.lidar or robot.lidar), robot.T_base_laser
    noise = InertialNoise()
    text = TEXT.format(
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
        raise SourceError(f"{folder}: holds no bag that can be read; record one with --bag") from error
    lacking = [topic for topic in (POINTS, INERTIAL, TRUTH) if not counts.get(topic)]
    if lacking:
        raise SourceError(
            f"{folder}: its bag has no {' and no '.join(lacking)}: record --bag with a lidar with rings"
        )
    return counts[POINTS], float(math.floor(counts[INERTIAL] / seconds + 0.5))
