"""Mappers as users may write them: one that works, and some that do what no mapper may."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from lirs_wct.geometry import OccupancyGrid, Pose2, Pose3, Trajectory
from slam_baselines.mapper import MapperStats


class Own:
    """Answers with the odometry; its map has the number of scans in every cell."""

    lost = False

    def __init__(self) -> None:
        self.stamps, self.poses, self.attitudes = list[float](), list[Pose2](), 0

    def update(self, scan: Any, odometry: Any, imu: Any) -> Pose2:
        if len(self.poses) == 4:
            self.act(scan, odometry, imu)
        self.stamps.append(scan.stamp)
        self.poses.append(Pose2(*odometry.as_array().tolist()))
        self.attitudes += imu is not None
        return self.poses[-1]

    def act(self, scan: Any, odometry: Any, imu: Any) -> None:
        """Misbehave, at the fifth scan."""

    def map(self) -> OccupancyGrid:
        return OccupancyGrid(np.full((8, 8), len(self.poses), np.float32), 0.05, Pose2())

    def trajectory(self) -> Trajectory:
        return Trajectory.from_poses(self.stamps, self.poses)

    @property
    def stats(self) -> MapperStats:
        return MapperStats(received=len(self.poses), counts={"attitudes": self.attitudes})


class Pooled(Own):
    def act(self, scan: Any, odometry: Any, imu: Any) -> None:
        with multiprocessing.get_context("fork").Pool(2) as pool:
            pool.map(abs, [1, 2])


class LeavesChild(Own):
    """Starts a process and leaves it; its number is the map's first value."""

    def act(self, scan: Any, odometry: Any, imu: Any) -> None:
        self.child = subprocess.Popen(["sleep", "1000"]).pid

    def map(self) -> OccupancyGrid:
        return OccupancyGrid(np.full((8, 8), self.child, np.float32), 0.05, Pose2())


class Still:
    """Reads clouds, says that the robot never moves, and where that is: a drift of 1 cm a sweep, upward."""

    reads_clouds, lost = True, False

    def __init__(self) -> None:
        self.stamps, self.poses, self.imus = list[float](), list[Pose3](), list[Any]()

    def update(self, cloud: Any, imu: Any) -> Pose3:
        self.imus.append(imu)
        return self.answer(cloud.stamp, Pose3(0.0, 0.0, 0.01 * len(self.poses)))

    def answer(self, stamp: float, pose: Pose3) -> Pose3:
        self.stamps.append(stamp)
        self.poses.append(pose)
        return pose

    def trajectory(self) -> Trajectory:
        return Trajectory.from_poses(self.stamps, self.poses)

    @property
    def stats(self) -> MapperStats:
        return MapperStats(received=len(self.poses), used=len(self.poses))


class Gyro(Still):
    """Turns by the yaw rate of all inertial readings."""

    reads_inertial = True
    yaw = 0.0

    def update(self, cloud: Any, imu: Any, readings: Any) -> Pose3:
        wanted = 20 if self.stamps else 0
        if len(readings) != wanted:
            raise ValueError(f"{len(readings)} readings instead of {wanted}")
        if wanted and abs(readings.stamps[-1] - cloud.stamp) > 1e-9:
            raise ValueError("late readings")
        self.yaw += readings.angular_velocity[:, 2].sum() / 200
        return self.answer(cloud.stamp, Pose3.from_rpy(0.0, 0.0, 0.0, 0.0, 0.0, self.yaw))


class Wheels(Still):
    """Says what the odometry says."""

    reads_odometry = True

    def update(self, cloud: Any, imu: Any, odometry: Any) -> Pose3:
        return self.answer(cloud.stamp, Pose3.from_pose2(odometry))


class Half:
    """Has no trajectory."""

    reads_clouds = True

    def update(self, cloud: Any, imu: Any) -> Any: ...


class Forces(Own):
    """Changes all that it was given, every time."""

    def update(self, scan: Any, odometry: Any, imu: Any) -> Pose2:
        answer = super().update(scan, odometry, imu)
        scan.ranges[:] = 1.0
        for thing, name in ((scan, "stamp"), (scan.T_base_laser, "z"), (odometry, "x"), (imu, "pitch")):
            object.__setattr__(thing, name, 7.0)
        return answer


class Exits(Own):
    def act(self, scan: Any, odometry: Any, imu: Any) -> None:
        sys.exit()


class ExitsAtTheEnd(Own):
    def map(self) -> OccupancyGrid:
        sys.exit(0)


class Rages(Own):
    def act(self, scan: Any, odometry: Any, imu: Any) -> None:
        raise BaseException("no exception")


class Fails(Own):
    def act(self, scan: Any, odometry: Any, imu: Any) -> None:
        raise ValueError("no more")


class Dies(Own):
    def act(self, scan: Any, odometry: Any, imu: Any) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


class Leaves(Own):
    def act(self, scan: Any, odometry: Any, imu: Any) -> None:
        os._exit(7)


class Hangs(Own):
    def act(self, scan: Any, odometry: Any, imu: Any) -> None:
        Path("hangs").touch()
        time.sleep(60)


class Works(Own):
    """Takes 20 ms of processor time, and 60 MB, for each scan."""

    def update(self, scan: Any, odometry: Any, imu: Any) -> Pose2:
        end, self.block = time.process_time() + 0.02, np.ones(60_000_000, np.uint8)
        while time.process_time() < end:
            pass
        return super().update(scan, odometry, imu)


class Replaces(Own):
    """Makes the evaluation find no error, for itself and for later runs, and misleads what comes after."""

    def __init__(self) -> None:
        super().__init__()
        import lirs_validation.metrics.trajectory  # noqa: F401

        for module in list(sys.modules.values()):
            if hasattr(module, "trajectory_errors"):
                module.trajectory_errors = lambda *_, **__: None
        np.seterr(all="raise")
        warnings.simplefilter("error")
        os.chdir("/")


class Looks(Own):
    """Looks for the simulation in the frames of its callers."""

    def update(self, scan: Any, odometry: Any, imu: Any) -> Pose2:
        frame = sys._getframe()
        while frame is not None:
            for value in frame.f_locals.values():
                if type(value).__name__ in ("Simulation", "Drive", "DriveLog"):
                    return Pose2(99.0)
            frame = frame.f_back  # type: ignore[assignment]
        return super().update(scan, odometry, imu)
