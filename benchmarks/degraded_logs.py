"""Status of mappers on thinned logs: a trajectory that is more than a meter off must not be `ok`.

    python benchmarks/degraded_logs.py [--log NAME ...] [--every 1 2 3 4 5] [--offset 0] [--share 1]
        [--mapper NAME ...] [--seeds 3] [--data FOLDER] [-o FOLDER]

Every k-th scan of each log is mapped, from the scan `offset` on. One line per run; with a folder, finished
runs are kept there and the same command continues. ATE: RMSE after rigid alignment with the reference poses.
The Intel log has none: there the reference is hector's trajectory of the whole log (relations: .018 m), a
proxy.
"""

from __future__ import annotations

import argparse
import gzip
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks.slam import DATA, LOGS, REFERENCES, seeded
from lirs_validation import map_log
from lirs_wct.files import atomic_write
from lirs_wct.formats.tum import write_tum
from slam_baselines.mapper import MAPPERS

FAR = 1.0
"""ATE above which a result must not be `ok`, meters."""
PROXY = "hector"
"""Mapper whose trajectory of the whole log is the reference where the data hold none."""
COLUMNS = ("log", "every", "offset", "mapper", "seed", "ate", "odometry_ate", "lost", "scans", "status")


def main() -> None:
    """Map every log, thinning, mapper and seed, and print a line for each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--log", nargs="+", default=["csail", "intel"], choices=list(LOGS))
    parser.add_argument("--every", nargs="+", type=int, default=[1, 2, 3, 4, 5], help="keep every k-th scan")
    parser.add_argument("--offset", type=int, default=0, help="first scan that is kept")
    parser.add_argument("--share", type=float, default=1.0, help="share of each log, from its start")
    parser.add_argument("--mapper", nargs="+", default=["hector", "cartographer", "gmapping"])
    parser.add_argument("--seeds", type=int, default=3, help="of mappers that draw random numbers")
    parser.add_argument("--data", type=Path, default=DATA, help=f"folder with {', '.join(LOGS)}")
    parser.add_argument("-o", "--output", type=Path, help="keep the runs there")
    given = parser.parse_args()
    for name in given.mapper:
        if name not in MAPPERS:
            parser.error(f"mapper {name}: legal are {', '.join(MAPPERS)}")
    with tempfile.TemporaryDirectory() as temporary:
        rows = list(measured(given, given.output or Path(temporary)))
    far = [row for row in rows if row["ate"] > FAR]
    print(f"ATE > {FAR:g} m: {len(far)} of {len(rows)}, of these ok: {count(far, ok=True)}")
    good = [row for row in rows if row["ate"] <= FAR / 2]
    print(f"ATE <= {FAR / 2:g} m: {len(good)} of {len(rows)}, of these not ok: {count(good, ok=False)}")


def count(rows: Sequence[dict[str, Any]], *, ok: bool) -> int:
    """Return the number of rows whose status is `ok`, or is not."""
    return sum((row["status"] == "ok") == ok for row in rows)


def measured(given: argparse.Namespace, out: Path) -> Iterator[dict[str, Any]]:
    """Yield the row of each run, and print it; finished runs are read from the folder."""
    out.mkdir(parents=True, exist_ok=True)
    print("\t".join(COLUMNS))
    for log in given.log:
        reference = reference_of(log, given.data, out)
        for every in given.every:
            thinned = thin(given.data / LOGS[log], out, log, every, given.offset, given.share)
            for mapper in given.mapper:
                for seed in range(1, 1 + (given.seeds if seeded(mapper) else 1)):
                    case = {"log": log, "every": every, "offset": given.offset}
                    case |= {"mapper": mapper, "seed": seed}
                    row = run(case, thinned, reference, out)
                    print("\t".join(shown(row[column]) for column in COLUMNS), row["reason"], flush=True)
                    yield row


def run(case: dict[str, Any], thinned: Path, reference: Path, out: Path) -> dict[str, Any]:
    """Return the row of a run: mapped now, or as an earlier command left it."""
    stem = f"{thinned.name.removesuffix('.clf.gz')}-{case['mapper']}-s{case['seed']}"
    done = out / f"{stem}.json"
    if done.is_file():
        found: dict[str, Any] = json.loads(done.read_text(encoding="utf-8"))
        return found
    mapped = map_log(thinned, mapper=case["mapper"], seed=case["seed"], reference=reference)
    record = mapped.record
    row = case | {
        "ate": record.accuracy["reference"]["ate_rmse"],
        "odometry_ate": record.odometry["reference"]["ate_rmse"],
        "lost": record.mapper["lost"],
        "scans": record.log["scans"],
        "status": record.status,
        "reason": record.reason,
    }
    write_tum(out / f"{stem}.tum", mapped.trajectory)
    with atomic_write(done) as path:
        path.write_text(json.dumps(row) + "\n", encoding="utf-8")
    return row


def thin(path: Path, out: Path, name: str, every: int, offset: int, share: float = 1.0) -> Path:
    """Write a log with every k-th scan of a share of it; return its path."""
    with gzip.open(path, "rt", encoding="utf-8") as file:
        lines = file.readlines()
    thinned = out / f"{name}-every{every}-from{offset}-share{share:g}.clf.gz"
    scans, kept = -1, []
    for line in lines[: round(len(lines) * share)]:
        scan = line.startswith("FLASER")
        scans += scan
        if not scan or (scans >= offset and (scans - offset) % every == 0):
            kept.append(line)
    with atomic_write(thinned) as temporary, gzip.open(temporary, "wt", encoding="utf-8") as file:
        file.writelines(kept)
    return thinned


def reference_of(log: str, data: Path, out: Path) -> Path:
    """Return the file of reference poses; made by the proxy where the data hold none."""
    if log in REFERENCES:
        return data / REFERENCES[log]
    path = out / f"{log}-proxy.tum"
    if not path.is_file():
        write_tum(path, map_log(data / LOGS[log], mapper=PROXY).trajectory)
    return path


def shown(value: Any) -> str:
    """Return a cell of the table."""
    return f"{value:.3f}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
