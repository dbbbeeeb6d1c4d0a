"""Validators of configuration fields; an error states name, legal values and given value."""

from __future__ import annotations

import math
from types import UnionType
from typing import Any, TypeGuard

import numpy as np

from lirs_wct.errors import ConfigError

NUMBERS = (float, int, np.floating, np.integer)


def require_above(
    config: Any, low: float, *names: str, of: str = "", unit: str = "", finite: bool = False
) -> None:
    """Raise ConfigError unless every named field is above `low` (and finite); NaN is illegal.

    Args:
        config: the dataclass.
        low: exclusive lower bound.
        *names: its fields.
        of: name of the owner in messages, such as "the motion filter".
        unit: of the values.
        finite: whether infinity is illegal.
    """
    _require(config, names, of, f"above {low:g}{_space(unit)}", finite, lambda value: value > low)


def require_at_least(
    config: Any, low: float, *names: str, of: str = "", unit: str = "", finite: bool = False
) -> None:
    """Raise ConfigError unless every named field is at least `low` (and finite); NaN is illegal."""
    _require(config, names, of, f"at least {low:g}{_space(unit)}", finite, lambda value: value >= low)


def require_within(config: Any, legal: str, *names: str, of: str = "", unit: str = "") -> None:
    """Raise ConfigError unless every named field lies in an interval such as "(0, 1]".

    NaN is illegal.
    """
    low, high = (float(bound) for bound in legal[1:-1].split(","))

    def inside(value: float) -> bool:
        above = value >= low if legal[0] == "[" else value > low
        return above and (value <= high if legal[-1] == "]" else value < high)

    _require(config, names, of, f"within {legal}{_space(unit)}", False, inside)


def require_type(config: Any, kind: type | UnionType, *names: str, of: str = "") -> None:
    """Raise ConfigError unless every named field has a type."""
    for name in names:
        value = getattr(config, name)
        if not isinstance(value, kind):
            owner = f" of {of}" if of else ""
            legal = getattr(kind, "__name__", str(kind))
            raise ConfigError(f"{name}{owner} must be of type {legal}, got {value!r}")


def require_seed(seed: Any) -> None:
    """Raise ConfigError unless a seed is an integer of at least 0."""
    if not isinstance(seed, int | np.integer) or isinstance(seed, bool):
        raise ConfigError(f"seed must be a whole number, got {seed!r}")
    if seed < 0:
        raise ConfigError(f"seed must be 0 or above, got {seed}")


def is_finite(value: object) -> bool:
    """Whether a value is a finite number."""
    return is_number(value) and math.isfinite(value)


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a number and not a bool."""
    return isinstance(value, NUMBERS) and not isinstance(value, bool)


def _require(config: Any, names: tuple[str, ...], of: str, legal: str, finite: bool, holds: Any) -> None:
    for name in names:
        value = getattr(config, name)
        if not is_number(value) or not holds(value) or (finite and not math.isfinite(value)):
            owner = f" of {of}" if of else ""
            kind = "a finite number " if finite else ""
            raise ConfigError(
                f"{name}{owner} must be {kind}{legal}, got {value if is_number(value) else repr(value)}"
            )


def _space(unit: str) -> str:
    return f" {unit}" if unit else ""


def number_fields(config: Any) -> list[str]:
    """Return the names of the fields that are numbers."""
    return [name for name in config.__dataclass_fields__ if isinstance(getattr(config, name), int | float)]
