"""How many failures do alarms report in time, and how many alarms are false?

    python benchmarks/watch.py drive [--data FOLDER] [--minutes 60] [--seeds 1-5] [--methods A,B] [--quick]
    python benchmarks/watch.py logs [--data FOLDER] [--quick]
    python benchmarks/watch.py evaluate

`drive` adds drives through the worlds of `verdict_study.py` to `watch_drives.csv`, and goes on where the last
call ended. A planar method maps the scans of one drive that the robot makes by its true pose. `logs` adds the
logs of simulated drives, and goes on, too: the paths that the C++ originals made of them, and those of our
methods with fewer, shorter and noisier scans. `evaluate` prints the reports of the methods themselves and the
alarms of the watch by family of worlds, by method and by the limit of the watch. The last row has a limit for
each family, set on the others: the one with the most failures noticed among those with at most one false
alarm in 30 minutes.

A failure is a drive that loses its way by the verdict's limits; its onset is the first time at which the ATE
over the last 5 m exceeds them. It is noticed within 5 s of its onset. An alarm is false if it begins more
than 5 s from any such time, in any drive.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.fidelity import recorded, unpacked
from benchmarks.steps import DATA, arguments, print_rows
from benchmarks.verdict_study import Site, configs, sites
from lirs_validation.experiment.run import prepare
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.metrics.failure import SOON, compare_alarms, window_errors
from lirs_validation.metrics.trajectory import associated, trajectory_errors
from lirs_validation.record.verdict import LIMITS
from lirs_wct import BoolArray, Imu, IntArray, LaserScan, Pose2, Trajectory, WctError
from lirs_wct.files import atomic_write
from lirs_wct.formats.drive_files import read_imu
from lirs_wct.option import read_names, read_numbers
from slam_baselines.mapper import MAPPERS, make_mapper
from slam_baselines.watch import LIMIT, Watch

TABLE = Path(__file__).with_name("watch_drives.csv")
PLANAR, CLOUDS = tuple(MAPPERS), ("kiss-icp", "small-gicp")
TRIED = (0.08, 0.09, 0.1, 0.11, 0.12, 0.13, 0.14, 0.17, 0.2)
"""Limits of the watch that are tried, meters."""
SOURCES = ("own", *map(str, TRIED))
"""Sources of alarms: the method itself, and the watch by its limit."""
HEADINGS = ("family", "world", "method", "seed", "onset", "healthy", *SOURCES)
"""Seconds of the onset, empty without a failure; healthy seconds; of each source the seconds from onset to
alarm, empty without, and behind a slash the false alarms."""
MOST_FALSE = 2.0
"""False alarms per hour that a limit may give."""
LOGS = ("logs", "originals")
"""Families of the table that are logs; the others are worlds."""
CHANGES = ("as logged", "every 4th scan", "noise of 0.2 m", "4 m of range")
ORIGINALS = ("hector", "cartographer_local", "slam_toolbox")
"""Online paths of C++ programs."""
Key = tuple[str, str, str, str]
"""Family, world, method and seed."""


class Online(NamedTuple):
    """A method's online poses with the truth and the odometry (n, 3), and its reports of a loss (n,)."""

    true: Trajectory
    odometry: Trajectory
    online: Trajectory
    lost: BoolArray

    def row(self) -> list[str]:
        """Return onset, healthy seconds, and the alarms of each source, as cells."""
        true, paths = self.true, (self.online, self.odometry)
        error, most = (trajectory_errors(true, path).ate_rmse for path in paths)
        errors, odometry = (window_errors(true.xy, path.xy) for path in paths)
        failing, stamps = errors > LIMITS.most_error(odometry), true.stamps
        fails = error > LIMITS.most_error(most) and failing.any()
        onset = float(stamps[failing.argmax()]) if fails else None
        sources = (self.lost, *(watched(self.online, self.odometry, limit) for limit in TRIED))
        found = [compare_alarms(stamps, failing, alarm, onset) for alarm in sources]
        cells = [f"{'' if each.delay is None else f'{each.delay:.1f}'}/{each.false}" for each in found]
        begin = "" if onset is None else f"{onset - stamps[0]:.1f}"
        return [begin, f"{found[0].healthy:.0f}", *cells]


def watched(path: Trajectory, odometry: Trajectory, limit: float) -> BoolArray:
    """Return (n,) whether the watch gives an alarm at each pose."""
    watch = Watch(limit)
    stamps = path.stamps.tolist()
    return np.array([watch.update(path.pose2(k), t, odometry.pose2(k)) for k, t in enumerate(stamps)])


