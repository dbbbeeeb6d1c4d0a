"""The fidelity benchmark's own arithmetic: agreement by medians, and runs that lack an original."""

from types import ModuleType

import pytest

from tests.benchmark_modules import load_benchmark


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


def test_without_an_original_nothing_is_compared(fidelity: ModuleType) -> None:
    found = fidelity.agreement([row(0.2, [0.1], [0.1])], "hector_original")
    assert found == (0, None, 0, 0)
    assert "no run has its original" in fidelity.formatted("hector_original", found)


def test_a_cell_holds_the_median_and_the_range(fidelity: ModuleType) -> None:
    assert fidelity._cell([0.1, 0.3, 0.2]) == "0.200 (0.100-0.300)"
    assert fidelity._cell([0.1]) == "0.100"
    assert fidelity._cell([]) == "-"
