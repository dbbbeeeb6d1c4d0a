"""Growing sequences of values, stored as rows of float64.

A number takes 8 bytes; a Python object takes 24 or more.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import fields
from operator import attrgetter
from typing import Generic, TypeVar, overload

import numpy as np

from lirs_wct.arrays import FloatArray

T = TypeVar("T")


class Rows(Sequence[T], Generic[T]):
    """A growing sequence of values that all consist of the same number of floats.

    Args:
        make: builds a value from its numbers.
        row: returns the numbers of a value, in the same order.
        width: count of numbers in a value.
    """

    def __init__(self, make: Callable[..., T], row: Callable[[T], Iterable[float]], width: int) -> None:
        self._make, self._row, self._width = make, row, width
        self._numbers = array("d")

    @staticmethod
    def of(kind: Callable[..., T]) -> Rows[T]:
        """Return an empty sequence for a dataclass of two or more numbers, such as `Pose3`."""
        names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
        return Rows(kind, attrgetter(*names), len(names))

    def append(self, value: T) -> None:
        """Add a value at the end."""
        self._numbers.extend(self._row(value))

    def __len__(self) -> int:
        return len(self._numbers) // self._width

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> list[T]: ...
    def __getitem__(self, index: int | slice) -> T | list[T]:
        if isinstance(index, slice):
            return [self[k] for k in range(len(self))[index]]
        first = range(len(self))[index] * self._width
        return self._make(*self._numbers[first : first + self._width])

    def __iter__(self) -> Iterator[T]:
        for row in zip(*[iter(self._numbers)] * self._width, strict=True):
            yield self._make(*row)

    def as_array(self) -> FloatArray:
        """Return (n, width) float64, one row per value."""
        return np.array(self._numbers, dtype=np.float64).reshape(-1, self._width)