def drive(options: argparse.Namespace) -> None:
    """Drive until the time is over or every method has its drives everywhere."""
    end, rows = time.monotonic() + 60 * options.minutes, stored()
    for seed in options.seeds:
        for site in list(sites(options.data))[:: 7 if options.quick else 1]:
            keys = {(site.family, site.name, method, str(seed)): method for method in options.methods}
            lacking = [method for key, method in keys.items() if key not in rows]
            if time.monotonic() > end:
                return
            try:
                for method, path in driven(site, seed, lacking):
                    rows[site.family, site.name, method, str(seed)] = path.row()
                    write(rows)
            except WctError as error:
                print(f"left out: {site.name}: {error}", flush=True)


def driven(site: Site, seed: int, methods: Sequence[str]) -> Iterator[tuple[str, Online]]:
    """Yield the path of each method; one drive serves all planar ones, since the robot follows the truth."""
    planar_ones, cache = [method for method in methods if method in PLANAR], ScenarioCache()
    if not methods:
        return
    (config,) = configs(site, "hector", (seed,))
    scenario = site.scenario(config)
    for name in (*planar_ones[:1], *(method for method in methods if method in CLOUDS)):
        lidar = "vlp16" if name in CLOUDS else None
        built = scenario.config
        config = replace(config, mapper=name, lidar=lidar, source=built.source, build=built.build)
        cache.put(replace(scenario, config=config))
        ready = prepare(config, scenarios=cache)
        with closing(ready.mapper):
            log = ready.log()
            for _ in ready.drive(log):
                pass
        truth, _, odometry = log.trajectories()
        online = Trajectory.from_poses(log.stamps, [log.in_plane(T) for T in log.estimates])
        yield name, Online(truth, odometry, online, np.array(log.lost))
        if name in CLOUDS:
            continue
        for method in planar_ones[1:]:
            online, lost = mapped(method, seed, log.scans, log.odometry, log.imu)
            yield method, Online(truth, odometry, online, lost)


def mapped(
    method: str,
    seed: int,
    scans: Iterable[LaserScan],
    odometry: Iterable[Pose2 | None],
    readings: Iterable[Imu],
) -> tuple[Trajectory, BoolArray]:
    """Return a method's online poses, and where it reported that it was lost."""
    mapper, stamps, poses, lost = make_mapper(method, seed=seed), [], [], []
    for scan, T_odom_base, imu in zip(scans, odometry, readings, strict=True):
        poses.append(mapper.update(scan, T_odom_base, imu))
        lost.append(mapper.lost)
        stamps.append(scan.stamp)
    return Trajectory.from_poses(stamps, poses), np.array(lost)


def logs(options: argparse.Namespace) -> None:
    """Add the logs of simulated drives, with the paths of C++ originals and of our methods."""
    rows = stored()
    for run in sorted((options.data / "fidelity").iterdir())[: 1 if options.quick else None]:
        log, scans = recorded(run)
        readings, truth = read_imu(run / "imu.csv.gz"), unpacked(run / "truth.tum.gz")
        odometry = Trajectory.from_poses(log.stamps, [pose for pose in log.odometry if pose is not None])
        for file in ORIGINALS:
            path = unpacked(run / f"original_{file}.tum.gz")
            rows["originals", run.name, file, "1"] = aligned(truth, odometry, path, None).row()
        for change in CHANGES:
            chosen = slice(None, None, 4 if change == CHANGES[1] else 1)
            changed = [degraded(scan, change) for scan in scans[chosen]]
            for method in PLANAR:
                key = ("logs", f"{run.name}, {change}", method, "1")
                if key not in rows:
                    found = mapped(method, 1, changed, log.odometry[chosen], readings[chosen])
                    rows[key] = aligned(truth, odometry, *found).row()
                    write(rows)


def degraded(scan: LaserScan, change: str) -> LaserScan:
    """Return a scan with noise or less range."""
    ranges = scan.ranges
    if change == CHANGES[2]:
        rng = np.random.default_rng(round(1000 * scan.stamp))
        ranges = (ranges + 0.2 * rng.standard_normal(len(ranges))).astype(np.float32)
    if change == CHANGES[3]:
        ranges = np.where(ranges < 4.0, ranges, np.float32(np.nan))
    return replace(scan, ranges=ranges)


def aligned(truth: Trajectory, odometry: Trajectory, online: Trajectory, lost: BoolArray | None) -> Online:
    """Return the poses at the common stamps."""
    i, j = associated(truth.stamps, online.stamps)
    k = associated(truth.stamps[i], odometry.stamps)[1]
    told = np.zeros(len(j), bool) if lost is None else lost[j]
    return Online(select(truth, i), select(odometry, k), select(online, j), told)


