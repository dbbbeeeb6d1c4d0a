"""Systematic resampling against filterpy's, fed with the same random number."""

import numpy as np
import pytest
from filterpy.monte_carlo import systematic_resample as filterpys

from slam_baselines.gmapping.particles import systematic_resample


@pytest.mark.parametrize("seed", range(20))
def test_same_particles_live_on(seed: int) -> None:
    weights = np.random.default_rng(seed).dirichlet(np.full(30, 0.3))
    state = np.random.get_state()  # noqa: NPY002  filterpy draws from the global generator
    try:
        np.random.seed(seed)  # noqa: NPY002
        first = np.random.random()  # noqa: NPY002
        np.random.seed(seed)  # noqa: NPY002
        theirs = filterpys(weights)
    finally:
        np.random.set_state(state)  # noqa: NPY002

    class Same:
        def random(self) -> float:
            return first

    ours = systematic_resample(weights, Same())  # type: ignore[arg-type]
    np.testing.assert_array_equal(ours, theirs)
