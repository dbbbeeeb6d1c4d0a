"""Rank correlation of quality figures without truth with the true error, on real logs.

    python benchmarks/log_quality.py [--log NAME ...] [--mapper NAME ...] [--every 1 2 4] [--data FOLDER]
        [-o FOLDER] [--csv FILE]
    python benchmarks/log_quality.py --from benchmarks/log_quality.csv

Every k-th scan of each log is mapped by each mapper, with the odometry as logged and with a worse one. With a
folder, finished results are kept there and the same command continues. True error: ATE against the reference
poses, of the Intel log the mean translational error of the relations. The last line counts results that are
more than a meter off, and `ok`. --from prints the table of an earlier measurement.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import json
import math
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from benchmarks.slam import LOGS, REFERENCES, RELATIONS
from benchmarks.steps import DATA
from lirs_validation import map_log
from lirs_validation.metrics.mapped_log import reference_errors
from lirs_validation.metrics.trajectory import rms
from lirs_wct.files import atomic_write
from lirs_wct.formats.drive_files import read_tum, write_tum
from lirs_wct.geometry import Pose2, Trajectory

FAR = 1.0
"""Error above which a result must not be `ok`, meters."""
SECOND = "hector", "cartographer"
"""Mappers that the others and the first of them are compared with, as `map` does."""
MAPPED = ("hector", "hector_original", "cartographer", "gmapping")
YAW_NOISE = math.radians(4)
"""Of the worse odometry, radians per square root of a meter."""
STEP_NOISE = 0.1
"""Of the worse odometry, share of a step."""
FIGURES = ("revisit_residual", "difference", "wall_thickness", "contradicted", "pass_residual")
"""Compared with the true error."""
COLUMNS = ("log", "odometry", "every", "mapper", "status", "error", *FIGURES)


def main() -> None:
    """Map what is asked for, write the results, and print the correlations."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--log", nargs="+", default=list(LOGS), choices=list(LOGS))
    parser.add_argument("--mapper", nargs="+", default=list(MAPPED))
    parser.add_argument("--every", nargs="+", type=int, default=[1, 2, 4])
    parser.add_argument("--data", type=Path, default=DATA / "logs")
    for flags in (("-o", "--output"), ("--csv",)):
        parser.add_argument(*flags, type=Path)
    parser.add_argument("--from", dest="stored", type=Path)
    given = parser.parse_args()
    if given.stored:
        with given.stored.open(encoding="utf-8", newline="") as file:
            rows: list[dict[str, Any]] = list(csv.DictReader(file))
    else:
        with tempfile.TemporaryDirectory() as temporary:
            rows = list(measured(given, given.output or Path(temporary)))
    if given.csv:
        with atomic_write(given.csv) as path, path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            for row in rows:
                cells = {name: row[name] for name in COLUMNS}
                writer.writerow({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in cells.items()})
    print(table(rows))


def measured(given: argparse.Namespace, out: Path) -> Iterator[dict[str, Any]]:
    """Yield the row of each result; finished ones are read from the folder."""
    out.mkdir(parents=True, exist_ok=True)
    for log in given.log:
        with gzip.open(given.data / LOGS[log], "rt", encoding="utf-8") as file:
            lines = file.readlines()
        for odometry, source in (("logged", lines), ("worse", list(worsened(lines)))):
            for every in given.every:
                path = out / f"{log}-{odometry}-every{every}.clf.gz"
                with atomic_write(path) as temporary, gzip.open(temporary, "wt", encoding="utf-8") as kept:
                    kept.writelines(thin(source, every))
                case = {"log": log, "odometry": odometry, "every": every}
                mappers = dict.fromkeys((*given.mapper, *SECOND))
                found = {name: result(name, case, path, given.data) for name in mappers}
                for name in given.mapper:
                    row, trajectory = found[name]
                    second = found[SECOND[name == SECOND[0]]][1]
                    yield row | {"difference": rms(reference_errors(trajectory, second).position)}


