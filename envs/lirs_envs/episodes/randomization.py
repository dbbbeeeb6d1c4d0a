"""Domain randomization: friction, mass and lidar noise drawn for each episode."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from lirs_envs.batch.simulation import BatchSimulation

Factors = dict[str, tuple[float, float] | None]


class Randomization:
    """Draws what a config randomizes into the models and lidars of a batch."""

    def __init__(self, simulation: BatchSimulation, factors: Factors) -> None:
        self._simulation, self._factors = simulation, factors
        model = simulation.body.model
        base = model.body("base_link").id
        self._bodies = np.flatnonzero(model.body_rootid == base)
        self._geoms = np.flatnonzero(np.isin(model.geom_bodyid, self._bodies))
        self._nominal = {
            "geom_friction": model.geom_friction[self._geoms].copy(),
            "body_mass": model.body_mass[self._bodies].copy(),
            "body_inertia": model.body_inertia[self._bodies].copy(),
        }
        self._noise = simulation.lidar_noise[0]

    @staticmethod
    def needs_own_models(factors: Factors) -> bool:
        """Whether each robot needs a MuJoCo model of its own."""
        return bool(factors.keys() & {"friction", "mass"})

    def draw(self, i: int, rng: np.random.Generator) -> None:
        """Draw the factors of robot `i` for its next episode."""
        drawn = {
            name: rng.uniform(*factors) for name, factors in self._factors.items() if factors is not None
        }
        if "sensor" in drawn:
            k, noise = drawn["sensor"], self._noise
            self._simulation.lidar_noise[i] = replace(
                noise, sigma=k * noise.sigma, sigma_relative=k * noise.sigma_relative
            )
        if not self.needs_own_models(self._factors):
            return
        model, nominal = self._simulation.model(i), self._nominal
        model.geom_friction[self._geoms] = drawn.get("friction", 1.0) * nominal["geom_friction"]
        mass = drawn.get("mass", 1.0)
        model.body_mass[self._bodies] = mass * nominal["body_mass"]
        model.body_inertia[self._bodies] = mass * nominal["body_inertia"]
        mujoco.mj_setConst(model, mujoco.MjData(model))
        self._simulation.model_changed(i)
