"""Walkers in a run: the mapper sees them, the true maps do not hold them."""

import numpy as np
import pytest

from lirs_validation import RunConfig, validate
from lirs_wct.errors import ConfigError


def test_the_true_map_holds_no_walker_and_the_mappers_map_does(room: str) -> None:
    run = validate(room, seconds=6, seed=3, actors=6)
    assert run.record.config.actors == 6
    met = np.array(run.log.walker_beams)
    assert len(met) == len(run.log.observations)
    assert 0.02 < met.mean() < 0.5
    # What is occupied at the true poses is a wall or a block of the world.
    assert run.maps.scores["reference_false_occupied"] < 0.005
    assert run.maps.scores["false_occupied"] > 0.01


def test_without_walkers_nothing_is_left_out(room: str) -> None:
    run = validate(room, seconds=1, seed=3)
    assert len(run.log.walker_beams) == 0
    assert run.record.config.actors == 0


def test_the_usual_number_changes_no_digest() -> None:
    assert RunConfig(source="simple", actors=3).digest != RunConfig(source="simple").digest
    with pytest.raises(ConfigError, match="actors must be at least 0, got -1"):
        RunConfig(source="simple", actors=-1)
