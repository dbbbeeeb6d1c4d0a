"""Drives until the first confirmed failure of each method, by CMA-ES and by random search.

    python benchmarks/falsify.py [--methods hector,...] [--searches cma,random] [--seeds 1-5] [--minutes 60]
    python benchmarks/falsify.py --write FOLDER [--methods ...]

Methods are mappers, `policy:NAME`, and `planted`, the mappers of planted_mappers.py with hector as reference.
Each search has 150 drives of 60 s and ends with its first case. No search begins after `--minutes`; the same
command continues, also within a search. Finished searches are rows of benchmarks/falsify.csv. `--write` makes
the cases of the table, for `lirs-wct validate --suite FOLDER/cases.yaml` and, of policies, `lirs-wct bench
POLICY --set FOLDER/cases.json`.
"""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

import yaml

from benchmarks.planted_mappers import DEFECTS
from benchmarks.steps import arguments, print_rows
from lirs_extensions.bench.tasks import TaskSet, set_entry
from lirs_extensions.search.case_search import Case, process_pool
from lirs_extensions.search.falsify.results import sentence
from lirs_extensions.search.falsify.search import (
    CaseDrives,
    falsify,
    measure,
    policy_task,
    search_limits,
    write_case,
)
from lirs_extensions.search.options import FalsifyOptions
from lirs_wct.files import write_json
from lirs_wct.option import read_numbers

HERE = Path(__file__).resolve().parent
OUTCOME = HERE / "falsify.csv"
METHODS = ("hector", "planted", "policy:go_to_goal", "gmapping", "cartographer", "hector_original")
DRIVES = 150
COLUMNS = (
    "method", "search", "seed", "first case", "shrinking", "changed", "ratio", "reference ratio",
    "largest ratio", "drive", "values", "case",
)  # fmt: skip
"""`drive` is the seed of a failing drive, `values` are the changed parameters."""


def searches(methods: list[str], kinds: list[str], seeds: list[int], jobs: int) -> Iterator[FalsifyOptions]:
    """Yield the options of each search, seed by seed."""
    common: dict[str, Any] = {"drives": DRIVES, "cases": 1, "jobs": jobs}
    for method, kind, seed in product(methods, kinds, seeds):
        shared = common | {"search": kind, "seed": seed}
        if method == "planted":
            for defect in DEFECTS:
                name = f"planted_mappers:{defect.__name__}"
                yield FalsifyOptions(mapper=name, reference="hector", **shared)
        elif method.startswith("policy:"):
            yield FalsifyOptions(policy=method.partition(":")[2], **shared)
        else:
            yield FalsifyOptions(mapper=method, **shared)


def name_of(options: FalsifyOptions) -> str:
    """Return the name of a search."""
    return f"{options.method.replace(':', '-')}-{options.search}-s{options.seed}"


def row_of(options: FalsifyOptions, out: Path) -> dict[str, str]:
    """Search, and return the row of the table."""
    folder = out / name_of(options)
    folder.mkdir(parents=True, exist_ok=True)
    limits = search_limits(options)
    with process_pool(options.jobs) as pool:
        drives = CaseDrives(options, limits, folder, pool)
        found = falsify(drives, print)
    largest = max((s.ratio for *_, s in drives.history if s.counted), default=0.0)
    row = {"method": options.method, "search": options.search, "seed": str(options.seed)}
    row |= {"largest ratio": f"{largest:.2f}", "first case": "", "case": "none found"}
    if found:
        first = found[0]
        changed = [p.name for p in limits.difference(first.case)]
        row |= {"first case": str(first.drives), "shrinking": str(first.shrinking)}
        row |= {"changed": str(len(changed)), "ratio": f"{median(s.ratio for s in first.scores):.1f}"}
        row |= {"drive": str(first.seed), "case": sentence(options, first.case, limits)}
        row["values"] = " ".join(f"{name}={first.case.values[name]:g}" for name in changed)
        if options.compared_with is not None:
            other = measure(options, options.compared_with, first.case, first.seed, limits.returns)
            row["reference ratio"] = f"{other.ratio:.2f}"
    return row


def case_of(options: FalsifyOptions, row: dict[str, str]) -> Case:
    """Return the case of a row."""
    case = search_limits(options).easiest
    for item in row["values"].split():
        name, _, value = item.partition("=")
        case = case.with_value(name, float(value))
    return case


def write_cases(rows: list[dict[str, str]], chosen: list[FalsifyOptions], out: Path) -> None:
    """Write the found cases: of mappers folders and a suite, of policies a set of tasks."""
    table = {(row["method"], row["search"], row["seed"]): row for row in rows}
    names, tasks = [], []
    for options in chosen:
        row = table.get((options.method, options.search, str(options.seed)), {})
        if not row.get("drive"):
            continue
        case, seed, name = case_of(options, row), int(row["drive"]), name_of(options)
        if options.policy is not None:
            tasks.append(policy_task(options, case, seed, name))
            continue
        names.append(name)
        write_case(out / name, case, options, method=options.mapper, seed=seed, comment=row["case"])
    if names:
        (out / "cases.yaml").write_text(yaml.safe_dump({"cases": names}), encoding="utf-8")
    if tasks:
        write_json(out / "cases.json", set_entry(TaskSet(name="cases", version=1, tasks=tuple(tasks))))


def read_rows() -> list[dict[str, str]]:
    """Return the rows of the finished searches."""
    with OUTCOME.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def write_rows(rows: list[dict[str, str]]) -> None:
    """Write the rows of the finished searches, sorted."""
    with OUTCOME.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(sorted(rows, key=lambda row: (row["method"], row["search"], int(row["seed"]))))


def summary(rows: list[dict[str, str]]) -> Iterator[dict[str, Any]]:
    """Yield drives until the first case by method and search; without a case, all."""
    for method, search in sorted({(row["method"], row["search"]) for row in rows}):
        cases = [row["first case"] for row in rows if (row["method"], row["search"]) == (method, search)]
        counts = [int(case or DRIVES) for case in cases]
        found = f"{sum(map(bool, cases))} of {len(cases)}"
        yield {"method": method, "search": search, "found": found, "drives": counts, "median": median(counts)}


def main() -> None:
    """Measure and print."""
    defaults: dict[str, Any] = {"methods": ",".join(METHODS), "searches": "cma,random", "seeds": "1-5"}
    given = arguments(__doc__, **defaults, minutes=60.0, jobs=1, out=Path("out/falsify"), write=Path)
    sys.path.insert(0, str(HERE))  # of the planted mappers
    end, rows = time.monotonic() + 60 * given.minutes, read_rows()
    done = {(row["method"], row["search"], row["seed"]) for row in rows}
    seeds = list(read_numbers(given.seeds, "--seeds"))
    chosen = list(searches(given.methods.split(","), given.searches.split(","), seeds, given.jobs))
    if given.write is not None:
        given.write.mkdir(parents=True, exist_ok=True)
        write_cases(rows, chosen, given.write)
        return
    for options in chosen:
        if (options.method, options.search, str(options.seed)) in done:
            continue
        if time.monotonic() > end:
            break
        rows.append(row_of(options, given.out))
        write_rows(rows)
    print_rows(summary(rows), width=140)


if __name__ == "__main__":
    main()
