"""Search, confirmation and resumption with synthetic drives."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from lirs_extensions.search.case_search import Case, CmaProposer, make_proposer, require_cma
from lirs_extensions.search.falsify import search as search_module
from lirs_extensions.search.falsify.search import (
    ARCHIVE,
    NEEDED,
    NEW_SEEDS,
    CaseDrives,
    DriveScore,
    SearchLimits,
    falsify,
    loss,
)
from lirs_extensions.search.options import FalsifyOptions
from lirs_wct.errors import ConfigError, OutputError

LIMITS = SearchLimits()


class Synthetic:
    """Drives of a method whose error grows with slope or lag; the seeds differ a little."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, Case, int]] = []
        self.stop_after = math.inf

    def __call__(
        self, options: FalsifyOptions, method: str, case: Case, seed: int, returns: float
    ) -> DriveScore:
        if len(self.calls) >= self.stop_after:
            raise KeyboardInterrupt
        self.calls.append((method, case, seed))
        v = case.values
        ratio = 0.1 + max(v["slope"] / 3, 40 * v["lag"]) if method == "hector" else v["relief"]
        return DriveScore(ratio * (1 + 0.01 * (seed % 3)), counted=v["dust"] < 0.09)


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> Synthetic:
    synthetic = Synthetic()
    monkeypatch.setattr(search_module, "measure", synthetic)
    return synthetic


def search(out: Path, **options: object) -> tuple[CaseDrives, tuple[object, ...]]:
    out.mkdir(exist_ok=True)
    drives = CaseDrives(FalsifyOptions(**options), LIMITS, out)  # type: ignore[arg-type]
    return drives, falsify(drives)


@pytest.mark.parametrize("kind", ["cma", "random"])
def test_a_failure_is_found_confirmed_and_reduced_to_its_cause(
    tmp_path: Path, measured: Synthetic, kind: str
) -> None:
    drives, (found, *_) = search(tmp_path / "out", drives=200, cases=1, search=kind)
    changed = {p.name for p in LIMITS.difference(found.case)}
    assert changed
    assert changed <= {"slope", "slope_direction", "lag"}
    assert sum(drives.fails(s) for s in found.scores) >= NEEDED
    assert found.drives <= 200 + NEW_SEEDS


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(
    tmp_path: Path, measured: Synthetic
) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        np.random.seed(len(name) + seed)  # noqa: NPY002  nothing reads the global generator
        search(tmp_path / name, drives=40, cases=1, seed=seed)
    texts = [(tmp_path / name / ARCHIVE).read_bytes() for name in "abc"]
    assert texts[0] == texts[1]
    assert texts[0] != texts[2]


def test_an_interrupted_search_goes_on_and_ends_with_the_same_bytes(
    tmp_path: Path, measured: Synthetic
) -> None:
    search(tmp_path / "whole", drives=60, cases=1)
    total = len(measured.calls)
    measured.calls.clear()
    measured.stop_after = 23
    with pytest.raises(KeyboardInterrupt):
        search(tmp_path / "cut", drives=60, cases=1)
    archive = tmp_path / "cut" / ARCHIVE
    archive.write_bytes(archive.read_bytes()[:-7])  # the machine stopped within a line
    measured.stop_after = math.inf
    measured.calls.clear()
    search(tmp_path / "cut", drives=60, cases=1)
    assert len(measured.calls) == total - 22
    assert archive.read_bytes() == (tmp_path / "whole" / ARCHIVE).read_bytes()


def test_a_failure_that_the_reference_shares_does_not_count(tmp_path: Path, measured: Synthetic) -> None:
    drives, found = search(tmp_path / "out", drives=120, cases=1, reference="gmapping")
    assert {method for method, *_ in measured.calls} == {"hector", "gmapping"}
    shared = [(case, s) for _, case, _, s in drives.history if s.ratio > 3 and case.values["relief"] > 1.05]
    assert shared
    assert not any(s.counted for _, s in shared)
    assert all(f.case.values["relief"] <= 1.05 for f in found)


@pytest.mark.parametrize(("other", "ratio", "counted"), [(0.02, 0.4 / 0.072, True), (0.5, 1.0, False)])
def test_the_limit_of_a_mapper_is_that_of_its_reference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, other: float, ratio: float, counted: bool
) -> None:
    def measure(options: FalsifyOptions, method: str, case: Case, seed: int, returns: float) -> DriveScore:
        error = 0.4 if method == "hector" else other
        return DriveScore(error / 0.4, error=error, limit=0.4)

    monkeypatch.setattr(search_module, "measure", measure)
    drives = CaseDrives(FalsifyOptions(mapper="hector", reference="gmapping"), LIMITS, tmp_path)
    (score,) = drives.run([(LIMITS.easiest, 1)])
    assert score.counted == drives.fails(score) == counted
    assert not counted or score.ratio == pytest.approx(ratio)


def test_a_failure_of_one_seed_alone_is_no_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lucky(options: FalsifyOptions, method: str, case: Case, seed: int, returns: float) -> DriveScore:
        return DriveScore(5.0 if seed == options.seed else 0.5)

    monkeypatch.setattr(search_module, "measure", lucky)
    _, found = search(tmp_path / "out", drives=40)
    assert found == ()


def test_cases_that_do_not_count_are_worse_than_all_others() -> None:
    losses = [loss(DriveScore(r)) for r in (100.0, 3.0, 1.0, 0.01, 0.0)]
    assert losses == sorted(losses)
    assert loss(DriveScore(50.0, counted=False)) > max(losses)


def test_cma_gets_closer_than_random_search_with_the_same_drives() -> None:
    """On a smooth valley in 22 parameters, in the median of five seeds."""
    best: dict[str, list[float]] = {"cma": [], "random": []}
    for kind, found in best.items():
        for seed in range(5):
            proposer = make_proposer(kind, LIMITS, np.random.default_rng(seed))
            ratios: list[float] = []
            while len(ratios) < 150:
                shares = [
                    np.array([(c.values[p.name] - p.low) / (p.high - p.low) for p in LIMITS.free])
                    for c in proposer.propose()
                ]
                scores = [DriveScore(math.exp(-float(np.sum((x - 0.7) ** 2)))) for x in shares]
                ratios += [s.ratio for s in scores]
                proposer.learn([loss(score) for score in scores])
            found.append(max(ratios))
    assert np.median(best["cma"]) > np.median(best["random"])


def test_a_missing_package_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cma", None)
    with pytest.raises(ConfigError, match=r"pip install 'lirs-wct\[search\]'"):
        require_cma()
    with pytest.raises(ConfigError, match="cma"):
        CmaProposer(LIMITS, np.random.default_rng(0))


def test_a_damaged_archive_names_its_line(tmp_path: Path) -> None:
    (tmp_path / ARCHIVE).write_text("{}\n")
    with pytest.raises(OutputError, match=r"drives.jsonl: line 1 is damaged"):
        CaseDrives(FalsifyOptions(), LIMITS, tmp_path)
