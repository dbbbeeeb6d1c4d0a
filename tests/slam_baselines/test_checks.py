"""Checks of the fields of all configurations of mappers."""

import math
from collections.abc import Iterator
from dataclasses import fields
from importlib import import_module
from typing import Any

import pytest

from lirs_wct.checks import Checked
from lirs_wct.errors import ConfigError
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
        ("cartographer", "sampling_ratio", 1.5),
        ("cartographer", "initial_damping", 0.0),
        ("cartographer", "fresh_submaps_count", 0),
        ("cartographer", "global_min_score", 0.3),
        ("cartographer", "map_resolution", 0.0),
        ("cartographer", "search_level", 3),
        ("cartographer_original", "hit_probability", 0.5),
        ("cartographer_original", "miss_probability", 0.6),
        ("cartographer_original", "num_range_data", 0),
        ("cartographer_original", "resolution", 0.0),
        *(("gmapping", f"gyro_bias_{name}", 0.0) for name in ("prior", "drift", "gate")),
        ("gmapping", "lsigma", 0.0),
        ("gmapping", "minimumScore", 0.9),
        ("gmapping", "particles", 0),
        ("gmapping", "resampleThreshold", 1.5),
        ("gmapping_original", "delta", 0.0),
        ("gmapping_original", "iterations", 0),
        ("gmapping_original", "particles", 0),
        ("gmapping_original", "resampleThreshold", 1.5),
        *(("hector", f"calibration_{name}", 0.0) for name in ("per_meter", "noise", "memory", "slide")),
        ("hector", "localizable_memory", 0.5),
        ("hector", "localizable_score", 1.0),
        ("hector", "localizable_share", 0.0),
        ("hector", "localizable_turn", 0.0),
        ("hector", "map_multi_res_levels", 0),
        ("hector", "map_resolution", 0.0),
        ("hector", "decorrelation_distance", 0.0),
        ("hector", "known_ratio", 1.5),
        ("hector", "lost_after", 0),
        ("hector", "least_localizable_share", 0.8),
        ("hector", "lost_score", 0.0),
        ("hector", "lost_score", 0.9),
        ("hector", "log_odds_limit", 0.0),
        ("hector", "log_odds_limit", 13.0),
        ("hector", "update_factor_free", 0.5),
        ("hector", "update_factor_occupied", 0.5),
        ("hector_original", "map_resolution", 0.0),
        ("hector_original", "update_factor_free", 0.6),
        ("hector_original", "update_factor_occupied", 1.0),
    ],
)
def test_a_parameter_outside_its_interval_is_named(mapper: str, parameter: str, value: float) -> None:
    with pytest.raises(ConfigError, match=rf"^{parameter}( of {mapper})? must be .*, got {value:g}"):
        make_mapper(mapper, **{parameter: value})
