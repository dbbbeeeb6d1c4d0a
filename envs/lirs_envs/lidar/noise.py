"""Lidar noise: errors of the devices, and the model that turns true ranges into measured ones."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from lirs_envs.lidar.presets import LidarPreset
from lirs_wct.arrays import Float32Array, FloatArray, njit
from lirs_wct.errors import Checked, limited, unknown_name

NoiseLevel = Literal["none", "simulated", "datasheet"]
LEVELS: tuple[NoiseLevel, ...] = get_args(NoiseLevel)


class NoiseParameters(NamedTuple):
    """`LidarNoise` as the kernel reads it."""

    sigma: float
    sigma_relative: float
    quantization: float
    dropout: float
    mixed_pixels: float
    edge_threshold: float


@dataclass(frozen=True, kw_only=True)
class LidarNoise(Checked, of="the lidar noise"):
    """Errors of a range measurement.

    Attributes:
        sigma: standard deviation of the range noise, meters.
        sigma_relative: deviation proportional to the range, meters a meter; both add.
        quantization: step of the measured ranges, meters; 0 = continuous.
        dropout: share of invalid beams (NaN, REP 117).
        mixed_pixels: share of the beams at an edge that fall on both sides of it and measure a range between.
        edge_threshold: difference between the ranges of two neighbors that makes an edge, meters.
    """

    sigma: float = limited(0.0, "[0, inf)")
    sigma_relative: float = limited(0.0, "[0, inf)")
    quantization: float = limited(0.0, "[0, inf)")
    dropout: float = limited(0.0, "[0, 1]")
    mixed_pixels: float = limited(0.0, "[0, 1]")
    edge_threshold: float = limited(0.2, "[0, inf)")

    @property
    def parameters(self) -> NoiseParameters:
        """All fields, for the kernel."""
        return NoiseParameters(*map(float, astuple(self)))

    @property
    def draws_uniform(self) -> bool:
        """Whether beams are lost or mixed by chance."""
        return self.dropout > 0 or self.mixed_pixels > 0


DATASHEET: dict[str, LidarNoise] = {
    "lms1xx": LidarNoise(sigma=0.012, quantization=0.001, dropout=0.001, mixed_pixels=0.5),
    "lms111": LidarNoise(sigma=0.012, quantization=0.001, dropout=0.001, mixed_pixels=0.5),
    "lms200": LidarNoise(sigma=0.005, quantization=0.01, dropout=0.001, mixed_pixels=0.5),
    "pls": LidarNoise(sigma=0.05, quantization=0.01, dropout=0.001, mixed_pixels=0.5),
    "utm30lx": LidarNoise(sigma=0.03, quantization=0.001, dropout=0.001, mixed_pixels=0.5),
    "urg04lx": LidarNoise(sigma_relative=0.01, quantization=0.001, dropout=0.002, mixed_pixels=0.5),
    "rplidar_a1": LidarNoise(sigma_relative=0.01, quantization=0.0005, dropout=0.01, mixed_pixels=0.3),
    "lds01": LidarNoise(sigma=0.01, quantization=0.001, dropout=0.01, mixed_pixels=0.3),
    "vlp16": LidarNoise(sigma=0.03, quantization=0.002, dropout=0.001, mixed_pixels=0.5),
    "os1_32": LidarNoise(sigma=0.03, quantization=0.001, dropout=0.001, mixed_pixels=0.5),
}
"""Deviation and quantization are the makers', of `pls` see the presets. No data sheet says how many beams are
lost or mixed: both are assumed, from nearly none for SICK, Velodyne and Ouster to one in a hundred for the
cheap ones; a beam as wide as the gap to the next one lies on an edge whenever there is one, half of them on
enough of both sides to be mixed."""


def lidar_noise(preset: LidarPreset, level: NoiseLevel = "simulated") -> LidarNoise:
    """Return the noise of a preset.

    Args:
        preset: Specification of the device.
        level: `none`; `simulated` = Gaussian with the preset's own deviation, as simulators have it;
            `datasheet` = all that the device is known for. A preset of the user's has no data sheet: there
            it is `simulated`.
    """
    if level not in LEVELS:
        raise unknown_name("lidar noise", level, LEVELS)
    simulated = LidarNoise(sigma=preset.sigma, sigma_relative=preset.sigma_relative)
    if level == "none":
        return LidarNoise()
    return simulated if level == "simulated" else DATASHEET.get(preset.name, simulated)


NO_DRAWS: FloatArray = np.empty((0, 2))


def draw_noise(noise: LidarNoise, beams: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return (n,) normal and (n, 2) uniform random numbers; without dropout and mixed pixels (0, 2)."""
    normal = rng.standard_normal(beams)
    return normal, rng.random((beams, 2)) if noise.draws_uniform else NO_DRAWS


@njit
def measure(
    exact: FloatArray,
    normal: FloatArray,
    uniform: FloatArray,
    limits: tuple[float, float],
    parameters: NoiseParameters,
    ranges: Float32Array,
) -> None:
    """Fill `ranges` (n,), meters: +inf = nothing in range, -inf = too near, NaN = lost (REP 117)."""
    range_min, range_max = limits
    sigma, sigma_relative, quantization, dropout, mixed_pixels, edge_threshold = parameters
    for k in range(len(exact)):
        true = exact[k]
        if len(uniform):
            if uniform[k, 1] < dropout:
                ranges[k] = np.nan
                continue
            if k + 1 < len(exact) and uniform[k, 0] < mixed_pixels:
                jump = exact[k + 1] - true
                if edge_threshold < abs(jump) < np.inf:
                    true += jump * uniform[k, 0] / mixed_pixels
        if true > range_max or true == np.inf:
            ranges[k] = np.inf
            continue
        measured = true + (sigma + sigma_relative * true) * normal[k]
        if quantization > 0:
            measured = quantization * round(measured / quantization)
        if true < range_min or measured < range_min:
            ranges[k] = -np.inf
        else:
            ranges[k] = measured if measured <= range_max else np.inf
