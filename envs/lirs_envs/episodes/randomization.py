"""Randomization of episodes: values drawn at their start, and disturbances during them."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np

from lirs_envs.batch.simulation import BatchSimulation
from lirs_wct.arrays import IntArray

Factors = dict[str, tuple[float, float] | None]
INTERVAL = 5.0
"""Mean time between two pushes, and between two changes of the slip, seconds."""
PUSH, SLIP = "pushes", "slip"


class Randomization:
    """Domain randomization: draw friction, mass, lidar noise and latency of each episode.

    During an episode, robots are pushed and the slip of their wheels changes, at random times.
    """

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
        self._during = {name: factors[name] or (0.0, 0.0) for name in (PUSH, SLIP) if name in factors}
        self._rngs = [np.random.default_rng(0) for _ in range(simulation.count)]

    @staticmethod
    def needs_own_models(factors: Factors) -> bool:
        """Return whether each robot needs its own MuJoCo model."""
        return bool(factors.keys() & {"friction", "mass"})

    def draw(self, i: int, rng: np.random.Generator) -> None:
        """Draw the factors of robot `i` for its next episode."""
        drawn = {
            name: rng.uniform(*factors)
            for name, factors in self._factors.items()
            if factors is not None and name not in self._during
        }
        if self._during:
            self._rngs[i] = np.random.default_rng(int(rng.integers(2**63)))
        group, k = self._simulation.places[i]
        if "latency" in drawn:
            group.set_latency(k, drawn["latency"])
        if "sensor" in drawn:
            factor, noise = drawn["sensor"], self._noise
            self._simulation.lidar_noise[i] = replace(
                noise, sigma=factor * noise.sigma, sigma_relative=factor * noise.sigma_relative
            )
        if not self.needs_own_models(self._factors):
            return
        model, nominal = group.bodies.models[k], self._nominal
        model.geom_friction[self._geoms] = drawn.get("friction", 1.0) * nominal["geom_friction"]
        mass = drawn.get("mass", 1.0)
        model.body_mass[self._bodies] = mass * nominal["body_mass"]
        model.body_inertia[self._bodies] = mass * nominal["body_inertia"]
        mujoco.mj_setConst(model, mujoco.MjData(model))
        group.bodies.models_changed()

    def begin(self, i: int) -> None:
        """Draw the first slip of robot `i`, which stands at its start."""
        if SLIP in self._during:
            self._set_slip(i)

    def disturb(self, ids: IntArray) -> None:
        """Push some robots before a step, and change the slip of some."""
        chance = self._simulation.period / INTERVAL
        for i in ids.tolist() if self._during else ():
            rng = self._rngs[i]
            if PUSH in self._during and rng.random() < chance:
                speed, angle = rng.uniform(*self._during[PUSH]), rng.uniform(-math.pi, math.pi)
                # An impulse through the center of mass.
                self._simulation.bodies[i].qvel[:2] += np.array((math.cos(angle), math.sin(angle))) * speed
            if SLIP in self._during and rng.random() < chance:
                self._set_slip(i)

    def _set_slip(self, i: int) -> None:
        """Draw the slip of robot `i`."""
        group, k = self._simulation.places[i]
        group.set_slip(k, self._rngs[i].uniform(*self._during[SLIP]))
