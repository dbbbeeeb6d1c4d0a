"""Validators of fields: what is legal, what is refused, and in which words."""

import math
import re
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lirs_wct.errors import ConfigError
from lirs_wct.field_validators import require_above, require_at_least, require_within


@given(st.floats(allow_nan=True))
def test_intervals_are_those_of_mathematics(value: float) -> None:
    config = SimpleNamespace(x=value)
    for legal, holds in (
        (lambda: require_above(config, 0, "x"), value > 0),
        (lambda: require_at_least(config, 0, "x", finite=True), value >= 0 and math.isfinite(value)),
        (lambda: require_within(config, "(0, 1]", "x"), 0 < value <= 1),
        (lambda: require_within(config, "[0, 1)", "x"), 0 <= value < 1),
    ):
        if holds:
            legal()
        else:
            with pytest.raises(ConfigError):
                legal()


def test_the_sentence_names_field_owner_unit_and_value() -> None:
    config = SimpleNamespace(rate=-1.0)
    sentence = "rate of the laser must be a finite number above 0 Hz, got -1.0"
    with pytest.raises(ConfigError, match=re.escape(sentence)):
        require_above(config, 0, "rate", of="the laser", unit="Hz", finite=True)
    with pytest.raises(ConfigError, match=re.escape("rate must be within (0, 1], got -1.0")):
        require_within(config, "(0, 1]", "rate")
