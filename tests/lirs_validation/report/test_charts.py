"""The charts of a report."""

import numpy as np
import pytest

from lirs_validation.report.pictures import series_band
from tests.lirs_validation.records import entry


def test_the_band_is_of_the_seeds() -> None:
    runs = [entry(seed=1, rtf=10.0), entry(seed=2, rtf=20.0)]
    runs[1]["rtf"]["series"] = runs[1]["rtf"]["series"][:10]
    mean, std = series_band(runs)
    a, b = (run["rtf"]["series"] for run in runs)
    assert len(mean) == 30
    assert mean[0] == pytest.approx((a[0] + b[0]) / 2)
    assert std[0] == pytest.approx(abs(a[0] - b[0]) / 2)
    assert (mean[20], std[20]) == (a[20], 0.0)


def test_the_band_of_one_seed_is_over_time() -> None:
    run = entry(rtf=10.0)
    series = np.array(run["rtf"]["series"])
    mean, std = series_band([run])
    assert mean[15] == pytest.approx(series[11:20].mean())
    assert std[15] == pytest.approx(series[11:20].std())
    assert mean[0] == pytest.approx(series[:5].mean())
    assert len(mean) == 30
