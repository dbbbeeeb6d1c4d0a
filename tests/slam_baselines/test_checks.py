"""Checks of the fields of all configurations of mappers."""

import math
from collections.abc import Iterator
from dataclasses import fields
from importlib import import_module
from typing import Any

import pytest

from lirs_wct.errors import Checked, ConfigError
from slam_baselines.mapper import ALL_CLOUD_MAPPERS, MAPPERS, make_mapper

PACKAGES = ("slam_baselines", "lirs_extensions")


def subclasses(kind: type) -> Iterator[Any]:
    for one in kind.__subclasses__():
        yield one
        yield from subclasses(one)


def configs() -> list[Any]:
    for method in (*MAPPERS.values(), *ALL_CLOUD_MAPPERS.values()):
        import_module(method.module)
    found = {one for one in subclasses(Checked) if one.__module__.startswith(PACKAGES)}
    return sorted(found, key=lambda one: (one.__module__, one.__name__))


@pytest.mark.parametrize("config", configs(), ids=lambda config: config.__name__)
def test_every_checked_field_names_what_is_illegal(config: Any) -> None:
    checked = [entry.name for entry in fields(config) if "check" in entry.metadata]
    assert checked
    for name in checked:
        for bad in (math.nan, -1.0, True, "much"):
            with pytest.raises(ConfigError, match=f"^{name}{config._owner} must be .*, got "):
                config(**{name: bad})


@pytest.mark.parametrize(
    ("mapper", "parameter", "value"),
    [
        ("cartographer", "global_min_score", 0.3),
        ("cartographer", "sampling_ratio", 1.5),
        ("cartographer", "search_level", 3),
        ("cartographer_original", "hit_probability", 0.5),
        ("cartographer_original", "miss_probability", 0.6),
        ("gmapping", "minimumScore", 0.9),
        ("gmapping", "particles", 0),
        ("gmapping", "resampleThreshold", 1.5),
        ("gmapping_original", "iterations", 0),
        ("hector", "calibration_memory", 0.0),
        ("hector", "known_ratio", 1.5),
        ("hector", "least_localizable_share", 0.8),
        ("hector", "log_odds_limit", 13.0),
        ("hector", "lost_score", 0.9),
        ("hector", "update_factor_free", 0.5),
        ("hector_original", "update_factor_occupied", 1.0),
    ],
)
def test_a_parameter_outside_its_interval_is_named(mapper: str, parameter: str, value: float) -> None:
    with pytest.raises(ConfigError, match=rf"^{parameter}( of {mapper})? must be .*, got {value:g}"):
        make_mapper(mapper, **{parameter: value})
