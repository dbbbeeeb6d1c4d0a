"""The study of quality figures: its stored rows, and the logs that it makes worse."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.log_quality import correlation, table, thinned, worsened

ROOT = Path(__file__).resolve().parents[1]
LINES = [f"FLASER 2 1.00 2.00 {x} 0 0 {x} 0 0 {x} host {x}\n" for x in np.arange(0.0, 10.0, 0.5)]


def test_the_published_table_is_that_of_the_stored_rows() -> None:
    with (ROOT / "benchmarks" / "log_quality.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    published = (ROOT / "docs" / "measured.md").read_text(encoding="utf-8")
    lines = table(rows).splitlines()
    assert all(line in published for line in lines[:-1])
    logs = list(dict.fromkeys(row["log"] for row in rows))
    found = [correlation([row for row in rows if row["log"] == log], "revisit_residual") for log in logs]
    assert len(logs) == 4
    assert min(sum(row["log"] == log for row in rows) for log in logs) >= 12
    assert np.median(found) >= 0.8


def test_the_correlation_is_that_of_ranks() -> None:
    rows = [{"error": 10.0**k, "figure": k**3} for k in range(6)]
    assert correlation(rows, "figure") == pytest.approx(1.0)
    assert correlation([row | {"figure": -row["figure"]} for row in rows], "figure") == pytest.approx(-1.0)
    assert correlation([*rows, {"error": 1.0, "figure": None}], "figure") == pytest.approx(1.0)


def test_every_kth_scan_stays_and_all_other_lines() -> None:
    lines = ["# a log\n", *LINES]
    assert list(thinned(lines, 4)) == ["# a log\n", *LINES[::4]]


def test_worse_odometry_keeps_scans_and_stamps_and_leaves_the_path() -> None:
    found = list(worsened(LINES))
    assert found == list(worsened(LINES))
    for old, new in zip(LINES, found, strict=True):
        assert new.split()[:4] == old.split()[:4]
        assert new.split()[-3:] == old.split()[-3:]
        assert new.split()[4:7] == new.split()[7:10]
    ends = [float(re.split(r"\s+", line)[8]) for line in (LINES[-1], found[-1])]
    assert ends[0] == 0.0
    assert abs(ends[1]) > 0.05
