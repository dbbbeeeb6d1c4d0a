"""Records for tests: of the form that runs write, with figures as one wishes."""

import json
from pathlib import Path
from typing import Any

from lirs_validation.config import RunConfig
from lirs_validation.record.run_record import RunRecord, Status
from lirs_wct.files import write_manifest

SECONDS = 30
WITH_RESULTS = (
    "record.json",
    "overview.png",
    "map.pgm",
    "map.yaml",
    "map_true_pose.pgm",
    "map_true_pose.yaml",
    "truth.tum",
    "estimate.tum",
    "odometry.tum",
    "scans.clf.gz",
    "imu.csv.gz",
    "rtf.csv",
    "commands.csv",
)
"""Files of a run that drove."""
ALARMS = {"noticed": True, "delay": 0.5, "false": 2, "healthy": 60.0, "false_per_hour": 120.0}


def record(
    world: str = "simple",
    seed: int = 1,
    *,
    rtf: float = 40.0,
    ate: float = 0.02,
    f1: float | None = 0.95,
    status: Status = "ok",
    concurrent: bool = False,
    extrapolated: bool = False,
    **config: Any,
) -> RunRecord:
    """Return a record with every group, or with none where nothing came of it."""
    described = RunConfig(source=world, seed=seed, seconds=SECONDS, **config)
    if status in ("error", "timeout"):
        return RunRecord(config=described, world={"name": world}, status=status, reason="ValueError: broken")
    relative = {"translation_rmse": ate / 2, "rotation_rmse": 0.001, "pairs": 25}
    relations = {f"{a}_{b}": 0.005 for a in ("translation", "rotation") for b in ("mean", "std")}
    distance = {"mean": 0.004, "p95": 0.05}
    return RunRecord(
        config=described,
        world={"name": world, "kind": "terrain", "size": (50.0, 50.0), "relief": 2.6},
        status=status,
        reason="" if status == "ok" else f"it ended: {status}",
        rtf={
            "mean": rtf, "std": rtf / 10, "min": rtf / 2,
            "physics_reference": rtf * 2,
            "parts": {"physics": 0.3 / rtf, "sensors": 0.2 / rtf, "mapper": 0.4 / rtf, "rest": 0.1 / rtf},
            "simulated_seconds": float(SECONDS), "wall_seconds": SECONDS / rtf,
            "load_average": 0.5, "concurrent": concurrent, "extrapolated": extrapolated,
            "series": [rtf * (1 + 0.1 * (-1) ** k) for k in range(SECONDS)],
        },
        trajectory={
            "ate_rmse": ate, "ate_max": 2 * ate, "ate_rmse_unaligned": 1.5 * ate, "yaw_rmse": 0.001,
            "rpe_metre": relative, "rpe_second": relative, "relations": relations | {"relations": 60},
            "final_drift": ate, "final_yaw_drift": 0.001, "length": 24.0, "poses": 700,
            "scan_coverage": 1.0,
            "ate_rmse_online": ate, "inside_95": 0.97, "odometry_ate_rmse": 0.2,
            "failure": {"onset": 12.0, "mapper": dict(ALARMS), "watch": dict(ALARMS)},
        },
        map={
            "f1": f1, "f1_aligned": f1, "start_shift": 0.01, "start_turn": 0.002, "precision": f1,
            "recall": f1, "iou": 0.8, "f1_input": None, "precision_input": None, "recall_input": None,
            "false_occupied": 0.01, "false_occupied_aligned": 0.01,
            "reference_false_occupied": 0.0, "unknown": 0.1, "to_reference": distance,
            "from_reference": distance, "ssim": 0.7, "occupied_cells": 1500,
        },
        collisions={"max_penetration": 0.001, "penetration_p999": 0.0009, "body_contacts": 0,
                    "body_contact_seconds": 0.0, "samples": 5000},
        mapper={"ms_p50": 0.3, "ms_p95": 2.0},
        cost={"cpu_seconds": 1.5, "peak_memory": 400_000_000, "compile_seconds": 2.0, "scans_dropped": 0},
    )  # fmt: skip


def entry(*args: Any, **more: Any) -> dict[str, Any]:
    """Return a record as it reads back."""
    read: dict[str, Any] = json.loads(record(*args, **more).to_json())
    return read


def saved_whole(root: Path, made: RunRecord) -> Path:
    """Write a record and the other files of its run, as small as can be; return their folder."""
    folder = root / made.name
    folder.mkdir(parents=True, exist_ok=True)
    for name in WITH_RESULTS[1:]:
        (folder / name).write_text("something")
    made.save(folder)
    write_manifest(folder)
    return folder


def saved(root: Path, *args: Any, **more: Any) -> Path:
    """Write a record into its folder; return the folder."""
    made = record(*args, **more)
    made.save(root / made.name)
    return root / made.name
