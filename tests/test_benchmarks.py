"""Studies under benchmarks/: their stored rows and their arithmetic."""

import gzip
import re
import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import yaml

from benchmarks.forecast import came_true
from benchmarks.log_quality import (
    conclusion,
    conclusions,
    correlation,
    is_right,
    is_told,
    late,
    stored_rows,
    table,
    thin_beams,
    worsened,
)
from benchmarks.mrpt import write_rawlog
from lirs_extensions.bench.tasks import task_set
from lirs_extensions.search.falsify.search import SearchLimits, measure
from lirs_extensions.search.options import FAILURE_FACTOR, FalsifyOptions
from lirs_validation.sweep.tasks import CASE, suite_folders
from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.formats.laser_log import LaserLog
from tests.benchmark_modules import load_benchmark

SEARCHES = (["hector_original", "policy:go_to_goal"], ["cma"], [1], 1)


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return load_benchmark("falsify")


def published(script: ModuleType) -> list[tuple[FalsifyOptions, dict[str, str]]]:
    """Return the searches with their rows."""
    rows = {(row["method"], row["search"], row["seed"]): row for row in script.read_rows()}
    return [(o, rows[o.method, o.search, str(o.seed)]) for o in script.searches(*SEARCHES)]


def test_cases_are_written_as_a_suite_and_a_set(script: ModuleType, tmp_path: Path) -> None:
    script.write_cases(script.read_rows(), list(script.searches(*SEARCHES)), tmp_path)
    default = SearchLimits().easiest.values
    mappers = [row for options, row in published(script) if options.policy is None]
    for folder, row in zip(suite_folders(tmp_path / "cases.yaml"), mappers, strict=True):
        entry = yaml.safe_load((Path(folder) / CASE).read_text())
        changed = [name for name, value in entry["parameters"].items() if value != default[name]]
        assert len(changed) == int(row["changed"])
        assert entry["run"]["mapper"] == row["method"]
    tasks = task_set(str(tmp_path / "cases.json")).tasks
    assert [task.name for task in tasks] == ["go_to_goal-cma-s1-s2001"]


@pytest.mark.slow
def test_published_cases_fail_again(script: ModuleType) -> None:
    for options, row in published(script):
        case = script.case_of(options, row)
        assert measure(options, options.method, case, int(row["drive"]), 0.3).ratio > FAILURE_FACTOR


@pytest.fixture(scope="module")
def fidelity() -> ModuleType:
    return load_benchmark("fidelity")


def row(odometry: float, theirs: list[float], ours: list[float]) -> dict[str, list[float]]:
    return {"odometry": [odometry], "C++ GMapping": theirs, "gmapping_original": ours, "C++ Hector": []}


def test_agreement_is_by_medians_over_the_runs_that_have_an_original(fidelity: ModuleType) -> None:
    rows = [
        row(0.2, [0.1, 0.5, 0.1], [0.15, 0.9, 0.15]),  # within a factor of two, both sides below
        row(0.2, [0.3], [0.7]),  # beyond it, both above
        row(0.2, [0.15], [0.25]),  # within, on the other side
        row(0.2, [], [0.1]),  # no original
    ]
    found = fidelity.agreement(rows, "gmapping_original")
    assert (found.runs, found.within_factor_two, found.same_side) == (3, 2, 2)
    assert found.rank_correlation == pytest.approx(1.0)


ROOT = Path(__file__).resolve().parents[1]
LINES = [f"FLASER 2 1.00 2.00 {x} 0 0 {x} 0 0 {x} host {x}\n" for x in np.arange(0.0, 10.0, 0.5)]


