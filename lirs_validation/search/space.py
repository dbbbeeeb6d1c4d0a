"""Parameters of a search, their limits, and a case: a value for each of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError

DIGITS = 3
"""Significant digits of a value."""


@dataclass(frozen=True)
class SearchParameter:
    """One parameter of a search.

    Attributes:
        name: unique.
        group: parameters that are reset together first.
        default: value to which shrinking returns.
        low: smallest value.
        high: largest value.
        unit: of the value, for tables.
        whole: whether the value is a whole number.
        log: whether equal steps of the search multiply the value.
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
        """Return the legal value at a share of the way from the smallest to the largest."""
        if self.log:
            return self.clip(self.low * (self.high / self.low) ** share)
        return self.clip(self.low + share * (self.high - self.low))

    @property
    def default_share(self) -> float:
        """Share of the way from the smallest to the largest value at which the default lies."""
        if self.log:
            return math.log(self.default / self.low) / math.log(self.high / self.low)
        return (self.default - self.low) / (self.high - self.low)

    def within(self, low: float, high: float) -> SearchParameter:
        """Return the parameter with other limits; its default is the nearest legal value."""
        return replace(self, low=low, high=high, default=min(max(self.default, low), high))

    def read_within(self, path: Path, given: object, legal: tuple[float, float]) -> SearchParameter:
        """Return the parameter with the limits of a line of a file: `[low, high]` or one value.

        Raises:
            ConfigError: they are not legal; the message begins with the path.
        """
        pair = given if isinstance(given, list) else [given, given]
        low, high = legal
        numbers = [
            v for v in pair if isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v)
        ]
        if len(pair) != 2 or len(numbers) != 2 or not low <= numbers[0] <= numbers[1] <= high:
            raise ConfigError(
                f"{path}: {self.name} must be a number or [low, high] "
                f"within [{low:g}, {high:g}], got {given!r}"
            )
        return self.within(float(numbers[0]), float(numbers[1]))


@dataclass(frozen=True)
class Case:
    """Values of all parameters.

    Attributes:
        values: value by name.
    """

    values: Mapping[str, float] = field(default_factory=dict)

    def with_value(self, name: str, value: float) -> Case:
        """Return the case with one other value."""
        return Case({**self.values, name: value})


Space = TypeVar("Space", bound="SearchSpace")


@dataclass(frozen=True)
class SearchSpace:
    """Parameters to search.

    Attributes:
        parameters: all parameters, with the limits in use.
    """

    parameters: tuple[SearchParameter, ...]

    def changed(self: Space, parameter: SearchParameter, **others: Any) -> Space:
        """Return the space with one parameter replaced by that of the same name."""
        found = tuple(parameter if p.name == parameter.name else p for p in self.parameters)
        return replace(self, parameters=found, **others)

    def held(self: Space, names: Iterable[str]) -> Space:
        """Return the space with some parameters held at their defaults."""
        fixed = set(names)
        return replace(
            self,
            parameters=tuple(
                p.within(p.default, p.default) if p.name in fixed else p for p in self.parameters
            ),
        )

    @property
    def free(self) -> tuple[SearchParameter, ...]:
        """Parameters whose limits leave a choice."""
        return tuple(p for p in self.parameters if p.low < p.high)

    def require_free(self) -> None:
        """Check that something is left to search.

        Raises:
            ConfigError: no parameter is free.
        """
        if not self.free:
            raise ConfigError("no parameter is left to search: the limits hold all at one value")

    @property
    def easiest(self) -> Case:
        """The case with all defaults."""
        return Case({p.name: float(p.default) for p in self.parameters})

    def case(self, position: FloatArray) -> Case:
        """Return the case at a position (n,) in the unit cube of the free parameters."""
        found = self.easiest
        for parameter, share in zip(self.free, position.tolist(), strict=True):
            found = found.with_value(parameter.name, parameter.value(share))
        return found

    def difference(self, case: Case) -> tuple[SearchParameter, ...]:
        """Return the parameters in which a case differs from the defaults."""
        return tuple(p for p in self.parameters if case.values[p.name] != p.default)
