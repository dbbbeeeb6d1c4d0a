"""The published cases of `benchmarks/falsify.csv` can be written, and fail again."""

from pathlib import Path
from types import ModuleType

import pytest
import yaml

from lirs_validation.bench.tasks import task_set
from lirs_validation.falsify import FalsifyOptions
from lirs_validation.falsify.cases import SearchLimits
from lirs_validation.falsify.drives import measure
from lirs_validation.sweep.suites import CASE, suite_folders
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
        assert measure(options, options.method, case, int(row["drive"]), 0.3).ratio > options.factor
