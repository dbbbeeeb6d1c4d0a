"""Planted defects are visible to the search's objective: known cases where hector keeps its way."""

import pytest

from lirs_extensions.search.falsify.search import SearchLimits, measure
from lirs_extensions.search.options import FalsifyOptions
from tests.benchmark_modules import BENCHMARKS

CASES = {
    "WrongRoll": {"slope": 16.0},
    "LateScans": {},
    "LosesScans": {"corridor": 26.0},
    "DriftsAtStandstill": {"reversing": 0.5},
}
"""Changed parameters of a case for each defect; the path of `NeverForgets` stays right."""


@pytest.mark.slow
@pytest.mark.parametrize("defect", sorted(CASES))
def test_a_planted_defect_raises_the_ratio(defect: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(BENCHMARKS)
    case = SearchLimits().easiest
    for name, value in CASES[defect].items():
        case = case.with_value(name, value)
    ratios = {}
    for mapper in (f"planted_mappers:{defect}", "hector"):
        score = measure(FalsifyOptions(mapper=mapper, seconds=30.0), mapper, case, 1, 0.3)
        assert score.counted
        ratios[mapper] = score.ratio
    planted, sound = ratios.values()
    assert sound < 1.0
    assert planted > 4 * sound, ratios
