"""Playback of a drive, finished or in progress: its state at each scan."""

from __future__ import annotations

import io
import math
import time
import zipfile
import zlib
from array import array
from bisect import bisect_right
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from lirs_envs.robots.robot import Robot, Twist, clip, make_robot
from lirs_validation.analysis.results import recorded_truth, recorded_world_config
from lirs_validation.config import MANUAL, RunConfig, run_name
from lirs_validation.experiment.drive import DriveLog, Driver
from lirs_validation.experiment.evaluation import evaluate_drive, evaluate_maps
from lirs_validation.experiment.run import Run, conclude, prepare
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.construction import Facts, with_own_picture
from lirs_validation.metrics.trajectory import rigid_alignment, rms
from lirs_validation.processes import CostMeter
from lirs_validation.record.metric_catalog import metric_lines
from lirs_validation.record.run_record import SUCCEEDED, maps_clouds, read_record, succeeded
from lirs_wct import (
    Float32Array,
    FloatArray,
    LaserScan,
    MapperError,
    OccupancyGrid,
    Pose2,
    Pose3,
    Progress,
    SourceError,
    WctError,
    World,
    no_progress,
)
from lirs_wct.formats import carmen_log, drive_files, map_server
from lirs_wct.sources.bundled import RECIPES

LOG_ODDS = np.array((np.nan, 5.0, -5.0), np.float32)
"""Log-odds of unknown (0), occupied (1) and free cells (-1)."""
PATH_COLUMNS = 5
"""Numbers of a scan in the paths: true x, y, z and estimated x, y."""
MAP_SECONDS, MAP_WALL_SECONDS = 1.0, 0.5
"""Shortest simulated and wall-clock periods between two kept maps and verdicts, seconds."""
RUN_FILES = ("record.json", "truth.tum", "estimate.tum", "scans.clf.gz")
"""Files of a run that a replay reads."""
MAP_FILES = ("map.yaml", "map.pgm")
"""Additional files of planar mappers."""


@dataclass(frozen=True)
class MapSnapshot:
    """Map in the world frame at one moment of a drive; `packed` holds its compressed cells."""

    time: float
    shape: tuple[int, int]
    resolution: float
    origin: Pose2
    packed: bytes

    @staticmethod
    def of(grid: OccupancyGrid, time: float) -> MapSnapshot:
        """Compress a map in the world frame."""
        cells = grid.occupied.astype(np.int8) - grid.free
        return MapSnapshot(time, grid.shape, grid.resolution, grid.origin, zlib.compress(cells.tobytes(), 1))

    @property
    def grid(self) -> OccupancyGrid:
        """Map in the world frame."""
        cells = np.frombuffer(zlib.decompress(self.packed), np.int8).reshape(self.shape)
        return OccupancyGrid(LOG_ODDS[cells], self.resolution, self.origin)


@dataclass(frozen=True)
class Moment:
    """State of a drive at one scan, world frame.

    Attributes:
        time: Seconds since the start.
        lidar: (3,) position of the lidar, meters.
        scan: (n, 3) points that the scan hit, meters.
        truth: (k, 3) true positions until then, meters.
        estimate: (k, 2) estimated positions until then, meters.
    """

    time: float
    T_world_base: Pose3
    lidar: FloatArray
    scan: Float32Array
    truth: FloatArray
    estimate: FloatArray
    map: MapSnapshot | None
    facts: Facts
    verdict: str

    @property
    def errors(self) -> FloatArray:
        """(k,) distances between true and estimated positions, meters."""
        distances: FloatArray = np.hypot(*(self.truth[:, :2] - self.estimate).T)
        return distances


