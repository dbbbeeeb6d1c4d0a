"""Search for failures: proposals of cases, confirmation with new seeds, and shrinking."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from lirs_extensions.search.case_search import Case, make_proposer, shrink
from lirs_extensions.search.falsify.drives import WORST, CaseDrives, DriveScore, SearchLimits

MIN_RATIO = 0.01
"""Ratios below count as this one."""
UNCOUNTED = 1.0
"""Loss of a case that does not count, added to the largest loss of one that does."""


def loss(score: DriveScore) -> float:
    """Return the value to minimize: minus the logarithm of the ratio.

    A case that does not count is worse than any that does.
    """
    if not score.counted:
        return UNCOUNTED - math.log(MIN_RATIO)
    return -math.log(min(max(score.ratio, MIN_RATIO), WORST))


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
        case: Simplest form of the case.
        found: the case as the search found it.
        drives: drives of the search up to its confirmation.
        position: number of the last of them in the history.
        seed: Seed of a drive that fails.
        scores: Scores of the simplest form with new seeds.
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
            proposer.learn([loss(score) for score in scores])
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