def result(mapper: str, case: Mapping[str, Any], log: Path, data: Path) -> tuple[dict[str, Any], Trajectory]:
    """Return row and trajectory of a mapper on a log: mapped now, or as an earlier command left them."""
    done = log.with_name(f"{log.name.removesuffix('.clf.gz')}-{mapper}.json")
    path = done.with_suffix(".tum")
    if not done.is_file():
        name = case["log"]
        known = name in REFERENCES
        truth: dict[str, Any] = (
            {"reference": data / REFERENCES[name]} if known else {"relations": data / RELATIONS}
        )
        mapped = map_log(log, mapper=mapper, **truth)
        record = mapped.record
        accuracy = record.accuracy["reference" if known else "relations"]
        row = {"mapper": mapper, "status": record.status}
        row |= {"error": accuracy["ate_rmse" if known else "translation_mean"]}
        row |= record.quality | {"contradicted": record.trajectory["contradicted"]}
        write_tum(path, mapped.trajectory)
        with atomic_write(done) as temporary:
            temporary.write_text(json.dumps(row) + "\n", encoding="utf-8")
    return {**case, **json.loads(done.read_text(encoding="utf-8"))}, read_tum(path)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the rank correlation of each figure with the true error as Markdown."""
    logs = list(dict.fromkeys(row["log"] for row in rows))
    lines = [f"| figure | {' | '.join(logs)} | median |", f"|---|{'---:|' * (len(logs) + 1)}"]
    for name in FIGURES:
        found = [correlation([row for row in rows if row["log"] == log], name) for log in logs]
        cells = " | ".join(f"{value:.2f}" for value in (*found, float(np.median(found))))
        lines.append(f"| `{name}` | {cells} |")
    counts = ", ".join(f"{log} {sum(row['log'] == log for row in rows)}" for log in logs)
    far = [row["status"] for row in rows if float(row["error"]) > FAR]
    return "\n".join((*lines, f"Results: {counts}. Off by over {FAR:g} m: {len(far)}, {far.count('ok')} ok."))


def correlation(rows: Iterable[Mapping[str, Any]], figure: str) -> float:
    """Return Spearman's rank correlation of a figure with the true error, over results that have both."""
    pairs = [(float(row["error"]), float(row[figure])) for row in rows if row[figure] not in (None, "")]
    if len(pairs) < 3:
        return math.nan
    errors, figures = np.array(pairs).T
    return float(spearmanr(errors, figures).statistic)


def thin(lines: Iterable[str], every: int) -> Iterator[str]:
    """Yield the lines of a CARMEN log with every k-th scan."""
    scans = count()
    yield from (line for line in lines if not line.startswith("FLASER") or next(scans) % every == 0)


def worsened(lines: Iterable[str], seed: int = 1) -> Iterator[str]:
    """Yield the lines of a CARMEN log with noise in its odometry."""
    rng = np.random.default_rng(seed)
    last: Pose2 | None = None
    moved = Pose2()
    for line in lines:
        name, *tokens = line.split()
        if name not in ("FLASER", "ODOM"):
            yield line
            continue
        at = len(tokens) - 6 if name == "FLASER" else 0  # of the odometry's pose
        pose = Pose2(*map(float, tokens[at : at + 3]))
        if last is None:
            moved = pose
        else:
            step = last.inverse() @ pose
            length = math.hypot(step.x, step.y)
            scale = 1 + STEP_NOISE * rng.standard_normal()
            turn = step.yaw + YAW_NOISE * math.sqrt(length) * rng.standard_normal()
            moved = moved @ Pose2(scale * step.x, scale * step.y, turn)
        last = pose
        tokens[at : at + 3] = (f"{value:.6f}" for value in (moved.x, moved.y, moved.yaw))
        if name == "FLASER":
            tokens[at - 3 : at] = tokens[at : at + 3]
        yield " ".join((name, *tokens)) + "\n"


if __name__ == "__main__":
    main()
