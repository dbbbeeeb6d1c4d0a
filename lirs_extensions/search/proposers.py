"""Proposers of cases: at random, or by CMA-ES."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from lirs_extensions.search.case_search import Case, SearchSpace
from lirs_wct import ConfigError

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
MIN_PARAMETERS = 2
"""Fewest free parameters of CMA-ES; one alone is drawn at random."""


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
    """CMA-ES with restarts."""

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


def make_proposer(kind: str, limits: SearchSpace, rng: np.random.Generator) -> RandomProposer | CmaProposer:
    """Return the source of cases of a search."""
    limits.require_free()
    if kind == "random" or len(limits.free) < MIN_PARAMETERS:
        return RandomProposer(limits, rng)
    return CmaProposer(limits, rng)


def require_cma() -> None:
    """Check that the package `cma` is installed."""
    try:
        import cma  # noqa: F401
    except ImportError:
        raise ConfigError("the search needs the package cma: pip install '.[search]'") from None
