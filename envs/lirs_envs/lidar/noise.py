"""What a laser range finder makes of the true ranges."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numba import njit

from lirs_envs.lidar.presets import LidarPreset
from lirs_wct.arrays import Float32Array, FloatArray
from lirs_wct.errors import ConfigError, unknown_name

NoiseLevel = Literal["none", "simulated", "datasheet"]
LEVELS = ("none", "simulated", "datasheet")


@dataclass(frozen=True, kw_only=True)
class LidarNoise:
    """Errors of a range measurement.

    Attributes:
        sigma: standard deviation of the range noise, metres.
        sigma_relative: the part of it that grows with the range, metres a metre; both add.
        step: ranges are multiples of it, metres; 0 = continuous.
        dropout: share of the beams that give nothing: NaN, as REP 117 has it for an invalid one.
        mixed: share of the beams at an edge that fall on both sides of it and measure something between.
        edge: difference between the ranges of two neighbours from which on there is an edge, metres.

    Raises:
        ConfigError: a figure is not legal.
    """

    sigma: float = 0.0
    sigma_relative: float = 0.0
    step: float = 0.0
    dropout: float = 0.0
    mixed: float = 0.0
    edge: float = 0.2

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            top = 1.0 if item.name in ("dropout", "mixed") else math.inf
            if not 0 <= value <= top or math.isinf(value):
                raise ConfigError(
                    f"lidar noise: {item.name} must be a finite number from 0 to {top:g}, got {value}"
                )

    @property
    def figures(self) -> tuple[float, float, float, float, float, float]:
        """All of it, in the kernel's order."""
        return self.sigma, self.sigma_relative, self.step, self.dropout, self.mixed, self.edge

    @property
    def draws_uniform(self) -> bool:
        """Whether beams are lost or mixed by chance."""
        return self.dropout > 0 or self.mixed > 0


DATASHEET: dict[str, LidarNoise] = {
    "lms1xx": LidarNoise(sigma=0.012, step=0.001, dropout=0.001, mixed=0.5),
    "lms111": LidarNoise(sigma=0.012, step=0.001, dropout=0.001, mixed=0.5),
    "utm30lx": LidarNoise(sigma=0.03, step=0.001, dropout=0.001, mixed=0.5),
    "urg04lx": LidarNoise(sigma_relative=0.01, step=0.001, dropout=0.002, mixed=0.5),
    "rplidar_a1": LidarNoise(sigma_relative=0.01, step=0.0005, dropout=0.01, mixed=0.3),
    "lds01": LidarNoise(sigma=0.01, step=0.001, dropout=0.01, mixed=0.3),
}
"""Deviation and step are the makers'. No data sheet tells how many beams are lost or mixed: those two are
assumed, from nearly none for the SICK to one in a hundred for the cheap ones; a beam as wide as the gap to
the next one lies on an edge whenever there is one, half of them on enough of both sides to be mixed."""


def lidar_noise(preset: LidarPreset, level: NoiseLevel = "simulated") -> LidarNoise:
    """Return the noise of a preset.

    Args:
        preset: the device.
        level: `none`; `simulated` = Gaussian with the preset's own deviation, as simulators have it;
            `datasheet` = all that the device is known for. A preset of the user's has no data sheet: there
            it is `simulated`.

    Raises:
        ConfigError: no level has this name; the message lists them.
    """
    if level not in LEVELS:
        raise unknown_name("lidar noise", level, LEVELS)
    simulated = LidarNoise(sigma=preset.sigma, sigma_relative=preset.sigma_relative)
    if level == "none":
        return LidarNoise()
    return simulated if level == "simulated" else DATASHEET.get(preset.name, simulated)


NO_DRAWS: FloatArray = np.empty((0, 2))


def draws(noise: LidarNoise, beams: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return (n,) normal and (n, 2) uniform numbers for one scan; without need of the latter, (0, 2)."""
    normal = rng.standard_normal(beams)
    return normal, rng.random((beams, 2)) if noise.draws_uniform else NO_DRAWS


@njit(cache=True)
def measure(
    exact: FloatArray,
    normal: FloatArray,
    uniform: FloatArray,
    limits: tuple[float, float],
    figures: tuple[float, float, float, float, float, float],
    ranges: Float32Array,
) -> None:
    """Fill `ranges` (n,): +inf = nothing in range, -inf = too near, NaN = lost (REP 117), else metres."""
    range_min, range_max = limits
    sigma, sigma_relative, step, dropout, mixed, edge = figures
    for k in range(len(exact)):
        true = exact[k]
        if len(uniform):
            if uniform[k, 1] < dropout:
                ranges[k] = np.nan
                continue
            if k + 1 < len(exact) and uniform[k, 0] < mixed:
                jump = exact[k + 1] - true
                if edge < abs(jump) < np.inf:
                    true += jump * uniform[k, 0] / mixed
        if true > range_max:
            ranges[k] = np.inf
            continue
        measured = true + (sigma + sigma_relative * true) * normal[k]
        if step > 0:
            measured = step * round(measured / step)
        if true < range_min or measured < range_min:
            ranges[k] = -np.inf
        else:
            ranges[k] = measured if measured <= range_max else np.inf
