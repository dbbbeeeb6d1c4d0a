"""Drives of a tuning through a world or a part of a log."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from lirs_validation.config import RunConfig
from lirs_validation.experiment.run import run_unwritten
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.logs.log_replay import check_log, inertial_readings, log_mapper, replay
from lirs_validation.logs.map_log import (
    odometry_accuracy,
    read_log,
    read_truth,
    reference_in_time,
    relations_in_time,
)
from lirs_validation.map_config import MapConfig
from lirs_validation.metrics.consistency import scan_consistency
from lirs_validation.metrics.log_accuracy import trajectory_accuracy
from lirs_validation.metrics.verdict import AGREEING, LIMITS, VerdictFigures, classify
from lirs_validation.record.verdict import log_figures, run_figures
from lirs_wct import ConfigError, MapperError, SimulationError, Trajectory
from lirs_wct.formats.laser_log import LaserLog

LEAST, WORST = 0.01, 100.0
"""Smallest and largest ratio of a path error and its limit; the latter also of a mapper that fails."""
_SCENARIOS = ScenarioCache()


@dataclass(frozen=True)
class TuneScore:
    """Score of one drive.

    Attributes:
        loss: logarithm of the path error over its limit, more for an unusable map; None = not counted.
        error: path error, meters; without truth the revisit residual.
        works: whether the verdict is `works`; of a log without truth, whether the passes agree.
        reason: why the drive does not count, or the mapper failed; empty if neither.
    """

    loss: float | None
    error: float | None = None
    works: bool = False
    reason: str = ""


def score_of(figures: VerdictFigures) -> TuneScore:
    """Return the score of a drive by the figures of its verdict.

    The limit of the path error is that of `loses its way`. A map beyond its limits adds to the loss, so that
    a path that follows the odometry, or a map full of false walls, does not win.
    """
    kind, reasons = classify(figures)
    error, odometry = figures.error, figures.odometry_error
    text = "; ".join(f"{r.figure} {r.value}" for r in reasons)
    if kind in ("not evaluated", "no reference"):
        return TuneScore(None, reason=text)
    if kind == "failed" or figures.status == "lost" or error is None:
        return TuneScore(math.log(WORST), error, reason=text)
    limit = LIMITS.over_odometry + LIMITS.times_odometry * (odometry or 0.0)
    loss = math.log(min(max(error / limit, LEAST), WORST))
    if figures.f1_aligned is not None:
        loss += math.log(max(1.0, (1.0 - figures.f1_aligned) / (1.0 - LIMITS.f1_aligned)))
    if figures.false_occupied is not None:
        allowed = (figures.reference_false_occupied or 0.0) + LIMITS.false_occupied
        loss += math.log(max(1.0, figures.false_occupied / allowed))
    return TuneScore(loss, error, kind == "works")


def measure_run(config: RunConfig) -> TuneScore:
    """Drive through a world; return the score."""
    try:
        entry = run_unwritten(config, maps=True, scenarios=_SCENARIOS)
    except MapperError as error:
        return TuneScore(math.log(WORST), reason=str(error))
    except SimulationError as error:  # nothing was driven
        return TuneScore(None, reason=str(error))
    return score_of(run_figures(entry | {"config": {"driver": config.driver}}))


@lru_cache(maxsize=1)
def _read(config: MapConfig) -> tuple[LaserLog, Any, Any]:
    """Return a log with the relations and the reference, stamps repaired."""
    log, (relations, reference) = read_log(config), read_truth(config)
    return (
        log,
        None if relations is None else relations_in_time(relations, log.lines),
        None if reference is None else reference_in_time(reference, log.lines),
    )


def measure_part(config: MapConfig, part: int, parts: int) -> TuneScore:
    """Map one of the equal parts of a log; return the score."""
    plain = replace(config, parameters="", mapper=MapConfig.mapper, seed=MapConfig.seed)
    whole, relations, reference = _read(plain)
    first, end = (k * len(whole.scans) // parts for k in (part, part + 1))
    readings = inertial_readings(config, whole)[first:end]
    log = replace(whole, scans=whole.scans[first:end], odometry=whole.odometry[first:end])
    with log_mapper(config) as mapper:
        if mapper.reads_clouds:
            raise ConfigError(f"{config.mapper} reads point clouds: tune takes planar mappers")
        check_log(config, mapper, log)
        try:
            tracking = replay(config, mapper, log, readings, lambda *_: None)
            path = mapper.trajectory()
        except MapperError as error:
            return TuneScore(math.log(WORST), reason=str(error))
    status = "lost" if tracking.reason() else "ok"
    if relations is None and reference is None:
        quality = scan_consistency(log.scans, readings, path)
        residual = None if quality is None else quality.revisit_residual
        if residual is None:
            return TuneScore(None, reason="no place was seen twice")
        loss = math.log(WORST if status == "lost" else max(residual / AGREEING, LEAST))
        return TuneScore(loss, residual, status == "ok" and residual <= AGREEING)
    odometry = _odometry(log)
    entry = {
        "status": status,
        "accuracy": trajectory_accuracy(path, odometry, relations, reference).metrics(),
        "odometry": odometry_accuracy(odometry, relations, reference),
    }
    return score_of(log_figures(entry | {"log": {}, "trajectory": {}, "map": {}}))


def _odometry(log: LaserLog) -> Trajectory:
    """Return the odometry at the scans of a log; empty without any."""
    given = [(s.stamp, pose) for s, pose in zip(log.scans, log.odometry, strict=True) if pose is not None]
    return Trajectory.from_poses([stamp for stamp, _ in given], [pose for _, pose in given])
