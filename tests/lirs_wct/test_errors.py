"""Causes of errors in plain words."""

import json
from pathlib import Path

import pytest

from lirs_wct.errors import reason_of


def raised(call: object) -> BaseException:
    with pytest.raises(Exception) as caught:  # noqa: PT011  any
        call()  # type: ignore[operator]
    return caught.value


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (raised(lambda: b"\xff".decode()), "is not text: byte 0 is not UTF-8"),
        (raised(lambda: json.loads("{\n]")), "is not JSON: line 2: Expecting property name"),
        (raised(lambda: int("9" * 5000)), "holds a number with too many digits"),
        (raised(Path("/none/such").read_bytes), "cannot be read: No such file or directory"),
        (KeyError("schema"), "'schema' is missing"),
        (MemoryError(), "needs more memory than there is"),
        (EOFError("x"), "ends too early"),
        (AssertionError(), "is damaged"),
        (ValueError("DaeMalformedError: no\n element"), "no element"),
    ],
)
def test_a_reason_is_one_line_without_the_name_of_a_class(error: BaseException, reason: str) -> None:
    assert reason_of(error).startswith(reason)
    assert "Error" not in reason_of(error)
    assert "\n" not in reason_of(error)
