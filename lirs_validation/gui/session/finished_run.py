"""A finished run, read from its folder for replay."""

from __future__ import annotations

import io
import math
import zipfile
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from lirs_envs.robots.robot import make_robot
from lirs_validation.analysis.recorded_run import recorded_truth, recorded_world_config
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.session.construction import Facts
from lirs_validation.gui.session.playback import MapSnapshot, Playback
from lirs_validation.record.run_record import maps_clouds, read_record, succeeded
from lirs_validation.record.verdict import judge
from lirs_wct import LaserScan, Pose3, SourceError, WctError, World
from lirs_wct.arrays import FloatArray
from lirs_wct.formats.carmen.log import read_carmen
from lirs_wct.formats.map_server import read_map
from lirs_wct.formats.tum import read_tum
from lirs_wct.sources.bundled import RECIPES

FILES = ("record.json", "truth.tum", "estimate.tum", "scans.clf.gz")
"""Files of a run that a replay reads."""
MAP_FILES = ("map.yaml", "map.pgm")
"""Additional files of planar mappers."""


class FinishedRun(Playback):
    """The drive of a run's folder.

    Attributes:
        record: of the run, nested dicts.
        robot: its name.
        world: world of the run; None if its source no longer exists.
        missing: reason for a missing world.

    Args:
        folder: of the run.
        scenarios: worlds that the page built before.
        uploaded: whether a browser sent the run; its record then names no file of this machine.

    Raises:
        SourceError: it is no run's folder, damaged, or of a run without a result.
    """

    def __init__(
        self, folder: Path, scenarios: ScenarioCache | None = None, *, uploaded: bool = False
    ) -> None:
        self.record = read_record(folder)
        if not self.record.get("trajectory"):
            raise SourceError(f"{folder}: this run has no result ({self.record['reason']})")
        self.robot = str(self.record["config"]["robot"])
        self._truth, self._estimate = recorded_truth(folder), read_tum(folder / "estimate.tum")
        mount = make_robot(self.robot).T_base_laser
        self._scans = [replace(s, T_base_laser=mount) for s in read_carmen(folder / "scans.clf.gz").scans]
        if len(self._scans) != len(self._truth) or len(self._estimate) < 2:
            raise SourceError(
                f"{folder}: not one drive: {len(self._scans)} scans, {len(self._truth)} true and "
                f"{len(self._estimate)} estimated poses"
            )
        self._map, self._curve = None, []
        if not maps_clouds(self.record):
            self._map = MapSnapshot.of(read_map(folder / "map.yaml"), float(self._truth.stamps[-1]))
        self.world, self.missing = self._find_world(scenarios or ScenarioCache(), uploaded)

    def _find_world(self, scenarios: ScenarioCache, uploaded: bool) -> tuple[World | None, str]:
        try:
            config = recorded_world_config(self.record)
            if uploaded and (config.source not in RECIPES or config.build.texture is not None):
                return None, f"{config.source}: not looked for on this machine, as the run was uploaded"
            return scenarios.scenario(config).world, ""
        except WctError as error:
            return None, str(error)

    @property
    def scans(self) -> int:
        """Number of scans."""
        return len(self._scans)

    def scan_at(self, scan: int) -> tuple[LaserScan, Pose3]:
        """Return a scan and the true pose at it, world frame."""
        pose = Pose3.from_arrays(self._truth.positions[scan], self._truth.quaternions[scan])
        return replace(self._scans[scan], stamp=float(self._truth.stamps[scan])), pose

    def last_scan(self, time: float) -> int:
        """Return the last scan until a time, seconds since the start."""
        return max(0, int(np.searchsorted(self._truth.stamps, time, side="right")) - 1)

    def paths_until(self, scan: int) -> tuple[FloatArray, FloatArray]:
        """Return (k, 3) true and (k, 2) estimated positions until a scan, world frame, meters."""
        until = slice(scan + 1)
        return self._truth.positions[until], self._estimate.planar_at(self._truth.stamps[until])[:, :2]

    def map_at(self, time: float) -> MapSnapshot | None:
        """Return the final map."""
        return self._map

    def rtf_at(self, time: float) -> float:
        """Return the recorded real-time factor of a second; NaN beyond the record."""
        series = self.record["rtf"]["series"]
        return float(series[min(int(time - 1e-6), len(series) - 1)]) if series else math.nan

    def verdict_at(self, scan: int) -> str:
        """Return the verdict on the whole run."""
        return f"Verdict: {judge(self.record)}"

    @property
    def marks(self) -> tuple[tuple[float, str], ...]:
        """The end of a run that failed."""
        return () if succeeded(self.record) else ((float(self._truth.stamps[-1]), self.record["status"]),)

    def facts(self, scan: int, ate: float) -> Facts:
        """Return the figures until a scan."""
        held: dict[str, Any] = self.record
        stamp = float(self._truth.stamps[scan])
        c, final = held["config"], held["trajectory"].get("ate_rmse")
        return (
            ("run", f"{held['world']['name']}, {c['robot']}, {c['mapper']}, seed {held['seed']}"),
            ("time", f"{stamp:.1f} of {self._truth.stamps[-1]:.1f} s"),
            ("RTF", f"{self.rtf_at(stamp):.1f} (mean {held['rtf']['mean']:.1f})"),
            ("ATE", f"{ate:.3f} m" + ("" if final is None else f" (in all {final:.3f} m)")),
            ("map F1", "-" if held["map"].get("f1") is None else f"{held['map']['f1']:.2f}"),
            ("status", held["status"] + (f": {held['reason']}" if held["reason"] else "")),
        )


def unpacked_run(content: bytes, folder: Path) -> Path:
    """Extract the needed files of a zipped run, under fixed names.

    Raises:
        SourceError: it is no such archive, or holds no run.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = {PurePosixPath(e.filename).name: e for e in archive.infolist() if not e.is_dir()}
            missing = [name for name in FILES if name not in entries]
            if missing:
                raise SourceError(f"the archive holds no run: {', '.join(missing)} is not in it")
            taken = [name for name in (*FILES, *MAP_FILES) if name in entries]
            for name in taken:
                (folder / name).write_bytes(archive.read(entries[name]))
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, OSError) as error:
        raise SourceError(f"the archive cannot be read: {error}") from error
    if "map.yaml" in taken:
        _name_picture(folder)
    return folder


def _name_picture(folder: Path) -> None:
    """Set the picture of a map's YAML to `map.pgm`."""
    lines = (folder / "map.yaml").read_text(encoding="utf-8", errors="replace").splitlines()
    kept = [line for line in lines if not line.startswith("image:")]
    (folder / "map.yaml").write_text("\n".join(["image: map.pgm", *kept]) + "\n", encoding="utf-8")


def runs_in(folder: Path) -> dict[str, Path]:
    """Return the runs in a folder, or the folder's own run, newest first."""
    if (folder / "record.json").is_file():
        return {folder.name: folder}
    records = sorted(folder.glob("*/record.json"), key=lambda path: path.stat().st_mtime, reverse=True)
    return {path.parent.name: path.parent for path in records}
