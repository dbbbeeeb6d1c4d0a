"""Noise of the laser is what it claims: chi-square tests over 1e5 beams."""

import math

import numpy as np
import pytest
from scipy import stats

from lirs_envs.lidar.lidar import Lidar
from lirs_envs.lidar.noise import DATASHEET, LidarNoise, draw_noise, lidar_noise, measure
from lirs_envs.lidar.presets import LIDARS
from lirs_envs.lidar.ray_casting import RayCaster
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.pose import Pose3

BEAMS = 100_000
ALMOST_SURE = 1e-4


def measured(exact: np.ndarray, noise: LidarNoise, seed: int = 0, limits=(0.1, 30.0)) -> np.ndarray:
    normal, uniform = draw_noise(noise, len(exact), np.random.default_rng(seed))
    ranges = np.empty(len(exact), np.float32)
    measure(exact, normal, uniform, limits, noise.parameters, ranges)
    return ranges.astype(np.float64)


@pytest.mark.parametrize("name", list(LIDARS))
@pytest.mark.parametrize("level", ["simulated", "datasheet"])
def test_range_noise_is_gaussian_with_the_stated_deviation(name: str, level: str) -> None:
    noise = lidar_noise(LIDARS[name], level)
    sigma = noise.sigma + 3.0 * noise.sigma_relative
    # All over a step: at its middle, the rounding of a coarse one is not uniform.
    exact = 3.0 + noise.quantization * np.random.default_rng(1).random(BEAMS)
    ranges = measured(exact, noise)
    errors = (ranges - exact)[np.isfinite(ranges)] / math.hypot(sigma, noise.quantization / math.sqrt(12))
    # The variance: chi-square with as many degrees as beams.
    tail = stats.chi2.cdf(float(errors @ errors), len(errors))
    assert ALMOST_SURE < tail < 1 - ALMOST_SURE
    # The shape: counts in 20 bins of equal probability, where quantisation is finer than they are.
    if noise.quantization < sigma / 10:
        counts = np.histogram(
            stats.norm.cdf(errors + dither(errors, noise.quantization / sigma)), 20, (0, 1)
        )[0]
        assert stats.chisquare(counts).pvalue > ALMOST_SURE


def dither(errors: np.ndarray, step: float) -> np.ndarray:
    """Undo the comb of quantisation, which bins would else alias with."""
    return np.random.default_rng(9).uniform(-step / 2, step / 2, len(errors))


def test_quantisation() -> None:
    ranges = measured(np.linspace(1, 2, BEAMS), LidarNoise(quantization=0.001))
    assert np.abs(ranges * 1000 - np.round(ranges * 1000)).max() < 1e-3
    assert np.abs(ranges - np.linspace(1, 2, BEAMS)).max() <= 0.0005 + 1e-6


def test_dropouts_are_nan_and_as_many_as_stated() -> None:
    lost = np.isnan(measured(np.full(BEAMS, 3.0), LidarNoise(dropout=0.01)))
    assert stats.binomtest(int(lost.sum()), BEAMS, 0.01).pvalue > ALMOST_SURE
    # They come one by one: neighbors are lost together by chance only.
    pairs = int((lost[1:] & lost[:-1]).sum())
    assert stats.poisson.sf(pairs - 1, BEAMS * 1e-4) > ALMOST_SURE


def test_mixed_pixels_lie_between_the_two_sides_of_an_edge() -> None:
    exact = np.where(np.arange(BEAMS) % 2 == 0, 2.0, 5.0)
    ranges = measured(exact, LidarNoise(mixed_pixels=0.3))
    mixed = (ranges > 2.0 + 1e-6) & (ranges < 5.0 - 1e-6)
    assert stats.binomtest(int(mixed.sum()), BEAMS - 1, 0.3).pvalue > ALMOST_SURE
    assert stats.kstest((ranges[mixed] - 2) / 3, "uniform").pvalue > ALMOST_SURE
    np.testing.assert_allclose(ranges[~mixed], exact[~mixed], atol=1e-6)
    # No edge, nothing mixed; towards nothing neither.
    for calm in (np.where(np.arange(100) % 2 == 0, 2.0, 2.1), np.where(np.arange(100) % 2 == 0, 2.0, np.inf)):
        np.testing.assert_allclose(measured(calm, LidarNoise(mixed_pixels=1.0)), calm, atol=1e-6)


def test_levels() -> None:
    preset = LIDARS["utm30lx"]
    assert lidar_noise(preset, "none") == LidarNoise()
    assert lidar_noise(preset, "simulated") == LidarNoise(sigma=0.004)
    assert lidar_noise(preset, "datasheet").sigma == 0.03
    assert set(DATASHEET) == set(LIDARS)
    with pytest.raises(ConfigError, match=r"'much'; legal: datasheet, none, simulated"):
        lidar_noise(preset, "much")  # type: ignore[arg-type]
    for wrong in (
        {"sigma": -1.0},
        {"dropout": 1.5},
        {"quantization": math.nan},
        {"edge_threshold": math.inf},
    ):
        with pytest.raises(ConfigError, match="lidar noise"):
            LidarNoise(**wrong)


def test_no_noise_is_exact_and_the_seed_decides_otherwise() -> None:
    caster = RayCaster(HeightField.centered(np.zeros((2, 2), np.float32), (100.0, 100.0)))
    pose = Pose3.from_rpy(0.0, 0.0, 0.5, 0.0, 0.1, 0.0)

    def scan(level: str, seed: int) -> bytes:
        preset = LIDARS["lms111"]
        lidar = Lidar(preset, caster, Pose3(), np.random.default_rng(seed), lidar_noise(preset, level))
        return lidar.scan(pose, 0.0).ranges.tobytes()

    assert scan("none", 1) == scan("none", 2)
    assert scan("datasheet", 1) == scan("datasheet", 1) != scan("datasheet", 2)
