"""Search of a space of parameters: cases, proposals, shrinking, kept trials.

CMA-ES: N. Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772. Shrinking: after Zeller and
Hildebrandt, "Simplifying and isolating failure-inducing input", IEEE TSE 2002.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from lirs_validation.sweep.engines import Failure, WorkerPool
from lirs_wct import ConfigError, FloatArray, OutputError, Progress, WctError

DIGITS = 3
"""Significant digits of a value."""
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


@dataclass(frozen=True)
class SearchParameter:
    """One parameter of a search.

    Attributes:
        group: Group of parameters that are reset together first.
        default: Value to which shrinking returns.
        unit: Unit of the value, for tables.
        whole: Whether the value is a whole number.
        log: Whether equal steps of the search multiply the value.
    """

    name: str
    group: str
    default: float
    low: float
    high: float
    unit: str = ""
    whole: bool = False
    log: bool = False

    def clip(self, value: float) -> float:
        """Return the nearest legal value with few digits."""
        inside = min(max(value, self.low), self.high)
        if self.whole:
            return float(round(inside))
        return float(f"{inside:.{DIGITS}g}")

    def value(self, share: float) -> float:
        """Return the legal value at a share of the limits."""
        if self.log:
            return self.clip(self.low * (self.high / self.low) ** share)
        return self.clip(self.low + share * (self.high - self.low))

    @property
    def default_share(self) -> float:
        """Share of the limits at which the default lies."""
        if self.log:
            return math.log(self.default / self.low) / math.log(self.high / self.low)
        return (self.default - self.low) / (self.high - self.low)

    def within(self, low: float, high: float) -> SearchParameter:
        """Return the parameter with other limits; its default is the nearest legal value."""
        return replace(self, low=low, high=high, default=min(max(self.default, low), high))

    def read_within(self, path: Path, given: object, legal: tuple[float, float]) -> SearchParameter:
        """Return the parameter with given limits, `[low, high]` or one value."""
        pair: list[Any] = given if isinstance(given, list) else [given, given]
        low, high = legal
        numbers = [v for v in pair if type(v) in (int, float) and math.isfinite(v)]
        if len(pair) != 2 or len(numbers) != 2 or not low <= numbers[0] <= numbers[1] <= high:
            raise ConfigError(
                f"{path}: {self.name} must be a number or [low, high] "
                f"within [{low:g}, {high:g}], got {given!r}"
            )
        return self.within(float(numbers[0]), float(numbers[1]))


@dataclass(frozen=True)
class Case:
    """Values of all parameters by name."""

    values: Mapping[str, float] = field(default_factory=dict)

    def with_value(self, name: str, value: float) -> Case:
        """Return the case with one other value."""
        return Case({**self.values, name: value})


Space = TypeVar("Space", bound="SearchSpace")


@dataclass(frozen=True)
class SearchSpace:
    """Parameters to search, with the limits in use."""

    parameters: tuple[SearchParameter, ...]

    def with_parameter(self: Space, parameter: SearchParameter) -> Space:
        """Return the space with one parameter replaced by that of the same name."""
        replaced = (parameter if p.name == parameter.name else p for p in self.parameters)
        return replace(self, parameters=tuple(replaced))

    def held(self: Space, names: Collection[str]) -> Space:
        """Return the space with some parameters held at their defaults."""
        fixed = (p.within(p.default, p.default) if p.name in names else p for p in self.parameters)
        return replace(self, parameters=tuple(fixed))

    @property
    def free(self) -> tuple[SearchParameter, ...]:
        """Parameters whose limits leave a choice."""
        return tuple(p for p in self.parameters if p.low < p.high)

    def require_free(self) -> None:
        """Check that something is left to search."""
        if not self.free:
            raise ConfigError("no parameter is left to search: the limits hold all at one value")

    @property
    def easiest(self) -> Case:
        """The case with all defaults."""
        return Case({p.name: float(p.default) for p in self.parameters})

    def case(self, position: FloatArray) -> Case:
        """Return the case at a position (n,) in the unit cube of the free parameters."""
        pairs = zip(self.free, position.tolist(), strict=True)
        return Case({**self.easiest.values, **{p.name: p.value(share) for p, share in pairs}})

    def difference(self, case: Case) -> tuple[SearchParameter, ...]:
        """Return the parameters in which a case differs from the defaults."""
        return tuple(p for p in self.parameters if case.values[p.name] != p.default)


HALVINGS = 3
"""Times that the way of a value to its default is halved."""
Fails = Callable[[Case], bool]


def shrink(case: Case, limits: SearchSpace, fails: Fails) -> tuple[Case, ...]:
    """Return the failing cases on the way to the simplest one, which is the last.

    In the last case, no single parameter can be reset without its passing.
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
        # Move the value towards its default while the case fails.
        passing, name = float(parameter.default), parameter.name
        for _ in range(HALVINGS):
            middle = parameter.clip((passing + trail[-1].values[name]) / 2)
            if not _try(trail, trail[-1].with_value(name, middle), test):
                passing = middle
    _reset_singles(trail, limits, test)
    return tuple(trail)


