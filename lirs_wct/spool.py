"""Sequence of equal arrays, stored in a temporary file if it is too large for memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import SpooledTemporaryFile, gettempdir
from typing import TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import OutputError

IN_MEMORY = 1 << 18
"""Bytes up to which a spool stays in memory."""
BUFFER = 1 << 16
"""Bytes per write to the file."""
AT_ONCE = 1 << 19
"""Bytes per read during iteration over all arrays."""

Element = TypeVar("Element", bound=np.generic)


class ArraySpool(Sequence[NDArray[Element]]):
    """A growing sequence of arrays of one shape and type, in memory or in an unnamed file.

    The operating system removes such a file when the process ends, for any reason. Access returns copies.

    Args:
        folder: folder of the file; None = the system's folder for temporary files.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        where = None if folder is None else str(folder)
        self._file = SpooledTemporaryFile(IN_MEMORY, buffering=BUFFER, dir=where)  # noqa: SIM115  lives as long as the spool
        self._count, self._shape, self._bytes = 0, (0,), 0
        self._dtype: np.dtype[Element] | None = None
        self._read_since = False

    def append(self, values: NDArray[Element]) -> None:
        """Append an array of the first array's shape and type.

        Raises:
            ValueError: the array has another shape or type.
            OutputError: the file cannot be written.
        """
        if self._dtype is None:
            self._dtype, self._shape, self._bytes = values.dtype, values.shape, values.nbytes
        if (values.dtype, values.shape) != (self._dtype, self._shape):
            raise ValueError(
                f"arrays of a spool must be {self._dtype} {self._shape}, got {values.dtype} {values.shape}"
            )
        try:
            if self._read_since:
                self._file.seek(self._count * self._bytes)
            self._file.write(values.tobytes())
        except OSError as error:
            where = self._folder or gettempdir()
            raise OutputError(f"{where}: cannot be written: {error.strerror or error}") from error
        self._count, self._read_since = self._count + 1, False

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> NDArray[Element]: ...
    @overload
    def __getitem__(self, index: slice) -> list[NDArray[Element]]: ...
    def __getitem__(self, index: int | slice) -> NDArray[Element] | list[NDArray[Element]]:
        if isinstance(index, slice):
            return [self[k] for k in range(len(self))[index]]
        return next(self._read(range(len(self))[index], 1))

    def __iter__(self) -> Iterator[NDArray[Element]]:
        some = max(1, AT_ONCE // max(1, self._bytes))
        for first in range(0, len(self), some):
            yield from self._read(first, min(some, len(self) - first))

    def _read(self, first: int, count: int) -> Iterator[NDArray[Element]]:
        """Yield `count` arrays from index `first` on."""
        self._file.seek(first * self._bytes)
        self._read_since = True
        read = np.frombuffer(self._file.read(count * self._bytes), self._dtype)
        for values in read.reshape(count, *self._shape):
            yield values.copy()
