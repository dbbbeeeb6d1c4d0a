"""A run without attitude: no mapper learns how the robot is tilted, a user's own included."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_validation import validate
from lirs_validation.config import ATTITUDES, Attitude, RunConfig
from lirs_wct.errors import ConfigError


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_a_users_mapper_is_given_the_readings_or_none(
    hills: dict[str, Any], monkeypatch: pytest.MonkeyPatch, attitude: Attitude
) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parent)
    run = validate(**hills, mapper="own_mappers:Own", seconds=1, attitude=attitude)
    assert len(run.log.observations) > 20
    given = len(run.log.observations) if attitude == "imu" else 0
    assert run.record.mapper["counts"] == {"attitudes": given}
    assert run.record.config.attitude == attitude
    # What was recorded, and the map at the true poses, have the attitude in either case.
    assert any(abs(observation.imu.pitch) > 0.01 for observation in run.log.observations)


def test_only_the_mapper_loses_the_attitude(hills: dict[str, Any]) -> None:
    runs = [validate(**hills, seconds=2, attitude=attitude) for attitude in ATTITUDES]
    truths, estimates = ([run.log.trajectories()[k].positions for run in runs] for k in (0, 1))
    np.testing.assert_array_equal(*truths)
    np.testing.assert_array_equal(*(run.maps.true_pose.log_odds for run in runs))
    assert not np.array_equal(*estimates)


def test_an_attitude_that_is_none_is_refused() -> None:
    with pytest.raises(ConfigError, match="attitude must be imu or none, got 'true'"):
        RunConfig(source="simple", attitude="true")  # type: ignore[arg-type]
