"""The whole run: how fast, how right, on the bundled worlds or any source, all seeds reported.

    python benchmarks/run.py [SOURCE ...] [--seeds 1-5] [--seconds 120] [--quick] [--json FILE]

The peer is the paper: Gazebo, Husky, HectorSLAM on solid worlds, RTF 0.64 (medium) and 0.60 (advanced);
its figure for the simple world is lost with its Table II, its abstract says 0.42 to 0.73.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from lirs_validation import validate

WORLDS = ("simple", "medium", "advanced")
PAPER_RTF = {"medium": 0.64, "advanced": 0.60}


def main() -> None:
    """Run every source with every seed and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sources", nargs="*", default=WORLDS)
    parser.add_argument("--seeds", default="1-5", help="first-last")
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--mapper", default="hector")
    parser.add_argument("--quick", action="store_true", help="one seed, 20 s")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    first, _, last = ("1" if given.quick else given.seeds).partition("-")
    seconds = 20.0 if given.quick else given.seconds
    rows = [
        row(source, validate(source, mapper=given.mapper, seconds=seconds, seed=seed).record)
        for source in given.sources
        for seed in range(int(first), int(last or first) + 1)
    ]
    Console(width=170).print(table(rows))
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def row(source: str, record: Any) -> dict[str, Any]:
    """Return the figures that the table shows."""
    parts = {f"{name}_ms": 1e3 * value for name, value in record.rtf["parts"].items()}
    return {
        "source": source,
        "seed": record.config.seed,
        "status": record.status,
        "rtf": record.rtf["mean"],
        "ratio_paper": record.rtf["mean"] / PAPER_RTF[source] if source in PAPER_RTF else None,
        **parts,
        "ate": record.trajectory["ate_rmse"],
        "odometry_ate": record.trajectory["odometry_ate_rmse"],
        "f1": record.map["f1"],
        "f1_input": record.map["f1_input"],
        "false_occupied": record.map["false_occupied"],
        "length": record.trajectory["length"],
    }


def table(rows: list[dict[str, Any]]) -> Table:
    """Return the rows for people; milliseconds are per simulated second."""
    shown = Table(*rows[0], title="whole run, Husky, lms111 (parts in ms per simulated second)")
    for entry in rows:
        shown.add_row(
            *(f"{v:.3g}" if isinstance(v, float) else "-" if v is None else str(v) for v in entry.values())
        )
    return shown


if __name__ == "__main__":
    main()
