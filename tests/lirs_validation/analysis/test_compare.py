"""Which differences are significant: against SciPy's tests, on differences that are known."""

import copy
import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
from rich.console import Console
from scipy import stats

from lirs_validation.analysis.compare import compare, holm, least_effect, only, paired_test, repeats
from lirs_validation.record.metric_catalog import metrics_named, metrics_selected
from lirs_validation.record.verdict import LIMITS
from lirs_validation.report.compare_tables import compare_table, write_comparison
from lirs_validation.report.run_tables import baseline_lines
from lirs_wct.errors import ConfigError
from tests.lirs_validation.records import entry

ATE = metrics_named(["trajectory.ate_rmse"])
ENTRY = entry()


@settings(max_examples=25)
@given(arrays(np.float64, st.integers(1, 12), elements=st.floats(0, 1)))
def test_holm_never_helps_and_keeps_the_order(p: np.ndarray) -> None:
    raised = holm(p)
    assert (raised >= p).all()
    assert (raised <= 1).all()
    assert (raised >= np.minimum(1, p.min() * len(p)) - 1e-12).all()
    order = np.argsort(p, kind="stable")
    assert (np.diff(raised[order]) >= 0).all()


def test_the_tests_are_scipys_and_holm_by_hand() -> None:
    # Holm 1979: p(1) n, p(2) (n - 1), ...
    assert holm(np.array([0.01, 0.04, 0.03])).tolist() == pytest.approx([0.03, 0.06, 0.06])
    a, b = np.random.default_rng(2).normal(size=(2, 6))
    test, p, low, high = paired_test(b - a)
    expected = stats.ttest_rel(b, a)
    interval = expected.confidence_interval(0.95)
    assert test == "t"
    assert (p, low, high) == pytest.approx((expected.pvalue, interval.low, interval.high))
    d = np.random.default_rng(0).exponential(1.0, 30) ** 3
    test, p, low, high = paired_test(d)
    assert test == "Wilcoxon"
    assert p == pytest.approx(stats.wilcoxon(d).pvalue)
    assert low < d.mean() < high
    # Without spread only the direction counts.
    assert paired_test(np.full(5, 0.1))[:2] == ("sign", 2 / 2**5)
    assert paired_test(np.zeros(5))[:2] == ("sign", 1.0)
    assert paired_test(np.array([0.3]))[:2] == ("none", None)


def test_repeats_are_students() -> None:
    found = repeats([1.0, 2.0, 4.0])
    assert found.half_width == pytest.approx(4.302653 * np.std([1, 2, 4], ddof=1) / np.sqrt(3), rel=1e-6)
    assert repeats([]) is None
    one = repeats([3.0])
    assert (one.mean, one.std, one.half_width) == (3.0, None, None)


def results(shift: float, noise: float, seeds: int = 5, **more: object) -> list[dict[str, object]]:
    """Runs whose ATE differs from seed to seed far more than from result to result."""
    rng = np.random.default_rng(7)
    own = np.random.default_rng(int(1e6 * (shift + noise)))
    return [
        entry(seed=s, ate=float(0.1 * rng.random() + 0.05 + shift + noise * own.random()), **more)
        for s in range(1, seeds + 1)
    ]


def test_a_small_steady_difference_is_found_in_the_noise_between_seeds() -> None:
    assert compare(results(0, 0.02), results(0.0, 0.021), ATE).differences[0].significant is False
    found = compare(results(0, 0.0001), results(0.002, 0.0001), ATE).differences
    assert len(found) == 1
    assert found[0].significant is True
    assert found[0].low < 0.002 < found[0].high + 1e-3
    # Unpaired, nobody would see it.
    a, b = ([r["trajectory"]["ate_rmse"] for r in results(x, 0.0001)] for x in (0, 0.002))  # type: ignore[index]
    assert stats.ttest_ind(a, b).pvalue > 0.5


def test_one_seed_says_nothing() -> None:
    comparison = compare(results(0, 0.01, 1), results(0.5, 0.01, 1), metrics_selected("compared"))
    assert all(d.significant is None and d.p is None and d.low is None for d in comparison.differences)
    assert "no confidence interval" in shown(comparison)


def test_failed_runs_and_shared_processors_are_left_out() -> None:
    a = [entry(seed=s) for s in (1, 2, 3)]
    b = [entry(seed=1, status="tipped", ate=9.0), entry(seed=2, concurrent=True), entry(seed=3)]
    comparison = compare(a, b, metrics_named(["trajectory.ate_rmse", "rtf.mean"]))
    pairs = {d.metric.key: d.pairs for d in comparison.differences}
    assert pairs == {"trajectory.ate_rmse": 2, "rtf.mean": 1}
    assert "1 of 3 in b" in " ".join(shown(comparison).split())


