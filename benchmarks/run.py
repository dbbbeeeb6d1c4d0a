"""The whole run: how fast, how right, on the bundled worlds or any source, all seeds reported.

    python benchmarks/run.py [SOURCE ...] [--seeds 1-5] [--seconds 120] [--quick]

`ratio_paper` is the RTF over the paper's: Gazebo, Husky, the same SLAM method on solid worlds (Tables III and
IV). `ratio_reference` is the RTF over that of the reference physics: the commands of the whole drive through
MuJoCo's step alone, at most 4 ms long, with every contact geom on. Aligned figures are of the map after its
trajectory's alignment. `ate_level` is the ATE of the same mapper fed with the same scans levelled by the true
attitude, and `ratio_level` the run's ATE over it: the cost of the IMU's errors on uneven ground.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from benchmarks.steps import arguments, print_rows
from lirs_validation.config import RunConfig
from lirs_validation.experiment.mapper_under_test import mapper_named
from lirs_validation.experiment.run import Run, drive_and_conclude, prepare
from lirs_validation.metrics.trajectory import trajectory_errors
from lirs_validation.report.paper import PUBLISHED_RTF
from lirs_validation.sweep.tasks import SOLID
from lirs_wct.option import read_numbers

WORLDS = ("simple", "medium", "advanced")


def main() -> None:
    """Run every source with every seed and print the table."""
    given = arguments(
        __doc__, "sources", sources=WORLDS, seeds="1-5", seconds=120.0, mapper="hector", quick=False
    )
    seconds = 20.0 if given.quick else given.seconds
    rows = [
        row(RunConfig(source=source, mapper=given.mapper, seconds=seconds, seed=seed))
        for source in given.sources
        for seed in read_numbers("1" if given.quick else given.seeds, "--seeds")
    ]
    print_rows(rows, "whole run, Husky, lms111 (parts in ms per simulated second)", width=210)


def levelled_ate(run: Run) -> float | None:
    """Feed the run's scans again, levelled by the true attitude; return the ATE, if one is defined."""
    log, config = run.log, run.record.config
    mapper: Any = mapper_named(config.mapper, config.seed)  # planar, as the lidar
    answers = []
    for seen, truth in zip(log.observations, log.truth, strict=True):
        imu = None if seen.imu is None else replace(seen.imu, roll=truth.roll, pitch=truth.pitch)
        answers.append(mapper.update(seen.scan, seen.odometry, imu))
    again = replace(log, estimates=answers, final_trajectory=mapper.trajectory())
    path, estimate, _ = again.trajectories()
    return trajectory_errors(path, estimate).ate_rmse if len(estimate) > 1 else None


def row(config: RunConfig) -> dict[str, Any]:
    """Run a config; return the figures that the table shows."""
    ready = prepare(config)
    run = drive_and_conclude(ready)
    record = run.record
    level, ate = levelled_ate(run), record.trajectory["ate_rmse"]
    paper = PUBLISHED_RTF.get((config.source, config.mapper, SOLID))
    reference = ready.simulation.replay(reference=True).rtf
    parts = {f"{name}_ms": 1e3 * value for name, value in record.rtf["parts"].items()}
    return {
        "source": config.source,
        "seed": record.config.seed,
        "status": record.status,
        "rtf": record.rtf["mean"],
        "ratio_paper": record.rtf["mean"] / paper if paper else None,
        "ratio_reference": record.rtf["mean"] / reference,
        **parts,
        "ate": ate,
        "ate_level": level,
        "ratio_level": ate / level if level and ate is not None else None,
        "odometry_ate": record.trajectory["odometry_ate_rmse"],
        "f1": record.map["f1"],
        "f1_aligned": record.map["f1_aligned"],
        "f1_input": record.map["f1_input"],
        "false_occupied": record.map["false_occupied"],
        "false_occupied_aligned": record.map["false_occupied_aligned"],
        "length": record.trajectory["length"],
    }


if __name__ == "__main__":
    main()