def test_the_published_tables_are_those_of_the_stored_rows() -> None:
    rows = stored_rows(ROOT / "benchmarks" / "log_quality.csv")
    published = (ROOT / "docs" / "measured.md").read_text(encoding="utf-8")
    lines = f"{table(rows)}\n{conclusions(rows)}".splitlines()
    assert all(line in published for line in lines)
    logs = list(dict.fromkeys(row["log"] for row in rows))
    found = [correlation([row for row in rows if row["log"] == log], "revisit_residual") for log in logs]
    assert len(logs) >= 6
    assert min(sum(row["log"] == log for row in rows) for log in logs) >= 9
    assert np.nanmedian(found) >= 0.8
    told = [is_told(row) for row in rows]
    assert told.count(True) >= 0.8 * (len(told) - told.count(None))
    assert sum(conclusion(row) == "probably right" and not is_right(row) for row in rows) <= 0.05 * len(rows)


def test_changed_logs_keep_what_they_do_not_change(tmp_path: Path) -> None:
    """Thinned beams keep their angles; a late odometry is that of half a second before."""
    source = [f"FLASER 181 {' '.join(['2.00'] * 181)} {x} 0 0 {x} 0 0 {x} host {x}\n" for x in range(9)]
    read = {}
    for name, lines in (("whole", source), ("beams", thin_beams(source)), ("late", late(source))):
        path = tmp_path / f"{name}.clf"
        path.write_text("".join(lines))
        read[name] = read_carmen(path)
    whole, beams = read["whole"].scans[3], read["beams"].scans[3]
    np.testing.assert_allclose(beams.angles, whole.angles[::4], atol=1e-8)
    assert beams.stamp == whole.stamp
    x = [pose.x for pose in read["late"].odometry if pose is not None]
    np.testing.assert_allclose(x, [0.0, *np.arange(0.5, 8.0)])


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


OFFICE = Path(__file__).resolve().parents[1] / "examples" / "data" / "office.clf.gz"


@pytest.fixture(scope="module")
def log() -> LaserLog:
    return read_carmen(OFFICE)


def test_a_log_holds_increments_and_ranges(log: LaserLog, tmp_path: Path) -> None:
    write_rawlog(tmp_path / "log.rawlog", log)
    content = gzip.decompress((tmp_path / "log.rawlog").read_bytes())
    starts = [i for i in range(len(content)) if content.startswith(b"\x87CPose2D\x01", i)]
    assert len(starts) == len(log.scans)
    increments = np.array([np.frombuffer(content[i + 9 : i + 33], "<f8") for i in starts])
    poses = [odometry for odometry in log.odometry if odometry is not None]
    walked = poses[0]
    for x, y, yaw in increments.tolist():
        walked = walked @ type(walked)(x, y, yaw)
    assert walked.distance(poses[-1]) < 1e-9
    scan = log.scans[7]
    expected = np.where(scan.hits, scan.ranges, scan.range_max).astype("<f4").tobytes()
    assert expected + scan.hits.astype(np.uint8).tobytes() in content


@pytest.mark.skipif(shutil.which("rawlog-edit") is None, reason="needs Debian's mrpt-apps")
def test_mrpt_reads_it(log: LaserLog, tmp_path: Path) -> None:
    write_rawlog(tmp_path / "log.rawlog", log)
    command = ["rawlog-edit", "--info", "-i", str(tmp_path / "log.rawlog")]
    told = subprocess.run(
        command, capture_output=True, text=True, check=True, stdin=subprocess.DEVNULL
    ).stdout
    found = {
        key.strip(): value.strip() for key, _, value in (line.partition(":") for line in told.splitlines())
    }
    assert found["Actions/SensoryFrame format"] == "Yes"
    assert found["Overall number of objects"] == str(2 * len(log.scans))
    assert f"{log.stamps[-1] - log.stamps[0]:.3f}" in told


def test_runs_are_counted_by_the_forecasts_expectation() -> None:
    rows = [{"expectation": text, "hector": [0.5]} for text in ("enough", "enough", "nowhere")]
    assert came_true(rows, "hector") == {"enough": [2, 2], "nowhere": [1, 1]}