def test_another_mapper_is_paired_when_asked() -> None:
    a, b = results(0, 0.001), results(0.01, 0.001, mapper="gmapping")
    with pytest.raises(ConfigError, match=r"differ in mapper \(hector and gmapping\); --across mapper"):
        compare(a, b, ATE)
    assert compare(a, b, ATE, ("mapper",)).differences[0].pairs == 5
    with pytest.raises(ConfigError, match="unknown field of a group 'maper'"):
        compare(a, b, ATE, ("maper",))
    with pytest.raises(
        ConfigError,
        match=r"two runs of one group and seed, .*; they differ in mapper \(hector and gmapping\): "
        r"choose one as FOLDER:mapper=hector",
    ):
        compare(a + b, a, ATE, ("mapper",))
    chosen = compare(only(a + b, {"mapper": "gmapping"}), only(a + b, {"mapper": "hector"}), ATE, ("mapper",))
    assert chosen.differences[0].difference == pytest.approx(-0.01, abs=1e-3)
    with pytest.raises(ConfigError, match="move one of them to another folder"):
        compare(a + a, a, ATE)


def test_the_verdict_stands_however_narrow_the_screen() -> None:
    a, b = results(0, 0.001), results(0.5, 0.001)
    console = Console(width=34, record=True, file=io.StringIO())
    console.print(compare_table(compare(a, b, ATE), ("a", "b")))
    text = console.export_text()
    assert "b worse" in text
    assert "Columns hidden (widen the terminal): b - a, 95 %, n, p" in " ".join(text.split())


def test_runs_are_chosen_by_the_fields_of_their_groups() -> None:
    runs = [
        entry(world, 1, mapper=mapper) for world in ("simple", "medium") for mapper in ("hector", "gmapping")
    ]
    assert only(runs, {}) == runs
    assert only(runs, {"world": "medium", "mapper": "hector"}) == [runs[2]]
    assert only(runs, {"seconds": "30", "attitude": "imu"}) == runs
    with pytest.raises(ConfigError, match="unknown mapper 'hektor'; legal: gmapping, hector"):
        only(runs, {"mapper": "hektor"})
    with pytest.raises(ConfigError, match="unknown field of a group 'maper'"):
        only(runs, {"maper": "hector"})


def test_what_only_one_has_is_named() -> None:
    a = [*results(0, 0.01), entry("medium", 1)]
    comparison = compare(a, results(0, 0.02), ATE)
    assert [group["world"] for group in comparison.only_a] == ["medium"]
    assert "Only in a: medium" in shown(comparison)


def test_files(tmp_path: Path) -> None:
    comparison = compare(results(0, 0.001), results(0.01, 0.001), metrics_selected("compared"))
    write_comparison(tmp_path / "d.csv", comparison, ("a", "b"))
    write_comparison(tmp_path / "d.json", comparison, ("a", "b"))
    rows = list(csv.DictReader((tmp_path / "d.csv").open()))
    document = json.loads((tmp_path / "d.json").read_text())
    assert len(rows) == len(document["differences"]) == len(comparison.differences)
    ate = next(r for r in document["differences"] if r["figure"] == "trajectory.ate_rmse")
    assert ate["real"] is True
    assert ate["verdict"] == "b worse"
    assert float(next(r for r in rows if r["figure"] == "trajectory.ate_rmse")["p"]) == ate["p"]


def shown(comparison: object) -> str:
    console = Console(width=110, record=True, file=io.StringIO())
    console.print(compare_table(comparison, ("a", "b")))  # type: ignore[arg-type]
    return console.export_text()


def test_the_least_effect_is_the_edge_of_significance() -> None:
    """Beside other tests without effect, Holm multiplies the smallest p by their number."""
    rng = np.random.default_rng(1)
    for pairs, tests in ((2, 1), (3, 5), (6, 10), (30, 4)):
        d = rng.normal(size=pairs)
        d = (d - d.mean()) / d.std(ddof=1)
        for factor in (0.999, 1.001):
            p = stats.ttest_1samp(d + factor * least_effect(pairs, tests), 0.0).pvalue
            assert (holm(np.array([p, *[1.0] * (tests - 1)]))[0] < 0.05) == (factor > 1)
    assert least_effect(1, 1) == np.inf


def noisy(rng: np.random.Generator, worse: float, seeds: int) -> list[dict[str, object]]:
    """Return runs of a method in noise that another result does not share; `worse` scales its errors."""
    ate = 0.03 * worse * np.exp(0.3 * rng.normal(size=seeds))
    f1 = 1 - 0.03 * worse * np.exp(0.3 * rng.normal(size=seeds))
    runs = [copy.deepcopy(ENTRY) | {"seed": seed} for seed in range(seeds)]
    for k, run in enumerate(runs):
        run["trajectory"] |= {"ate_rmse": ate[k], "final_drift": 2 * ate[k] * rng.random()}
        run["map"] |= {"f1_aligned": f1[k], "false_occupied_aligned": (1 - f1[k]) * rng.random()}
    return runs


@pytest.mark.parametrize("seeds", [2, 3, 6, 12])
def test_a_baseline_passes_the_same_method_in_other_noise_and_fails_a_worse_one(seeds: int) -> None:
    rng, false, found = np.random.default_rng(seeds), 0, 0
    for _ in range(60):
        base, same, bad = (noisy(rng, factor, seeds) for factor in (1.0, 1.0, 3.0))
        false += bool(baseline_lines(base, same, LIMITS, ())[0])
        lines = baseline_lines(base, bad, LIMITS, ())[0]
        found += any(
            line.startswith("worse than the baseline: ATE of hector on simple, husky: ") for line in lines
        )
    assert false <= 3
    assert found >= {2: 0, 3: 3, 6: 36, 12: 60}[seeds]
