"""What all methods offer alike: resolution, need of odometry, checked parameters."""

import math
from collections.abc import Iterator
from dataclasses import fields
from importlib import import_module
from typing import Any

import numpy as np
import pytest

from lirs_validation.experiment.mapper_under_test import mapper_named
from lirs_validation.metrics.trajectory import inside_95
from lirs_wct.errors import Checked, ConfigError
from lirs_wct.geometry import FloatArray, OccupancyGrid, covariance_fault
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import LaserScan
from slam_baselines.mapper import (
    ALL_CLOUD_MAPPERS,
    MAPPERS,
    asks_for,
    file_name,
    make_mapper,
    read_parameters,
    room_pose,
    room_scan,
    short_name,
)

SCAN = LaserScan(np.full(90, 2.0, np.float32), -0.8, 0.0175, 0.1, 10.0, 5.0)


@pytest.mark.parametrize("name", MAPPERS)
def test_the_resolution_is_one_word_for_all(name: str) -> None:
    mapper = make_mapper(name, resolution=0.1)
    mapper.update(SCAN, Pose2(), None)
    assert mapper.map().resolution == 0.1


@pytest.mark.parametrize("name", MAPPERS)
def test_a_mapper_that_requires_odometry_refuses_to_go_without(name: str) -> None:
    mapper = make_mapper(name)
    if asks_for(mapper, "requires_odometry"):
        with pytest.raises(ConfigError, match=rf"{name} needs odometry, the scan at 5\.0 s has none"):
            mapper.update(SCAN, None, None)
    else:
        assert mapper.update(SCAN, None, None) == Pose2()


def test_a_localizer_keeps_the_frame_of_its_map() -> None:
    p = np.zeros((80, 60))
    p[[0, -1]] = p[:, [0, -1]] = 1.0
    known = OccupancyGrid.from_probability(p, 0.05, Pose2(-1.0, 2.0))
    localizer = make_mapper("cartographer", map=known, start=Pose2(0.5, 3.0, 0.2))
    assert localizer.known_map is localizer.map() is known  # type: ignore[attr-defined]
    assert not asks_for(localizer, "requires_odometry")
    assert localizer.update(SCAN, None, None).distance(Pose2(0.5, 3.0, 0.2)) < 0.5


@pytest.mark.parametrize(
    ("mapper", "short", "file"),
    [
        ("hector", "hector", "hector"),
        ("evalio:dlio", "evalio:dlio", "evalio-dlio"),
        ("my_icp:Sweep", "Sweep", "Sweep"),
        ("a.b:c.d", "c.d", "c.d"),
    ],
)
def test_a_mapper_of_your_own_goes_by_its_class(mapper: str, short: str, file: str) -> None:
    assert (short_name(mapper), file_name(mapper)) == (short, file)


def test_a_text_becomes_fields_of_the_configuration() -> None:
    text = "num_range_data=40,min_score=0.6,use_online_correlative_scan_matching=true"
    config = mapper_named("cartographer_original", 1, text).config  # type: ignore[union-attr]
    assert config.num_range_data == 40
    assert config.min_score == 0.6
    assert config.max_constraint_distance == 15.0
    assert config.use_online_correlative_scan_matching is True


@pytest.mark.parametrize("text", ["a", "a=", "=1", "a=1,a=2", "a=1,,b=2"])
def test_a_text_that_is_no_list_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="NAME=VALUE"):
        read_parameters(text)


def test_infinity_stays_legal_where_it_is_the_default() -> None:
    assert make_mapper("hector", laser_max_dist=math.inf)
    with pytest.raises(ConfigError, match="finite"):
        make_mapper("hector", laser_max_dist=-math.inf)


@pytest.mark.parametrize(
    ("mapper", "options", "message"),
    [
        ("hektor", {}, "unknown mapper 'hektor'; legal: .*hector"),
        ("hector", {"_owner": "me"}, "unknown parameter of hector '_owner'; legal: [^_].* and [5-9]. more"),
        ("hector", {"match_iterations": (3,)}, "match_iterations are needed for 3 levels"),
        ("gmapping", {"particle": 3}, "did you mean particles"),
        ("gmapping", {"particles": 3.5}, "particles of gmapping must be a whole number, got 3.5"),
        ("hector", {"map_resolution": math.inf}, "map_resolution of hector must be a finite number, got inf"),
        ("gmapping", {"base_height": math.nan}, "base_height of gmapping must be a finite number, got nan"),
        ("gmapping", {"srr": True}, "srr of gmapping must be a number, got True"),
        ("gmapping", {"tracking.lost_score": 1}, "unknown parameter of gmapping 'tracking.lost_score'"),
    ],
)
def test_a_wrong_parameter_is_named(mapper: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make_mapper(mapper, **options)


PACKAGES = ("slam_baselines", "lirs_extensions.originals", "lirs_extensions.clouds")


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
        ("slam_toolbox_original", "loop_match_minimum_response_fine", 1.5),
    ],
)
def test_a_parameter_outside_its_interval_is_named(mapper: str, parameter: str, value: float) -> None:
    with pytest.raises(ConfigError, match=rf"^{parameter}( of {mapper})? must be .*, got {value:g}"):
        make_mapper(mapper, **{parameter: value})


@pytest.mark.parametrize("name", ["hector", "gmapping", "cartographer"])
def test_ours_claim_a_covariance_that_holds_their_errors(name: str) -> None:
    """Around a room with wheels that measure 3 % too much; the originals claim none."""
    mapper: Any = make_mapper(name)
    start, odometry, last = room_pose(0.0), Pose2(), room_pose(0.0)
    true, found, claimed = list[FloatArray](), list[FloatArray](), list[FloatArray]()
    for k in range(60):
        pose = room_pose(0.05 * k)
        step, last = last.inverse() @ pose, pose
        odometry = odometry @ Pose2(1.03 * step.x, step.y, step.yaw)
        found.append(mapper.update(room_scan(pose, 0.1 * k), odometry, None).as_array())
        true.append((start.inverse() @ pose).as_array())
        assert covariance_fault(mapper.covariance) is None
        claimed.append(mapper.covariance)
    share = inside_95(np.array(true), np.array(found), claimed)
    assert share is not None
    assert share >= 0.9
    assert np.sqrt(claimed[-1][0, 0]) < 0.2
    original: Any = make_mapper(f"{name}_original")
    assert original.covariance is None
