"""Proposals of cases by CMA-ES or at random, and shrinking of a case to its cause.

CMA-ES: N. Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772. Shrinking: after Zeller and
Hildebrandt, "Simplifying and isolating failure-inducing input", IEEE TSE 2002.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from lirs_validation.search.space import Case, SearchParameter, SearchSpace
from lirs_wct.errors import ConfigError

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
FEWEST = 2
"""Fewest free parameters of CMA-ES; one alone is drawn at random."""


class CaseSource(Protocol):
    """Source of cases to try."""

    def propose(self) -> list[Case]:
        """Return the next cases."""

    def learn(self, losses: Sequence[float]) -> None:
        """Take in the losses (smaller is better) of the proposed cases, or of the first of them."""


class RandomProposer:
    """Uniform cases within the limits."""

    def __init__(self, limits: SearchSpace, rng: np.random.Generator) -> None:
        self._limits, self._rng = limits, rng

    def propose(self) -> list[Case]:
        """Return a batch of cases."""
        return [self._limits.case(x) for x in self._rng.random((BATCH, len(self._limits.free)))]

    def learn(self, losses: Sequence[float]) -> None:
        """Do nothing: the cases are independent."""


class CmaProposer:
    """CMA-ES with restarts.

    Args:
        limits: of the parameters.
        rng: of all random numbers.

    Raises:
        ConfigError: the package `cma` is not installed.
    """

    def __init__(self, limits: SearchSpace, rng: np.random.Generator) -> None:
        require_cma()
        self._limits, self._rng = limits, rng
        easiest = np.array([p.default_share for p in limits.free])
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

    def learn(self, losses: Sequence[float]) -> None:
        """Update the distribution; an incomplete generation is ignored."""
        if len(losses) < len(self._asked):
            return
        self._strategy.tell(self._asked, losses)
        better = min(losses) < self._best
        self._best, self._since = min(self._best, *losses), 0 if better else self._since + 1


def make_proposer(kind: str, limits: SearchSpace, rng: np.random.Generator) -> CaseSource:
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


def shrink(case: Case, limits: SearchSpace, fails: Fails) -> tuple[Case, ...]:
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


def _reset_singles(trail: list[Case], limits: SearchSpace, fails: Fails) -> None:
    """Reset single parameters until none can be reset."""
    shorter = True
    while shorter:
        shorter = False
        for parameter in limits.difference(trail[-1]):
            shorter |= _try(trail, _reset(trail[-1], [parameter]), fails)


def _halve(trail: list[Case], parameter: SearchParameter, fails: Fails) -> None:
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


def _reset(case: Case, parameters: list[SearchParameter]) -> Case:
    for parameter in parameters:
        case = case.with_value(parameter.name, float(parameter.default))
    return case


def _key(case: Case) -> tuple[float, ...]:
    return tuple(case.values[name] for name in sorted(case.values))


def require_cma() -> None:
    """Check that the package `cma` is installed.

    Raises:
        ConfigError: it is not.
    """
    try:
        import cma  # noqa: F401
    except ImportError:
        raise ConfigError(
            "the search needs the package cma: pip install 'lirs-wct[search]', or take --search random"
        ) from None
