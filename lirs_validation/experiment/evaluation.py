"""Evaluation of a drive: from its log to the metrics of the record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from lirs_envs.simulation import Simulation
from lirs_validation.experiment.drive import DriveLog
from lirs_validation.experiment.loading import RESOLUTION
from lirs_validation.experiment.mapper_under_test import MapperUnderTest, package_versions
from lirs_validation.experiment.scenario import Scenario
from lirs_validation.metrics.elevation import Elevations, evaluate_elevation
from lirs_validation.metrics.failure import compare_alarms, window_errors
from lirs_validation.metrics.map import MapScores, map_scores, observed_support
from lirs_validation.metrics.trajectory import (
    StartAlignment,
    associated,
    inside_95,
    scan_coverage,
    spatial_errors,
    start_alignment,
    trajectory_errors,
)
from lirs_validation.processes import is_shared
from lirs_validation.record.run_record import SUCCEEDED, RunRecord, versions
from lirs_validation.record.verdict import LIMITS, incompleteness
from lirs_wct import FloatArray, OccupancyGrid, SimulationError, Trajectory, World
from slam_baselines.front_end import KnownPoseMapper

REPLAYED = 10.0
"""Simulated seconds of a drive whose physics is replayed."""
COUNTED_SCANS = 300
"""Scans of a drive, evenly spaced, whose hits on walls are counted."""


@dataclass(frozen=True)
class Maps:
    """Maps of a run in the world frame, and their comparison.

    Attributes:
        built: Map of the mapper, moved by the true start pose; None for a mapper of point clouds.
        true_pose: Map made at the true poses.
        alignment: Alignment of the mapper's trajectory; None where there is none.
        elevation: Elevation maps of point clouds; None for planar mappers, and in worlds with overhangs.
    """

    built: OccupancyGrid | None
    true_pose: OccupancyGrid
    scores: dict[str, Any]
    alignment: StartAlignment | None = None
    elevation: Elevations | None = None

    @property
    def aligned(self) -> OccupancyGrid | None:
        """The built map after the alignment of its trajectory."""
        if self.built is None or self.alignment is None:
            return None
        return self.built.moved(self.alignment.T_world_aligned)


def evaluate(
    scenario: Scenario,
    simulation: Simulation,
    mapper: MapperUnderTest,
    log: DriveLog,
    maps: Maps,
    cost: dict[str, Any],
    *,
    replayed: bool = True,
) -> RunRecord:
    """Return the record of a finished drive; `cost` holds its time, memory and seconds of compilation."""
    stats, config = mapper.stats, scenario.config
    record = evaluate_drive(scenario, simulation, log, maps.scores)
    # A mapper with a queue may drop scans; 0 received scans means that it does not count them.
    dropped = max(0, len(log.scans) - stats.received) if stats.received else 0
    return replace(
        record,
        rtf=evaluate_rtf(log, simulation, replayed=replayed) | {"compile_seconds": cost["compile_seconds"]},
        collisions=asdict(simulation.collisions),
        scans=record.scans | {"imu_rate": simulation.imu_rate},
        mapper=asdict(stats),
        cost=cost | {"scans_dropped": dropped},
        versions=versions() | package_versions(config.mapper, config.mapper_python),
    )


def evaluate_drive(
    scenario: Scenario, simulation: Simulation, log: DriveLog, map_scores: dict[str, Any]
) -> RunRecord:
    """Return the part of the record that a verdict reads, of a drive that may go on.

    A successful drive becomes `incomplete` if the trajectory leaves out scans.
    """
    trajectory = evaluate_trajectory(log, simulation)
    status, reason = log.status, log.reason
    lacking = incompleteness(trajectory["scan_coverage"])
    if status in SUCCEEDED and lacking is not None:
        status, reason = "incomplete", lacking
    return RunRecord(
        config=scenario.config,
        world=evaluate_world(scenario, simulation),
        status=status,
        reason=reason,
        trajectory=trajectory,
        map=map_scores,
        scans=evaluate_scans(scenario.world, log),
    )


def evaluate_maps(world: World, log: DriveLog, mapper: MapperUnderTest) -> Maps:
    """Compare the mapper's map with the map at the true poses.

    A built map is moved by the true start pose alone; the aligned metrics by the trajectory's alignment as
    well. A mapper of point clouds has no occupancy map: its clouds make an elevation map.
    """
    truth, estimate = log.trajectories()[:2]
    alignment = start_alignment(truth, estimate)
    if mapper.reads_clouds:
        elevation, scores = evaluate_elevation(world, log.clouds, truth, estimate)
        no_scores = dict.fromkeys(field.name for field in fields(MapScores))
        return Maps(None, true_pose_map(log, RESOLUTION), no_scores | asdict(scores), alignment, elevation)
    built = mapper.map()
    true_pose, built = true_pose_map(log, built.resolution), built.moved(log.truth[0].to_pose2())
    planar_scores = map_scores(
        built, true_pose, surface=world.surface, walls=world.walls, truth=world.truth, alignment=alignment
    )
    return Maps(built, true_pose, asdict(planar_scores), alignment)


def true_pose_map(log: DriveLog, resolution: float) -> OccupancyGrid:
    """Return the map of a drive's scans at the true poses, world frame.

    Walkers are no part of the world: the beams that met one are left out.
    """
    T_world_map = log.truth[0].to_pose2()
    reference = KnownPoseMapper(resolution=resolution)
    for k, (scan, T_world_base, imu) in enumerate(zip(log.scans, log.truth, log.imu, strict=True)):
        T_map_base = T_world_map.inverse() @ T_world_base.to_pose2()
        if log.walker_beams:
            scan = replace(scan, ranges=np.where(log.walker_beams[k], np.float32(np.nan), scan.ranges))
        reference.update(scan, T_map_base, imu)
    return reference.map().moved(T_world_map)


def evaluate_trajectory(log: DriveLog, simulation: Simulation) -> dict[str, Any]:
    """Compare the estimate, and the odometry beside it, with the truth."""
    truth, estimate, odometry = log.trajectories()
    common = len(associated(truth.stamps, estimate.stamps)[0])
    driven = {"robot_lengths": truth.length / (2 * simulation.config.robot.radius)}
    if common < 2:
        coverage = scan_coverage(truth.stamps, estimate.stamps)
        return {"length": truth.length, "poses": common, "scan_coverage": coverage} | driven
    errors = asdict(trajectory_errors(truth, estimate))
    if log.spatial:
        errors |= asdict(spatial_errors(truth, estimate))
        errors["odometry_ate_rmse_3d"] = spatial_errors(truth, log.spatial_odometry()).ate_rmse_3d
    online, T_map_world = log.online().moved(log.T_world_map), log.truth[0].to_pose2().inverse()
    in_plane = Trajectory.from_poses(log.stamps, map(log.in_plane, log.estimates))
    odometry_ate = trajectory_errors(truth, odometry).ate_rmse
    lost = log.status == "lost" or errors["ate_rmse"] > LIMITS.most_error(odometry_ate)
    return errors | {
        "ate_rmse_online": trajectory_errors(truth, online).ate_rmse,
        "inside_95": inside_95(truth.moved(T_map_world).xy, in_plane.xy, log.covariances),
        "odometry_ate_rmse": odometry_ate,
        "failure": evaluate_failure(log, truth, in_plane, odometry, lost=lost),
        **driven,
    }


def evaluate_failure(
    log: DriveLog, truth: Trajectory, online: Trajectory, odometry: Trajectory, *, lost: bool
) -> dict[str, Any]:
    """Compare the path's failing poses with the reports of the mapper and of the watch."""
    error, reckoned = window_errors(truth.xy, online.xy), window_errors(truth.xy, odometry.xy)
    failing = error > LIMITS.most_error(reckoned)
    onset = float(log.stamps[failing.argmax()]) if lost and failing.any() else None
    alarms = {"mapper": np.array(log.lost), "watch": np.array(log.alarms)}
    found = {k: asdict(compare_alarms(log.stamps, failing, alarm, onset)) for k, alarm in alarms.items()}
    return {"onset": onset} | found


