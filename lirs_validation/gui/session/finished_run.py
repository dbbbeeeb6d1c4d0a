"""A finished run, read from its folder for replay."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

from lirs_envs.robots.robot import make_robot
from lirs_validation.analysis.results import recorded_truth, recorded_world_config
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.session.construction import Facts
from lirs_validation.gui.session.playback import MapSnapshot, Playback
from lirs_validation.gui.session.uploads import with_own_picture
from lirs_validation.record.run_record import maps_clouds, read_record, succeeded
from lirs_wct import Pose3, SourceError, WctError, World
from lirs_wct.formats import carmen_log, drive_files, map_server
from lirs_wct.sources.bundled import RECIPES

FILES = ("record.json", "truth.tum", "estimate.tum", "scans.clf.gz")
"""Files of a run that a replay reads."""
MAP_FILES = ("map.yaml", "map.pgm")
"""Additional files of planar mappers."""


def read_playback(
    folder: Path, scenarios: ScenarioCache | None = None, *, uploaded: bool = False
) -> Playback:
    """Read the drive of a run's folder; its map is the final one.

    The record of a run that a browser uploaded names no file of this machine.

    Raises:
        SourceError: it is no run's folder, damaged, or of a run without a result.
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
    world, note = _find_world(record, scenarios or ScenarioCache(), uploaded)
    run = Playback(str(record["config"]["robot"]), world, float(truth.stamps[-1]))
    mount, estimated = make_robot(run.robot).T_base_laser, estimate.planar_at(truth.stamps)[:, :2].tolist()
    for k, scan in enumerate(scans):
        pose = Pose3.from_arrays(truth.positions[k], truth.quaternions[k])
        run.add(replace(scan, stamp=float(truth.stamps[k]), T_base_laser=mount), pose, estimated[k])
    if not maps_clouds(record):
        run.maps = [MapSnapshot.of(map_server.read_map(folder / "map.yaml"), 0.0)]
    run.marks = [] if succeeded(record) else [(run.time, record["status"])]
    run.rtf, run.note = list(record["rtf"]["series"]), note
    run.verdict = f"Verdict: {record['verdict']['sentence']}"
    run.status = record["status"] + (f": {record['reason']}" if record["reason"] else "")
    run.results = _results(record)
    return run


def _find_world(record: dict[str, Any], scenarios: ScenarioCache, uploaded: bool) -> tuple[World | None, str]:
    """Return the world of a run, or None and the reason."""
    try:
        config = recorded_world_config(record)
        if uploaded and (config.source not in RECIPES or config.build.texture is not None):
            return None, f"{config.source}: not looked for on this machine, as the run was uploaded"
        return scenarios.scenario(config).world, ""
    except WctError as error:
        return None, str(error)


def _results(record: dict[str, Any]) -> Facts:
    """Return the figures of the whole run."""
    c, final, f1 = record["config"], record["trajectory"].get("ate_rmse"), record["map"].get("f1")
    return (
        ("run", f"{record['world']['name']}, {c['robot']}, {c['mapper']}, seed {record['seed']}"),
        ("mean RTF", f"{record['rtf']['mean']:.1f}"),
        ("final ATE", "-" if final is None else f"{final:.3f} m"),
        ("map F1", "-" if f1 is None else f"{f1:.2f}"),
    )


def unpacked_run(archived: bytes, folder: Path) -> Path:
    """Extract the needed files of a zipped run, under fixed names.

    Raises:
        SourceError: it is no such archive, or holds no run.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with zipfile.ZipFile(io.BytesIO(archived)) as archive:
            entries = {PurePosixPath(e.filename).name: e for e in archive.infolist() if not e.is_dir()}
            missing = [name for name in FILES if name not in entries]
            if missing:
                raise SourceError(f"the archive holds no run: {', '.join(missing)} is not in it")
            taken = [name for name in (*FILES, *MAP_FILES) if name in entries]
            for name in taken:
                content = archive.read(entries[name])
                if name == "map.yaml":
                    content = with_own_picture(name, content)
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
