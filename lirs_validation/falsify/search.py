"""Search for failures: proposals of cases, confirmation with new seeds, and shrinking.

CMA-ES: N. Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772. Shrinking: after Zeller and
Hildebrandt, "Simplifying and isolating failure-inducing input", IEEE TSE 2002.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any, Protocol

import numpy as np

from lirs_validation.falsify.cases import Case, CaseParameter, SearchLimits, require_cma
from lirs_validation.falsify.drives import WORST, CaseDrives, DriveScore

START = 0.5
"""Share of the distance between the defaults and the middle of the limits at which a search begins."""
SPREAD = 0.25
"""Initial standard deviation, share of the limits."""
POPULATION, PARENTS = 10, 3
"""Cases of a generation, and the best of them that the next one follows; the best so far competes again."""
PATIENCE = 6
"""Generations without a better case after which the search restarts at a random place."""
BATCH = 12
"""Cases of a batch of the random search."""
LEAST = 0.01
"""Ratios below count as this one."""
UNCOUNTED = 1.0
"""Loss of a case that does not count, added to the largest loss of one that does."""
FEWEST = 2
"""Fewest free parameters of CMA-ES; one alone is drawn at random."""


class CaseSource(Protocol):
    """Source of cases to try."""

    def propose(self) -> list[Case]:
        """Return the next cases."""

    def learn(self, scores: Sequence[DriveScore]) -> None:
        """Take in the scores of the proposed cases, or of the first of them."""


def loss(score: DriveScore) -> float:
    """Return the value to minimize: minus the logarithm of the ratio.

    A case that does not count is worse than any that does.
    """
    if not score.counted:
        return UNCOUNTED - math.log(LEAST)
    return -math.log(min(max(score.ratio, LEAST), WORST))


class RandomProposer:
    """Uniform cases within the limits."""

    def __init__(self, limits: SearchLimits, rng: np.random.Generator) -> None:
        self._limits, self._rng = limits, rng

    def propose(self) -> list[Case]:
        """Return a batch of cases."""
        return [self._limits.case(x) for x in self._rng.random((BATCH, len(self._limits.free)))]

    def learn(self, scores: Sequence[DriveScore]) -> None:
        """Do nothing: the cases are independent."""


class CmaProposer:
    """CMA-ES with restarts.

    Args:
        limits: of the parameters.
        rng: of all random numbers.

    Raises:
        ConfigError: the package `cma` is not installed.
    """

    def __init__(self, limits: SearchLimits, rng: np.random.Generator) -> None:
        require_cma()
        self._limits, self._rng = limits, rng
        easiest = np.array([(p.default - p.low) / (p.high - p.low) for p in limits.free])
        self._begin((easiest + START * (0.5 - easiest)).tolist())

    def _begin(self, mean: Sequence[float]) -> None:
        import cma

        options: dict[str, Any] = {
            "bounds": [0, 1],
            "seed": math.nan,  # the package's own would seed NumPy's global generator
            "randn": lambda *shape: self._rng.standard_normal(shape),
            "popsize": POPULATION,
            "CMA_mu": PARENTS,
            "CMA_elitist": True,
            "verbose": -9,
        }
        self._strategy = cma.CMAEvolutionStrategy(list(mean), SPREAD, options)
        self._asked: list[Any] = []
        self._best, self._since = math.inf, 0

    def propose(self) -> list[Case]:
        """Return the next generation."""
        if self._strategy.stop() or self._since >= PATIENCE:
            self._begin(self._rng.random(len(self._limits.free)).tolist())
        self._asked = [np.asarray(x, dtype=np.float64) for x in self._strategy.ask()]
        return [self._limits.case(x) for x in self._asked]

    def learn(self, scores: Sequence[DriveScore]) -> None:
        """Update the distribution; an incomplete generation is ignored."""
        if len(scores) < len(self._asked):
            return
        losses = [loss(score) for score in scores]
        self._strategy.tell(self._asked, losses)
        better = min(losses) < self._best
        self._best, self._since = min(self._best, *losses), 0 if better else self._since + 1


def make_proposer(kind: str, limits: SearchLimits, rng: np.random.Generator) -> CaseSource:
    """Return the source of cases of a search.

    Raises:
        ConfigError: the package `cma` is not installed, or no parameter is free.
    """
    limits.require_free()
    if kind == "random" or len(limits.free) < FEWEST:
        return RandomProposer(limits, rng)
    return CmaProposer(limits, rng)


HALVINGS = 3
"""Times that the way of a value to its default is halved."""
Fails = Callable[[Case], bool]


def shrink(case: Case, limits: SearchLimits, fails: Fails) -> tuple[Case, ...]:
    """Return the failing cases on the way to the simplest one, which is the last.

    In the last case, no single parameter can be reset without its passing.

    Args:
        case: that fails.
        limits: parameters and their defaults.
        fails: whether a case fails; called once for each case.
    """
    known: dict[tuple[float, ...], bool] = {_key(case): True}

    def test(tried: Case) -> bool:
        key = _key(tried)
        if key not in known:
            known[key] = fails(tried)
        return known[key]

    trail = [case]
    groups = tuple(dict.fromkeys(p.group for p in limits.parameters))
    for group in reversed(groups):
        _try(trail, _reset(trail[-1], [p for p in limits.parameters if p.group == group]), test)
    _reset_singles(trail, limits, test)
    for parameter in limits.difference(trail[-1]):
        _halve(trail, parameter, test)
    _reset_singles(trail, limits, test)
    return tuple(trail)


def _reset_singles(trail: list[Case], limits: SearchLimits, fails: Fails) -> None:
    """Reset single parameters until none can be reset."""
    shorter = True
    while shorter:
        shorter = False
        for parameter in limits.difference(trail[-1]):
            shorter |= _try(trail, _reset(trail[-1], [parameter]), fails)


def _halve(trail: list[Case], parameter: CaseParameter, fails: Fails) -> None:
    """Move a value towards its default while the case fails."""
    passing = float(parameter.default)
    for _ in range(HALVINGS):
        middle = parameter.clip((passing + trail[-1].values[parameter.name]) / 2)
        if not _try(trail, trail[-1].with_value(parameter.name, middle), fails):
            passing = middle


def _try(trail: list[Case], tried: Case, fails: Fails) -> bool:
    """Append a changed case that fails; return whether it does."""
    if _key(tried) == _key(trail[-1]) or not fails(tried):
        return False
    trail.append(tried)
    return True


def _reset(case: Case, parameters: list[CaseParameter]) -> Case:
    for parameter in parameters:
        case = case.with_value(parameter.name, float(parameter.default))
    return case


def _key(case: Case) -> tuple[float, ...]:
    return tuple(case.values[name] for name in sorted(case.values))


NEW_SEEDS, NEEDED = 5, 4
"""New seeds of a confirmation, and the failures among them that confirm a case."""
CONFIRM, RECHECK, SHRINK = 1000, 2000, 100
"""Offsets of the seeds of a confirmation, of a shrunk case's, and of shrinking."""
STREAM = 41
"""Random stream of the search."""


