"""Forecast: calibrated probability that a drive of a method works, before any drive."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from lirs_envs.robots.robot import Robot
from lirs_validation.config import RunConfig
from lirs_validation.decision.site_features import FEATURES, site_features
from lirs_wct import World
from lirs_wct.arrays import FloatArray

MODELS = "forecast.json"
"""File of the models in this package; `python benchmarks/verdict_study.py fit` writes it."""
STUDIED = ("attitude", "driver", "odometry_noise", "actors", "scan_time")
"""Options that must have their defaults for a forecast."""
LARGEST = 3.0
"""Largest standardized feature, either side: beyond the studied worlds, a forecast gets no bolder."""


@dataclass(frozen=True)
class LogisticModel:
    """Logistic regression of the share of drives that work on standardized features.

    Attributes:
        mean: (k,) of the features.
        scale: (k,) standard deviations; 1 where a feature is constant.
        weights: (k + 1,) of the standardized features, the last of the constant.
    """

    mean: FloatArray
    scale: FloatArray
    weights: FloatArray

    def standardize(self, features: FloatArray) -> FloatArray:
        """Return features (n, k) in standard deviations from the mean, at most LARGEST."""
        return np.clip((features - self.mean) / self.scale, -LARGEST, LARGEST)

    def probability(self, features: FloatArray) -> FloatArray:
        """Return (n,) probabilities of success of features (n, k)."""
        logit: FloatArray = self.standardize(features) @ self.weights[:-1] + self.weights[-1]
        return 1 / (1 + np.exp(-logit))

    def to_dict(self) -> dict[str, Any]:
        """Return the model as JSON stores it."""
        return {name: [float(f"{v:.4g}") for v in values] for name, values in vars(self).items()}


@cache
def _models() -> dict[str, LogisticModel]:
    """Return the stored models by method."""
    stored = json.loads(files(__package__).joinpath(MODELS).read_text(encoding="utf-8"))
    if tuple(stored["features"]) != FEATURES:
        raise ValueError(f"{MODELS} was fitted to other features: fit it again")
    return {
        method: LogisticModel(**{name: np.array(values) for name, values in model.items()})
        for method, model in stored["methods"].items()
    }


def forecast(world: World, robot: Robot, config: RunConfig) -> float | None:
    """Return the probability that a drive gets the verdict `works`; None for what was not studied.

    The study drove tours of 60 s with the default sensors; docs/measured.md has its calibration.

    Raises:
        ConfigError: the robot fits nowhere in this world.
    """
    default = RunConfig(source=config.source)
    studied = all(getattr(config, name) == getattr(default, name) for name in STUDIED)
    if config.mapper not in _models() or not studied:
        return None
    features = site_features(world, robot, config).vector
    return float(_models()[config.mapper].probability(features[None])[0])
