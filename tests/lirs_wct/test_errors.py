"""Causes of errors in plain words, and checks of fields: legal values, and the words of a refusal."""

import json
import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_wct.errors import (
    Checked,
    ConfigError,
    check_field,
    check_seed,
    limited,
    of_type,
    one_of,
    reason_of,
    require_within,
    within,
)


@dataclass(frozen=True, kw_only=True)
class LaserConfig(Checked, of="the laser"):
    rate: float = limited(10.0, "(0, inf)", "Hz")
    share: float = limited(0.5, "(0, 1]")
    beams: int = limited(8, "[2, inf)", whole=True)
    range_max: float | None = limited(None, "(0, inf]", "m")
    name: str = check_field(of_type(str), default="a")
    kind: str = check_field(one_of(("line", "ring")), default="line")


@given(st.floats(allow_nan=True))
def test_intervals_are_those_of_mathematics(value: float) -> None:
    for legal, holds in (
        ("(0, inf]", value > 0),
        ("(0, inf)", 0 < value < math.inf),
        ("[0, inf)", value >= 0 and math.isfinite(value)),
        ("(0, 1]", 0 < value <= 1),
        ("[0, 1)", 0 <= value < 1),
        ("(-inf, 0]", -math.inf < value <= 0),
    ):
        if holds:
            within(legal)(value, "x")
        else:
            with pytest.raises(ConfigError):
                within(legal)(value, "x")


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"rate": -1.0}, "rate of the laser must be a finite number above 0 Hz, got -1.0"),
        ({"rate": math.nan}, "rate of the laser must be a finite number above 0 Hz, got nan"),
        ({"rate": True}, "rate of the laser must be above 0 Hz, got True"),
        ({"rate": None}, "rate of the laser must be a finite number above 0 Hz, got None"),
        ({"rate": 0}, "rate of the laser must be above 0 Hz, got 0"),
        ({"rate": "fast"}, "rate of the laser must be a finite number above 0 Hz, got 'fast'"),
        ({"share": 2.0}, "share of the laser must be within (0, 1], got 2.0"),
        ({"beams": 2.5}, "beams of the laser must be a whole number at least 2, got 2.5"),
        ({"range_max": -1.0}, "range_max of the laser must be above 0 m, got -1.0"),
        ({"name": 3}, "name of the laser must be of type str, got 3"),
        ({"kind": "rings"}, "unknown kind of the laser 'rings'"),
    ],
)
def test_the_sentence_names_field_owner_unit_and_value(values: dict[str, object], sentence: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(sentence)):
        LaserConfig(**values)  # type: ignore[arg-type]


def test_legal_values_pass_and_a_missing_default_may_be_named() -> None:
    config = LaserConfig(range_max=math.inf, beams=np.int64(4))
    assert replace(config, range_max=None).range_max is None
    assert check_seed(0) is None


@pytest.mark.parametrize("seed", [-1, 1.0, True, "1", None])
def test_a_seed_is_a_whole_number(seed: object) -> None:
    with pytest.raises(ConfigError, match="seed must be a whole number at least 0, got"):
        check_seed(seed)


def test_an_interval_that_depends_on_another_field_names_the_owner() -> None:
    with pytest.raises(ConfigError, match=re.escape("share of a laser must be within (0, 0.25], got 0.5")):
        require_within(LaserConfig(), "(0, 0.25]", "share", of="a laser")


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