@dataclass(frozen=True)
class FoundCase:
    """A confirmed failure.

    Attributes:
        case: its simplest form.
        found: the case as the search found it.
        drives: drives of the search up to its confirmation.
        position: number of the last of them in the history.
        seed: of a drive that fails.
        scores: of the simplest form with new seeds.
        shrinking: drives that shrinking took.
    """

    case: Case
    found: Case
    drives: int
    position: int
    seed: int
    scores: tuple[DriveScore, ...]
    shrinking: int


Report = Callable[[str], None]


def falsify(drives: CaseDrives, report: Report = lambda line: None) -> tuple[FoundCase, ...]:
    """Search for failures until the drives are used or enough cases are found.

    Args:
        drives: runs drives; its options and limits are those of the search.
        report: called with a line on each batch and case.

    Raises:
        WctError: a drive cannot be run, or its score not be written.
    """
    options, limits = drives.options, drives.limits
    found: list[FoundCase] = []
    shrinking = 0
    while drives.count - shrinking < options.drives and len(found) < options.cases:
        left = options.drives - drives.count + shrinking
        case = _search(drives, limits, len(found), left, report)
        if case is None:
            break
        used = drives.count - shrinking
        report(f"confirmed after {used} drives; shrinking")
        found.append(_simplest(drives, case, used))
        shrinking += found[-1].shrinking
        changed = [p.name for p in limits.difference(found[-1].case)]
        limits = limits.held(changed)
        if not changed or not limits.free:
            break
    return tuple(found)