def evaluate_rtf(log: DriveLog, simulation: Simulation, *, replayed: bool = True) -> dict[str, Any]:
    """Return the real-time factor of a drive, its spread over simulated seconds and its parts."""
    period, wall_seconds = simulation.period, sum(log.tick_seconds)
    driven, timing = len(log.tick_seconds) * period, simulation.timing
    series = 1.0 / per_second(log.tick_seconds, period)
    alone = not (log.concurrent or is_shared(log.load))
    spent = {"physics": timing.physics, "sensors": timing.sensors, "mapper": log.mapper_seconds}
    parts = {name: sum(seconds) / driven for name, seconds in spent.items()}
    return {
        "mean": driven / wall_seconds,
        "std": float(np.std(series)),
        "min": float(series.min()),
        "parts": parts | {"rest": wall_seconds / driven - sum(parts.values())},
        "physics_reference": reference_rtf(simulation) if replayed and alone else None,
        "simulated_seconds": driven,
        "wall_seconds": wall_seconds,
        "timestep": simulation.body.timestep,
        "load_average": log.load,
        "concurrent": log.concurrent,
        "extrapolated": log.status == "wall limit",
        "series": series.tolist(),
    }


def per_second(tick_seconds: Sequence[float], period: float) -> FloatArray:
    """Return (n,) mean wall seconds per simulated second, over each whole second.

    A last part of a second counts by its share.
    """
    ticks = max(1, round(1.0 / period))
    whole = [tick_seconds[i : i + ticks] for i in range(0, len(tick_seconds), ticks)]
    return np.array([sum(part) / (len(part) * period) for part in whole], dtype=np.float64)


def reference_rtf(simulation: Simulation) -> float | None:
    """Replay the drive's first seconds; return the RTF of the reference physics alone.

    None where it diverges: some robots need a shorter step.
    """
    try:
        return simulation.replay(reference=True, seconds=REPLAYED).rtf
    except SimulationError:
        return None


def evaluate_scans(world: World, log: DriveLog) -> dict[str, Any]:
    """Count returns and wall hits of a planar mapper's scans; empty for point clouds."""
    if log.spatial:
        return {}
    chosen = np.unique(np.linspace(0, len(log.truth) - 1, COUNTED_SCANS).round().astype(int)).tolist()
    scans = [log.scans[k] for k in chosen]
    return observed_support(world, scans, [log.truth[k] for k in chosen])


def evaluate_world(scenario: Scenario, simulation: Simulation) -> dict[str, Any]:
    """Describe the world and its contact terrain."""
    world, surface, terrain = scenario.world, scenario.world.surface, simulation.config.contact_geometry
    contact: dict[str, Any] = {"terrain": terrain}
    if terrain in ("hfield", "mesh"):
        contact |= asdict(simulation.body.contact)
    else:
        model = simulation.body.model
        contact["parts"] = sum(model.geom(g).name.startswith("ground") for g in range(model.ngeom))
    return {
        "name": world.name,
        "kind": world.kind,
        "scale": world.scale,
        "size": surface.size,
        "bounds": surface.bounds,
        "relief": surface.relief,
        "nodes": surface.shape,
        "window": scenario.window,
        "whole_size": scenario.whole_size,
        "sample_spacing": world.sample_spacing,
        "robot_length": 2 * simulation.config.robot.radius,
        "files": list(scenario.files),
        "contact": contact,
    }
