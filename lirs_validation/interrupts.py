"""Ctrl-C, also where it comes in disguise."""

from __future__ import annotations

from collections.abc import Iterator


def is_interrupt(error: BaseException) -> bool:
    """Tell whether an error is a Ctrl-C; inside a compiled kernel it comes out wrapped in a SystemError."""
    return isinstance(error, (KeyboardInterrupt, SystemError)) and any(
        isinstance(cause, KeyboardInterrupt) for cause in _causes(error)
    )


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
