"""Quality of mapped logs without truth: rank correlation with the true error, and share of right conclusions.

    python benchmarks/log_quality.py [--log NAME ...] [--change NAME ...] [--mapper NAME ...] [--data FOLDER]
        [-o FOLDER] [--csv FILE]
    python benchmarks/log_quality.py --from benchmarks/log_quality.csv

Each log is mapped by each mapper, as logged and changed: thinned, with worse odometry, noisy ranges, missing
stretches, a late clock. The logs are four real ones, and drives of the simulation. With a folder, finished
results are kept there and the same command continues. --from prints the tables of an earlier measurement.

True error: ATE against the reference poses, of the Intel log the mean translational error of the relations.
A path is right if it does not lose its way by the limits of verdicts, and its error is at most `RIGHT` of its
length. Threshold and share of right conclusions of a log left out: the threshold is that of the other logs.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import json
import math
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from benchmarks.slam import LOGS as REAL, REFERENCES, RELATIONS
from benchmarks.steps import DATA
from lirs_envs.generators.floor_plan import floor_plan
from lirs_validation import map_log, validate
from lirs_validation.metrics.mapped_log import reference_errors
from lirs_validation.metrics.trajectory import rms
from lirs_validation.record.verdict import AGREEING, LIMITS, conclude_log
from lirs_wct.files import atomic_write
from lirs_wct.formats.drive_files import read_tum, write_tum
from lirs_wct.formats.map_server import write_map
from lirs_wct.geometry import OccupancyGrid, Pose2, Trajectory

RIGHT = 0.005
"""Largest error of a right path, share of its length: half a meter in 100 m."""
TRIED = tuple(round(0.1 + 0.01 * k, 2) for k in range(51))
"""Limits of the revisit residual that are tried, meters."""
SECOND = "hector", "cartographer"
"""Mappers that the others and the first of them are compared with, as `map` does."""
MAPPED = ("hector", "hector_original", "cartographer", "gmapping")
YAW_NOISE = math.radians(4)
"""Of the worse odometry, radians per square root of a meter."""
STEP_NOISE = 0.1
"""Of the worse odometry, share of a step."""
RANGE_NOISE, MAX_NOISY = 0.05, 19.0
"""Standard deviation of the noise of ranges, and largest range that has it, meters."""
BEAMS = 4
"""Every so many beams remain of a thinned scan."""
STRETCH, MISSING = 100, 20
"""Of so many scans, the last so many are missing."""
LATE = 0.5
"""Delay of a late odometry, seconds."""
FIGURES = ("revisit_residual", "difference", "pass_residual")
"""Compared with the true error."""
COLUMNS = (
    *("log", "change", "mapper", "status", "length", "odometry_error", "error", "revisited", "second"),
    *("second_residual", "longest_gap", *FIGURES),
)


def main() -> None:
    """Map what is asked for, write the results, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    for name, legal in (("log", LOGS), ("change", CHANGES), ("mapper", MAPPED)):
        parser.add_argument(f"--{name}", nargs="+", default=list(legal), choices=list(legal))
    parser.add_argument("--data", type=Path, default=DATA)
    for flags in (("-o", "--output"), ("--csv",)):
        parser.add_argument(*flags, type=Path)
    parser.add_argument("--from", dest="stored", type=Path)
    given = parser.parse_args()
    if given.stored:
        rows = stored_rows(given.stored)
    else:
        with tempfile.TemporaryDirectory() as temporary:
            rows = list(measured(given, given.output or Path(temporary)))
    if given.csv:
        with atomic_write(given.csv) as path, path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            for row in rows:
                cells = {name: row.get(name) for name in COLUMNS}
                writer.writerow({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in cells.items()})
    print(table(rows), conclusions(rows), sep="\n\n")