def select(path: Trajectory, chosen: IntArray) -> Trajectory:
    """Return some poses of a path."""
    return Trajectory(path.stamps[chosen], path.positions[chosen], path.quaternions[chosen])


def evaluate(_: argparse.Namespace) -> None:
    """Print how often failures were noticed, and alarms false, by family, by method and by limit."""
    rows, default = stored(), str(LIMIT)
    worlds = {key: row for key, row in rows.items() if key[0] not in LOGS}
    families = list(dict.fromkeys(key[0] for key in worlds))
    for place, name, some in ((0, "family", rows), (2, "method", worlds)):
        lines = []
        for group in [*dict.fromkeys(key[place] for key in some), "all worlds"]:
            chosen = worlds if group == "all worlds" else some
            mine = [row for key, row in chosen.items() if group in ("all worlds", key[place])]
            own, watch = (figures((source, row) for row in mine) for source in ("own", default))
            line = {name: group, "drives": len(mine), "hours": hours(mine)} | own
            lines.append(line | {f"watch: {key}": value for key, value in watch.items() if key != "failures"})
        print_rows(lines, f"By {name}; the watch with its default of {default} m", width=150)
    lines = [{"limit, m": limit} | figures((limit, row) for row in worlds.values()) for limit in SOURCES[1:]]
    others = {family: best_limit(worlds, family) for family in families}
    lines.append(
        {"limit, m": "of the others"} | figures((others[key[0]], row) for key, row in worlds.items())
    )
    print_rows(lines, "By limit of the watch, all worlds", width=110)


def figures(rows: Iterable[tuple[str, Sequence[str]]]) -> dict[str, Any]:
    """Return the figures of a source of alarms for each row."""
    pairs = list(rows)
    noticed, false, delay = counts(pairs)
    failures = sum(bool(row[0]) for _, row in pairs)
    return {
        "failures": failures,
        "noticed": f"{noticed} ({100 * noticed / max(1, failures):.0f} %)",
        "delay, s": delay,
        "false in 30 min": false / (2 * hours([row for _, row in pairs])),
    }


def hours(rows: Iterable[Sequence[str]]) -> float:
    """Return the healthy hours of some drives."""
    return sum(float(row[1]) for row in rows) / 3600


def counts(rows: Iterable[tuple[str, Sequence[str]]]) -> tuple[int, int, float | None]:
    """Return failures noticed, false alarms, and the median delay, of a source of alarms for each row."""
    delays, false = list[float](), 0
    for source, row in rows:
        delay, _, number = row[2 + SOURCES.index(source)].partition("/")
        false += int(number)
        if row[0] and delay and float(delay) <= SOON:
            delays.append(float(delay))
    return len(delays), false, float(np.median(delays)) if delays else None


def best_limit(rows: dict[Key, list[str]], family: str) -> str:
    """Return the limit that notices most among those with few false alarms in the other families."""
    others = [row for key, row in rows.items() if key[0] != family]
    found = {source: counts((source, row) for row in others) for source in SOURCES[1:]}
    fit = {
        source: noticed
        for source, (noticed, false, _) in found.items()
        if false <= MOST_FALSE * hours(others)
    }
    return max(fit, key=lambda source: (fit[source], float(source))) if fit else SOURCES[-1]


def stored() -> dict[Key, list[str]]:
    """Return the rows of the table."""
    lines = TABLE.read_text(encoding="utf-8").splitlines()[1:] if TABLE.exists() else []
    return {(row[0], row[1], row[2], row[3]): row[4:] for row in csv.reader(lines)}


def write(rows: dict[Key, list[str]]) -> None:
    """Write the table."""
    with atomic_write(TABLE) as part, part.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(
            [HEADINGS, *([*key, *row] for key, row in rows.items())]
        )


def main(words: Sequence[str] | None = None) -> None:
    """Drive, map logs or evaluate."""
    defaults: dict[str, Any] = {"action": "evaluate", "data": DATA, "minutes": 60.0, "seeds": "1-5"}
    defaults |= {"methods": ",".join((*PLANAR, *CLOUDS)), "quick": False}
    options = arguments(__doc__, "action", words=words, **defaults)
    options.methods = read_names(options.methods, "--methods")
    options.seeds = read_numbers("1" if options.quick else options.seeds, "--seeds")
    {"drive": drive, "logs": logs, "evaluate": evaluate}[options.action](options)


if __name__ == "__main__":
    main()
