"""Parameters of a mapper as text and as keywords."""

import pytest

from lirs_validation.experiment.mapper_loading import mapper_named
from lirs_wct.errors import ConfigError
from slam_baselines.mapper import make_mapper, read_parameters


def test_a_text_becomes_fields_of_the_configuration_and_of_its_parts() -> None:
    text = "num_range_data=40,pose_graph.constraint_builder.min_score=0.6"
    text += ",use_online_correlative_scan_matching=true"
    config = mapper_named("cartographer_original", 1, text).config  # type: ignore[union-attr]
    assert config.num_range_data == 40
    assert config.pose_graph.constraint_builder.min_score == 0.6
    assert config.pose_graph.constraint_builder.max_constraint_distance == 15.0
    assert config.use_online_correlative_scan_matching is True


def test_no_text_is_no_parameter() -> None:
    assert read_parameters("") == {}


@pytest.mark.parametrize("text", ["a", "a=", "=1", "a=1,a=2", "a=1,,b=2"])
def test_a_text_that_is_no_list_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="NAME=VALUE"):
        read_parameters(text)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"particle": 3}, "did you mean particles"),
        ({"particles": 3.5}, "particles of gmapping must be a whole number, got 3.5"),
        ({"srr": True}, "srr of gmapping must be a number, got True"),
        ({"srr.a": 1}, "unknown parameter"),
        ({"tracking.lost": 1}, "unknown parameter of gmapping's tracking"),
    ],
)
def test_a_wrong_parameter_is_named(given: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make_mapper("gmapping", **given)