def stored_rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows of an earlier measurement; an empty cell is None."""
    with path.open(encoding="utf-8", newline="") as file:
        return [{name: _value(name, text) for name, text in row.items()} for row in csv.DictReader(file)]


def _value(name: str, text: str) -> str | float | None:
    return text if name in COLUMNS[:4] or name == "second" else float(text) if text else None


def measured(given: argparse.Namespace, out: Path) -> Iterator[dict[str, Any]]:
    """Yield the row of each result; finished ones are read from the folder."""
    out.mkdir(parents=True, exist_ok=True)
    for log in given.log:
        source, truth = source_of(log, given.data, out)
        with gzip.open(source, "rt", encoding="utf-8") as file:
            lines = file.readlines()
        for change in given.change:
            path = out / f"{log}-{change.replace(' ', '-').replace(',', '')}.clf.gz"
            with atomic_write(path) as temporary, gzip.open(temporary, "wt", encoding="utf-8") as kept:
                kept.writelines(CHANGES[change](lines))
            mappers = dict.fromkeys((*given.mapper, *SECOND))
            found = {name: result(name, path, truth) for name in mappers}
            for name in given.mapper:
                row, trajectory = found[name]
                second = SECOND[name == SECOND[0]]
                other, path_of_second = found[second]
                row |= {"log": log, "change": change, "second": second}
                row |= {"second_residual": other.get("revisit_residual")}
                yield row | {"difference": rms(reference_errors(trajectory, path_of_second).position)}


def source_of(log: str, data: Path, out: Path) -> tuple[Path, dict[str, Any]]:
    """Return the file of a log and its truth, as options of `map`; drives are made first."""
    if log in REAL:
        logs = data / "logs"
        known = {"reference": REFERENCES[log]} if log in REFERENCES else {"relations": RELATIONS}
        return logs / REAL[log], {name: logs / path for name, path in known.items()}
    run = out / log
    if not run.is_dir():
        walls = floor_plan(np.random.default_rng(DRIVES[log])).walls
        share = np.where(walls.solid, 1.0, 0.0)
        write_map(out / f"{log}-plan", OccupancyGrid.from_probability(share, walls.resolution, walls.origin))
        made = validate(str(out / f"{log}-plan.yaml"), mapper="hector", seconds=SECONDS, seed=1, out=out)
        Path(str(made.folder)).rename(run)
    return run / "scans.clf.gz", {"reference": run / "truth.tum"}


def result(mapper: str, log: Path, truth: Mapping[str, Any]) -> tuple[dict[str, Any], Trajectory]:
    """Return row and trajectory of a mapper on a log: mapped now, or as an earlier command left them."""
    done = log.with_name(f"{log.name.removesuffix('.clf.gz')}-{mapper}.json")
    path = done.with_suffix(".tum")
    if not done.is_file():
        mapped = map_log(log, mapper=mapper, **truth)
        record = mapped.record
        kind, error = ("reference", "ate_rmse") if "reference" in truth else ("relations", "translation_mean")
        status = "unfit" if record.log["unfit"] else record.status
        row = {"mapper": mapper, "status": status, "length": record.log["odometry_length"]}
        row |= {"error": record.accuracy[kind][error], "odometry_error": record.odometry[kind][error]}
        row |= record.quality
        write_tum(path, mapped.trajectory)
        with atomic_write(done) as temporary:
            temporary.write_text(json.dumps(row) + "\n", encoding="utf-8")
    return json.loads(done.read_text(encoding="utf-8")), read_tum(path)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the rank correlation of each figure with the true error as Markdown."""
    logs = list(dict.fromkeys(row["log"] for row in rows))
    lines = [f"| figure | {' | '.join(logs)} | median |", f"|---|{'---:|' * (len(logs) + 1)}"]
    for name in FIGURES:
        found = [correlation([row for row in rows if row["log"] == log], name) for log in logs]
        cells = " | ".join(f"{value:.2f}" for value in (*found, float(np.nanmedian(found))))
        lines.append(f"| `{name}` | {cells} |")
    return "\n".join(lines)