def _search(
    drives: CaseDrives, limits: SearchLimits, restart: int, budget: int, report: Report
) -> Case | None:
    """Return a confirmed case within the limits; None if the drives end before."""
    options, end = drives.options, drives.count + budget
    proposer = make_proposer(options.search, limits, np.random.default_rng((options.seed, STREAM, restart)))
    proposed = [limits.easiest] if restart == 0 else proposer.propose()
    while drives.count < end:
        proposed = proposed[: end - drives.count]
        scores = drives.run([(case, options.seed) for case in proposed])
        best = max((s.ratio for s in scores if s.counted), default=0.0)
        report(f"{drives.count} drives; largest ratio of the last {len(scores)}: {best:.2f}")
        for k in _failures(drives, scores):
            if drives.count >= end:
                break
            again = confirmation(drives, proposed[k], CONFIRM)
            if len(_failures(drives, again)) >= NEEDED:
                return proposed[k]
            # The search follows failures of every seed, not of a lucky one.
            scores[k] = replace(scores[k], ratio=median(s.ratio for s in again))
        if proposed != [limits.easiest]:
            proposer.learn(scores)
        proposed = proposer.propose()
    return None


def _failures(drives: CaseDrives, scores: Sequence[DriveScore]) -> list[int]:
    """Return the indices of failures, the clearest first."""
    failed = [k for k, score in enumerate(scores) if drives.fails(score)]
    return sorted(failed, key=lambda k: -scores[k].ratio)


def confirmation(drives: CaseDrives, case: Case, offset: int) -> list[DriveScore]:
    """Return the scores of a case with new seeds; stop when too many pass."""
    before, drives.stage = drives.stage, "confirmation"
    trials = [(case, drives.options.seed + offset + k) for k in range(NEW_SEEDS)]
    scores: list[DriveScore] = []
    while len(scores) < NEW_SEEDS and len(scores) - len(_failures(drives, scores)) <= NEW_SEEDS - NEEDED:
        scores += drives.run(trials[len(scores) : len(scores) + 2])
    drives.stage = before
    return scores


def _simplest(drives: CaseDrives, case: Case, used: int) -> FoundCase:
    """Return the simplest form of a confirmed case that new seeds confirm, too."""
    begun, position, seed = drives.count, len(drives.history), drives.options.seed
    drives.stage = "shrinking"

    def fails(tried: Case) -> bool:
        scores = drives.run([(tried, seed), (tried, seed + SHRINK)])
        return len(_failures(drives, scores)) == len(scores)

    trail = shrink(case, drives.limits, fails)
    step = 1
    for back in range(1, len(trail) + 1):
        if back not in (step, len(trail)):
            continue
        step *= 2
        chosen, offset = trail[-back], RECHECK if back < len(trail) else CONFIRM
        scores = confirmation(drives, chosen, offset)
        failed = _failures(drives, scores)
        if len(failed) >= NEEDED:
            break
    first = seed + offset + min(failed)
    drives.stage = "search"
    return FoundCase(chosen, case, used, position, first, tuple(scores), drives.count - begun)