def _reset_singles(trail: list[Case], limits: SearchSpace, fails: Fails) -> None:
    """Reset single parameters until none can be reset."""
    shorter = True
    while shorter:
        shorter = False
        for parameter in limits.difference(trail[-1]):
            shorter |= _try(trail, _reset(trail[-1], [parameter]), fails)


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


Score = TypeVar("Score")
Arguments = tuple[Any, ...]
"""Arguments of the function that measures a trial."""


def trial_key(entry: Mapping[str, Any]) -> str:
    """Return the digest of everything that decides a trial."""
    return hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()[:16]


def measure_trial(measure: Callable[..., Score], arguments: Arguments, progress: Progress) -> Score:
    """Return the score of a trial, as the job of a worker."""
    return measure(*arguments)


class TrialArchive(Generic[Score]):
    """Measures trials, counts them and keeps their scores.

    Attributes:
        count: Number of different trials that were requested, those of an earlier search included.

    Args:
        path: File of the scores.
        kind: Class of the scores, a dataclass.
        pool: Processes that measure; None = this one.
    """

    def __init__(self, path: Path, kind: type[Score], pool: WorkerPool | None = None) -> None:
        self.count = 0
        self._path, self._pool = path, pool
        self._kept = _read_archive(path, kind)
        self._used: set[str] = set()

    def scores(
        self, measure: Callable[..., Score], trials: Sequence[tuple[str, Arguments]], method: str
    ) -> list[Score]:
        """Return the scores of trials, given as key and arguments, in their order."""
        pending = {key: arguments for key, arguments in trials if key not in self._kept}
        for key, score in zip(pending, self._measure(measure, list(pending.values()), method), strict=True):
            self._kept[key] = score
            entry: dict[str, Any] = {"key": key} | asdict(score)  # type: ignore[call-overload]
            try:
                with self._path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(entry) + "\n")
            except OSError as error:
                raise OutputError(f"{self._path}: cannot be written: {error.strerror or error}") from error
        keys = [key for key, _ in trials]
        self.count += len(set(keys) - self._used)
        self._used |= set(keys)
        return [self._kept[key] for key in keys]

    def _measure(
        self, measure: Callable[..., Score], trials: Sequence[Arguments], method: str
    ) -> Iterator[Score]:
        """Yield the scores of new trials in their order."""
        if self._pool is None:
            for arguments in trials:
                yield measure(*arguments)
            return
        jobs = [partial(measure_trial, measure, arguments) for arguments in trials]
        ended: dict[int, Score] = {}
        following = 0
        for number, score in self._pool.run(jobs):
            if isinstance(score, Failure):
                raise WctError(f"a process that drove {method} died; the same command continues the search")
            ended[number] = score
            while following in ended:
                yield ended.pop(following)
                following += 1


def _read_archive(path: Path, kind: type[Score]) -> dict[str, Score]:
    """Return the scores in an archive; make its folder, and remove an incomplete last line."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.is_file():
            return {}
        lines = path.read_bytes().splitlines(keepends=True)
        whole = [line for line in lines if line.endswith(b"\n")]
        if whole != lines:
            os.truncate(path, sum(map(len, whole)))
    except OSError as error:
        raise OutputError(f"{path}: cannot be opened: {error.strerror or error}") from error
    scores: dict[str, Score] = {}
    for number, line in enumerate(whole, start=1):
        try:
            entry: dict[str, Any] = json.loads(line)
            key = entry.pop("key")
            scores[key] = kind(**entry)
        except (ValueError, KeyError, TypeError, AttributeError):
            raise OutputError(f"{path}: line {number} is damaged; remove it to drive again") from None
    return scores


def process_pool(jobs: int) -> AbstractContextManager[WorkerPool | None]:
    """Give the processes for concurrent drives; None for one job."""
    return nullcontext() if jobs == 1 else WorkerPool(jobs)


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
        raise ConfigError("the search needs the package cma: pip install 'lirs-wct[search]'") from None