def conclusions(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return counts of right and wrong conclusions by log and by mapper as Markdown.

    Of each log, also the threshold that suits the other logs best, and the right conclusions by it.
    """
    heads = (
        *("", "right paths", "probably right: right, wrong", "doubtful: wrong, right", "cannot be checked"),
        *("right conclusions", "limit of the other logs", "right conclusions by it"),
    )
    lines = [f"| {' | '.join(heads)} |", f"|---|{'---:|' * (len(heads) - 1)}"]
    both = [0, 0]
    for key in ("log", "mapper"):
        for name in dict.fromkeys(row[key] for row in rows):
            mine = [row for row in rows if row[key] == name]
            cells = [name, *confusion(mine)]
            if key == "log":
                limit = best_limit([row for row in rows if row["log"] != name])
                found = [is_told(row, limit) for row in mine]
                counts = found.count(True), len(found) - found.count(None)
                both = [total + count for total, count in zip(both, counts, strict=True)]
                cells += [f"{limit:.2f}", f"{counts[0]} of {counts[1]}"]
            lines.append(f"| {' | '.join(cells + [''] * (len(heads) - len(cells)))} |")
    cells = ["all", *confusion(rows), f"{best_limit(rows):.2f} (all logs)", f"{both[0]} of {both[1]}"]
    return "\n".join((*lines, f"| {' | '.join(cells)} |"))


def confusion(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the counts of paths and of their conclusions as texts."""
    pairs = Counter((conclusion(row), is_right(row)) for row in rows)
    told = [is_told(row) for row in rows]
    return [
        f"{sum(map(is_right, rows))} of {len(rows)}",
        f"{pairs['probably right', True]}, {pairs['probably right', False]}",
        f"{pairs['doubtful', False]}, {pairs['doubtful', True]}",
        f"{told.count(None)}",
        f"{told.count(True)} of {len(told) - told.count(None)}",
    ]


def is_right(row: Mapping[str, Any]) -> bool:
    """Return whether a path is right by its true error."""
    most = LIMITS.times_odometry * row["odometry_error"] + LIMITS.over_odometry
    return bool(row["error"] <= min(most, RIGHT * row["length"]))


def conclusion(row: Mapping[str, Any], limit: float = AGREEING) -> str:
    """Return the conclusion of `lirs-wct map` without truth, by another limit of the revisit residual."""
    own, other = (
        None if row[name] is None else row[name] * AGREEING / limit
        for name in ("revisit_residual", "second_residual")
    )
    second = {"mapper": row["second"], "revisit_residual": other, "command": ""}
    quality = {**row, "revisit_residual": own, "second": second}
    fault = "" if row["status"] == "ok" else row["status"]
    return conclude_log({"quality": quality, "reason": fault, "log": {}})[0]


def is_told(row: Mapping[str, Any], limit: float = AGREEING) -> bool | None:
    """Return whether the conclusion on a path is right; None where it cannot be checked."""
    found = conclusion(row, limit)
    return None if found == "cannot be checked" else (found == "probably right") == is_right(row)


def best_limit(rows: Sequence[Mapping[str, Any]]) -> float:
    """Return the smallest limit of the revisit residual with most right conclusions, meters."""
    counts = [sum(is_told(row, limit) is True for row in rows) for limit in TRIED]
    best = [limit for limit, count in zip(TRIED, counts, strict=True) if count == max(counts)]
    return min(best)


def correlation(rows: Iterable[Mapping[str, Any]], figure: str) -> float:
    """Return Spearman's rank correlation of a figure with the true error, over results that have both."""
    pairs = [(row["error"], row[figure]) for row in rows if row[figure] is not None]
    if len(pairs) < 3 or not np.ptp(pairs, axis=0).all():
        return math.nan
    errors, figures = np.array(pairs).T
    return float(spearmanr(errors, figures).statistic)


def thin(lines: Iterable[str], every: int) -> Iterator[str]:
    """Yield the lines of a CARMEN log with every k-th scan."""
    scans = count()
    yield from (line for line in lines if not is_scan(line) or next(scans) % every == 0)


def drop_stretches(lines: Iterable[str]) -> Iterator[str]:
    """Yield the lines of a CARMEN log without the last `MISSING` of every `STRETCH` scans."""
    scans = count()
    yield from (line for line in lines if not is_scan(line) or next(scans) % STRETCH < STRETCH - MISSING)


def is_scan(line: str) -> bool:
    """Return whether a line holds a scan."""
    return line.startswith(("FLASER", "ROBOTLASER1"))


def ranges_of(tokens: Sequence[str]) -> slice:
    """Return where the ranges of a scan's words are."""
    n = 1 if tokens[0] == "FLASER" else 8
    return slice(n + 1, n + 1 + int(tokens[n]))


def pose_of(tokens: Sequence[str]) -> int | None:
    """Return where the robot's pose begins in the words of a message; None without one."""
    if tokens[:1] == ["ODOM"]:
        return 1
    return len(tokens) - (6 if tokens[0] == "FLASER" else 11) if is_scan(" ".join(tokens[:1])) else None


def thin_beams(lines: Iterable[str]) -> Iterator[str]:
    """Yield the lines of a CARMEN log with every fourth beam; `ROBOTLASER1` messages state the angles."""
    for line in lines:
        tokens = line.split()
        if not is_scan(line):
            yield line
            continue
        ranges = tokens[ranges_of(tokens)]
        if tokens[0] == "FLASER":  # all three sizes of these logs see 180 degrees
            step = math.pi / (len(ranges) - len(ranges) % 2)
            start, most, rest = -math.pi / 2, 81.0, [*tokens[-9:-3], *"00000", *tokens[-3:]]
        else:
            start, step, most = (float(tokens[k]) for k in (2, 4, 5))
            rest = tokens[-14:]
        kept = ranges[::BEAMS]
        geometry = f"{start:.9f} {step * BEAMS * (len(kept) - 1):.9f} {step * BEAMS:.12f} {most:.3f}"
        yield " ".join(("ROBOTLASER1 0", geometry, f"0 0 {len(kept)}", *kept, "0", *rest)) + "\n"


def noisy(lines: Iterable[str], seed: int = 1) -> Iterator[str]:
    """Yield the lines of a CARMEN log with noise in its ranges."""
    rng = np.random.default_rng(seed)
    for line in lines:
        tokens = line.split()
        if is_scan(line):
            at = ranges_of(tokens)
            ranges = np.array(tokens[at], dtype=float)
            noise = RANGE_NOISE * rng.standard_normal(len(ranges))
            ranges += np.where((ranges > 4 * RANGE_NOISE) & (ranges < MAX_NOISY), noise, 0.0)
            tokens[at] = (f"{value:.3f}" for value in ranges)
            line = " ".join(tokens) + "\n"
        yield line


def worsened(lines: Iterable[str], seed: int = 1) -> Iterator[str]:
    """Yield the lines of a CARMEN log with noise in its odometry."""
    rng = np.random.default_rng(seed)

    def drifting(poses: Sequence[Pose2], _: Sequence[float]) -> Iterator[Pose2]:
        moved = poses[0]
        yield moved
        for last, pose in pairwise(poses):
            step = last.inverse() @ pose
            length = math.hypot(step.x, step.y)
            scale = 1 + STEP_NOISE * rng.standard_normal()
            turn = step.yaw + YAW_NOISE * math.sqrt(length) * rng.standard_normal()
            moved = moved @ Pose2(scale * step.x, scale * step.y, turn)
            yield moved

    yield from with_odometry(lines, drifting)


def late(lines: Iterable[str]) -> Iterator[str]:
    """Yield the lines of a CARMEN log with the odometry of an earlier time."""

    def delayed(poses: Sequence[Pose2], stamps: Sequence[float]) -> Iterator[Pose2]:
        order = np.argsort(stamps, kind="stable")
        rows = np.array([pose.as_array() for pose in poses])[order]
        rows[:, 2] = np.unwrap(rows[:, 2])
        times = np.asarray(stamps)
        columns = (np.interp(times - LATE, times[order], column) for column in rows.T)
        yield from (Pose2(*row) for row in np.column_stack([*columns]).tolist())

    yield from with_odometry(lines, delayed)


def with_odometry(
    lines: Iterable[str], change: Callable[[Sequence[Pose2], Sequence[float]], Iterable[Pose2]]
) -> Iterator[str]:
    """Yield the lines of a CARMEN log with changed poses of the robot; the laser moves with it."""
    words = [line.split() for line in lines]
    at = [pose_of(tokens) for tokens in words]
    known = [(tokens, k) for tokens, k in zip(words, at, strict=True) if k is not None]
    before = [Pose2(*map(float, tokens[k : k + 3])) for tokens, k in known]
    stamps = [float(tokens[-3]) for tokens, _ in known]
    for (tokens, k), old, new in zip(known, before, change(before, stamps), strict=True):
        places = [(k, new)]
        if tokens[0] != "ODOM":
            mount = old.inverse() @ Pose2(*map(float, tokens[k - 3 : k]))
            places.append((k - 3, new @ mount))
        for first, pose in places:
            tokens[first : first + 3] = (f"{value:.6f}" for value in pose.as_array())
    yield from (" ".join(tokens) + "\n" for tokens in words)


CHANGES: dict[str, Callable[[Sequence[str]], Iterable[str]]] = {
    "none": lambda lines: lines,
    "every 2nd scan": lambda lines: thin(lines, 2),
    "every 4th scan": lambda lines: thin(lines, 4),
    "worse odometry": worsened,
    "worse odometry, every 2nd scan": lambda lines: thin(worsened(lines), 2),
    "worse odometry, every 4th scan": lambda lines: thin(worsened(lines), 4),
    "every 4th beam": thin_beams,
    "noisy ranges": noisy,
    "missing stretches": drop_stretches,
    "late odometry": late,
}
"""Changes of a log's lines, by their names."""
DRIVES = {f"plan-{seed}": seed for seed in (1, 2, 3, 4)}
"""Simulated drives through generated floor plans, and the seeds of these."""
SECONDS = 200.0
"""Time of a simulated drive."""
LOGS = (*REAL, *DRIVES)


if __name__ == "__main__":
    main()