class Playback:
    """A drive that a page shows scan by scan: a log, finished or growing.

    Attributes:
        world: World of the drive; None if it is no longer known, for the reason in `note`.
        seconds: Simulated time of the whole drive.
        maps: Snapshots of the map, in the order of their time.
        marks: Seconds and names of events, such as a closed loop, a lost place, a failure.
        rtf: Real-time factor of each simulated second.
        results: Figures of the whole run; empty while it is driven.
    """

    def __init__(self, robot: str, world: World | None, seconds: float, log: DriveLog) -> None:
        self.robot, self.world, self.seconds, self.log = robot, world, seconds, log
        self.maps: list[MapSnapshot] = []
        self.marks: list[tuple[float, str]] = []
        self.rtf: list[float] = []
        self.status = self.verdict = self.note = ""
        self.results: Facts = ()
        self._T_world_map = log.truth[0].to_pose2()
        self._paths = array("d")
        self._curve: list[tuple[float, float, float]] = []

    @property
    def over(self) -> bool:
        """Whether the drive has ended."""
        return True

    def drive_on(self, until: float, time_limit: float) -> None:
        """Continue a drive in progress until a wall time (`time.monotonic`) or a simulated time."""

    @property
    def scans(self) -> int:
        """Number of scans so far."""
        return len(self.log.scans)

    @property
    def time(self) -> float:
        """Stamp of the last scan, seconds since the start."""
        return self.log.scans[-1].stamp

    def last_scan(self, time: float) -> int:
        """Return the last scan until a time, seconds since the start."""
        return max(0, bisect_right(self.log.scans, time + 1e-6, key=lambda scan: scan.stamp) - 1)

    def paths_until(self, scan: int) -> tuple[FloatArray, FloatArray]:
        """Return (k, 3) true and (k, 2) estimated positions until a scan, world frame, meters."""
        for k in range(len(self._paths) // PATH_COLUMNS, self.scans):
            true, estimate = self.log.truth[k], self._T_world_map @ self.log.in_plane(self.log.estimates[k])
            self._paths.extend((true.x, true.y, true.z, estimate.x, estimate.y))
        paths = np.array(self._paths[: PATH_COLUMNS * (scan + 1)]).reshape(-1, PATH_COLUMNS)
        return paths[:, :3], paths[:, 3:]

    def rtf_at(self, time: float) -> float:
        """Return the real-time factor of the second that ends at a time; NaN if unknown."""
        return self.rtf[min(int(time - 1e-6), len(self.rtf) - 1)] if self.rtf else math.nan

    def curve(self) -> FloatArray:
        """Return (n, 3) time, ATE until then in meters, and RTF, once a second."""
        for second in range(len(self._curve) + 1, int(self.time + 1e-6) + 1):
            error = ate(*self.paths_until(self.last_scan(second)))
            self._curve.append((second, error, self.rtf_at(second)))
        return np.array(self._curve).reshape(-1, 3)

    def moment(self, scan: int) -> Moment:
        """Return the drive at a scan, 0 = before the first motion."""
        reading, T_world_base = self.log.scans[scan], self.log.truth[scan]
        truth, estimate = self.paths_until(scan)
        T_world_laser, time = T_world_base @ reading.T_base_laser, reading.stamp
        facts = (
            ("time", f"{time:.1f} of {self.seconds:g} s ({100 * time / self.seconds:.0f} %)"),
            ("RTF", f"{self.rtf_at(time):.1f}" if self.rtf else "-"),
            ("ATE so far", f"{ate(truth, estimate):.3f} m"),
            ("status", self.status),
            *self.results,
        )
        return Moment(
            time=time,
            T_world_base=T_world_base,
            lidar=T_world_laser.position,
            scan=T_world_laser.apply(reading.points).astype(np.float32),
            truth=truth,
            estimate=estimate,
            map=next((shot for shot in reversed(self.maps) if shot.time <= time + 1e-6), None),
            facts=facts,
            verdict=self.verdict,
        )


def ate(truth: FloatArray, estimate: FloatArray) -> float:
    """Return the absolute trajectory error of positions in the plane, meters."""
    aligned = rigid_alignment(estimate, truth[:, :2]).apply(estimate)
    return rms(np.linalg.norm(aligned - truth[:, :2], axis=1))


class HandOverDriver:
    """Driver that switches between another driver and a person (`by_hand`; `touched` once it was)."""

    def __init__(self, driver: Driver, robot: Robot) -> None:
        self.start, self.frame = driver.start, driver.frame
        self._driver, self._robot, self._wanted = driver, robot, Twist()
        self.by_hand = self.touched = False

    def steer(self, forward: float, left: float) -> None:
        """Set the stick's position: forward and left, -1 to 1 each."""
        self._wanted = Twist(
            clip(forward, 1.0) * self._robot.max_speed, clip(left, 1.0) * self._robot.max_turn_rate
        )

    @property
    def stuck(self) -> bool:
        """Whether the driver gave up; a person never does."""
        return not self.by_hand and self._driver.stuck

    @property
    def finished(self) -> str:
        """Reason for the end of the drive; empty before the end."""
        return "" if self.by_hand else self._driver.finished

    def command(self, pose: Pose2, time: float, scan: LaserScan, odometry: Pose2) -> Twist:
        """Return the command for the next tick."""
        if not self.by_hand:
            return self._driver.command(pose, time, scan, odometry)
        self.touched = True
        return self._wanted


class LiveDrive(Playback):
    """One drive of a page; a person can take over from its driver."""

    world: World

    def __init__(
        self, config: RunConfig, scenarios: ScenarioCache | None = None, progress: Progress = no_progress
    ) -> None:
        ready = prepare(config, progress, scenarios)
        self.driver = HandOverDriver(ready.driver, ready.simulation.robot)
        self._ready = replace(ready, driver=self.driver)
        self._meter, log = CostMeter(), ready.log()
        self._ticks = self._ready.drive(log, wall_limit=config.wall_limit)
        next(self._ticks)
        super().__init__(config.robot, ready.scenario.world, ready.seconds, log)
        self.config, self.status = config, "driving"
        self._counted = {"loop closed": 0, "lost": 0, "alarm": 0}
        self._take_stock()

    @property
    def over(self) -> bool:
        """Whether the drive has ended."""
        return self.log.over

    @property
    def failed(self) -> bool:
        """Whether the mapper failed; nothing can be saved then."""
        return self.over and self.log.status == "error"

    @property
    def repeated(self) -> RunConfig:
        """Config of a run that repeats this drive; one by hand repeats its saved folder."""
        if not self.driver.touched:
            return self.config
        by_hand = replace(self.config, driver=MANUAL)
        return replace(self.config, driver=f"replay:{run_name(by_hand, self.world.name)}")

    def step(self) -> None:
        """Drive until the next scan; nothing more once the drive is over.

        A mapper that fails ends the drive with the status `error`.
        """
        if self.over:
            return
        waited = time.monotonic() - self._drawn_at
        try:
            next(self._ticks, None)
            period = self._ready.simulation.period
            ticks = round(1.0 / period)
            if len(self.log.tick_seconds) == ticks * (len(self.rtf) + 1):
                self.rtf.append(ticks * period / sum(self.log.tick_seconds[-ticks:]))
            if self.over or (self.time - self._stock_time >= MAP_SECONDS and waited >= MAP_WALL_SECONDS):
                self._take_stock()
        except MapperError as error:
            self.log.end("error", str(error))
            self._judge({})
        if self.log.status not in SUCCEEDED:
            self.marks.append((self.time, self.log.status))

    def drive_on(self, until: float, time_limit: float) -> None:
        """Continue the drive until a wall time or a simulated time."""
        while not self.over and time.monotonic() < until and self.time < time_limit:
            self.step()

    def save(self, out: Path, progress: Progress = no_progress) -> Run:
        """Evaluate and write the drive so far like `validate`; the drive can continue.

        The page shared the processor, so the record marks the real-time factor as concurrent. If a person
        drove, the record's driver is `manual`.
        """
        log, ready = replace(self.log, concurrent=True), self._ready
        if not self.over:
            log.reason = f"stopped by hand at {self.time:.1f} s"
        if self.driver.touched:
            driven = replace(self.config, driver=MANUAL)
            ready = replace(ready, scenario=replace(ready.scenario, config=driven))
        return conclude(ready, log, ready.cost(self._meter), out, progress)

    def _take_stock(self) -> None:
        """Keep the map, mark events and judge."""
        mapper, log, scores = self._ready.mapper, self.log, dict[str, Any]()
        if not mapper.reads_clouds:  # these have no occupancy map
            grid = mapper.map()
            self.maps.append(MapSnapshot.of(grid.moved(self._T_world_map), self.time))
            scores["occupied_cells"] = int(grid.occupied.sum())
        stats = mapper.stats
        counts = {"loop closed": stats.counts.get("loops", 0), "lost": stats.lost}
        for name, count in (counts | {"alarm": len(log.watch.alarms)}).items():
            if count > self._counted[name]:
                self.marks.append((self.time, name))
            self._counted[name] = count
        if self.over and log.tick_seconds:
            log.final_trajectory = mapper.trajectory()
            scores = evaluate_maps(self.world, log, mapper).scores
        self._judge(scores)
        self._stock_time, self._drawn_at = self.time, time.monotonic()

    def _judge(self, map_scores: dict[str, Any]) -> None:
        """Judge the drive until now."""
        ready, log = self._ready, self.log
        record = evaluate_drive(ready.scenario, ready.simulation, log, map_scores)
        self.verdict = f"Verdict{'' if self.over else ' so far'}: {record.verdict}"
        if self.over:
            self.status = f"{log.status}{': ' if log.reason else ''}{log.reason}"


def read_playback(
    folder: Path, scenarios: ScenarioCache | None = None, *, uploaded: bool = False
) -> Playback:
    """Read the drive of a run's folder; its map is the final one.

    The record of a run that a browser uploaded names no file of this machine.
    """
    record = read_record(folder)
    if not record.get("trajectory"):
        raise SourceError(f"{folder}: this run has no result ({record['reason']})")
    truth, estimate = recorded_truth(folder), drive_files.read_tum(folder / "estimate.tum")
    scans = carmen_log.read_carmen(folder / "scans.clf.gz").scans
    if len(scans) != len(truth) or len(estimate) < 2:
        raise SourceError(
            f"{folder}: not one drive: {len(scans)} scans, {len(truth)} true and "
            f"{len(estimate)} estimated poses"
        )
    world, note = None, ""
    try:
        config = recorded_world_config(record)
        if uploaded and (config.source not in RECIPES or config.build.texture is not None):
            raise SourceError(f"{config.source}: not looked for on this machine, as the run was uploaded")
        world = (scenarios or ScenarioCache()).scenario(config).world
    except WctError as error:
        note = str(error)
    robot, log = str(record["config"]["robot"]), DriveLog()
    mount = make_robot(robot).T_base_laser
    for k, (x, y, yaw) in enumerate(estimate.planar_at(truth.stamps).tolist()):
        log.scans.append(replace(scans[k], stamp=float(truth.stamps[k]), T_base_laser=mount))
        log.truth.append(Pose3.from_arrays(truth.positions[k], truth.quaternions[k]))
        log.estimates.append(log.truth[0].to_pose2().inverse() @ Pose2(x, y, yaw))
    run = Playback(robot, world, float(truth.stamps[-1]), log)
    if not maps_clouds(record):
        run.maps = [MapSnapshot.of(map_server.read_map(folder / "map.yaml"), 0.0)]
    return _with_results(run, record, note)


def _with_results(run: Playback, record: dict[str, Any], note: str) -> Playback:
    """Return a finished drive with the figures of its record."""
    run.marks = [] if succeeded(record) else [(run.time, record["status"])]
    run.rtf, run.note = list(record["rtf"]["series"]), note
    run.verdict = f"Verdict: {record['verdict']['sentence']}"
    run.status = record["status"] + (f": {record['reason']}" if record["reason"] else "")
    c = record["config"]
    run.results = (
        ("run", f"{record['world']['name']}, {run.robot}, {c['mapper']}, seed {record['seed']}"),
        ("mean RTF", f"{record['rtf']['mean']:.1f}"),
        *metric_lines(record, "headline"),
    )
    return run


def unpacked_run(archived: bytes, folder: Path) -> Path:
    """Extract the needed files of a zipped run, under fixed names."""
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with zipfile.ZipFile(io.BytesIO(archived)) as archive:
            entries = {PurePosixPath(e.filename).name: e for e in archive.infolist() if not e.is_dir()}
            missing = [name for name in RUN_FILES if name not in entries]
            if missing:
                raise SourceError(f"the archive holds no run: {', '.join(missing)} is not in it")
            for name in (*RUN_FILES, *MAP_FILES):
                if name in entries:
                    content = archive.read(entries[name])
                    content = with_own_picture(name, content) if name == "map.yaml" else content
                    (folder / name).write_bytes(content)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, OSError) as error:
        raise SourceError(f"the archive cannot be read: {error}") from error
    return folder


def runs_in(folder: Path) -> dict[str, Path]:
    """Return the runs in a folder, or the folder's own run, newest first."""
    if (folder / "record.json").is_file():
        return {folder.name: folder}
    records = sorted(folder.glob("*/record.json"), key=lambda path: path.stat().st_mtime, reverse=True)
    return {path.parent.name: path.parent for path in records}
