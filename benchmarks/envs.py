"""Time of an environment step: what it costs beyond physics and rays, on two threads, and beside its peers.

    python benchmarks/envs.py [--quick]

16 Huskys map `medium`, 25 steps a second, each with a scan, by random actions that are held for ten steps.
Times are of the processor, all threads of this process together, but where it says wall; medians over rounds
of all that is compared. The floor is what MuJoCo and the rays need: the recorded controls through
`mujoco.batch` alone, and the rays of every scan from the recorded poses, both in the same batches.
"""

from __future__ import annotations

import copy
import os
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from mujoco.batch import Batch

import lirs_envs  # noqa: F401  registers
from benchmarks.steps import arguments, print_limits, print_rows
from lirs_envs.tasks.seen_ground import SeenGround
from lirs_envs.tasks.site import seen_frame
from lirs_envs.vector_env import RobotVectorEnv
from lirs_wct.arrays import Int32Array
from lirs_wct.geometry.pose import Pose3

N, HELD = 16, 10
ALL = np.arange(N)
TASK: dict[str, Any] = {"world": "medium", "robot": "husky", "control_hz": 25, "time_limit": 1e6}
LIMITS = {
    "cpu_over_physics_and_rays": ("processor time of a step / (physics + rays)", "<=", 1.25),
    "thread_speedup": ("wall time of one thread / of two", ">=", 1.7),
    "marking_over_rays": ("marking the seen ground / rays", "<=", 0.6),
    "sync_over_vector": ("SyncVectorEnv / vector, processor time", ">=", 1.0),
    "async_over_vector": ("AsyncVectorEnv / vector on as many threads, wall time", ">=", 1.0),
}
"""What is asked: in words, at most or at least, and how much."""
Step = Callable[[int], Any]


def medians(
    steps_of: dict[str, tuple[Step, Callable[[], float]]], rounds: int, steps: int
) -> dict[str, float]:
    """Return microseconds of a step: medians over interleaved rounds but the first, which compiles."""
    times: dict[str, list[float]] = {name: [] for name in steps_of}
    for turn in range(rounds + 1):
        for name, (step, clock) in steps_of.items():
            begin = clock()
            for k in range(steps):
                step(k)
            if turn:
                times[name].append((clock() - begin) / steps / N * 1e6)
    return {name: float(np.median(values)) for name, values in times.items()}


def vector(threads: int) -> RobotVectorEnv:
    """Return the vector environment, begun."""
    env = RobotVectorEnv(N, "mapping", threads=threads, **TASK)
    env.reset(seed=0)
    return env


class Recording:
    """States, controls and poses of a stretch of steps, to be replayed."""

    def __init__(self, steps: int, actions: np.ndarray) -> None:
        env = vector(1)
        self.simulation = env.episodes.parts[0].simulation
        bodies: Any = self.simulation.groups[0].bodies
        self.substeps = bodies.body.substeps
        self.state = bodies._batch.state.copy()
        self.batch = Batch(bodies.body.model, N, 1)
        self.batch.bind("sensordata")
        self.controls: list[np.ndarray] = []
        self.poses: list[np.ndarray] = []
        self.ranges: list[np.ndarray] = []
        step = bodies.step

        def recorded(ids: Int32Array | None, steps: int) -> Any:
            self.controls.append(bodies.ctrl.copy())
            return step(ids, steps)

        bodies.step = recorded
        for k in range(steps):
            env.step(actions[k])
            self.poses.append(self.simulation.T_world_base.copy())
            self.ranges.append(self.simulation.ranges.copy())
        robot, preset = self.simulation.config.robot, self.simulation.config.preset
        mount, frame = robot.T_base_laser, seen_frame(self.simulation.worlds[0])
        self.range_max, beams = preset.range_max, preset.directions @ mount.rotation.T
        self.begun = SeenGround(N, frame.height.shape, beams, mount.position, 1.0)
        for i in range(N):
            self.begun.begin(i, frame, np.isfinite(frame.height))
        self.begun.add(ALL, self.ranges[0], self.range_max, self.poses[0])
        poses = [[Pose3(*row) for row in rows.tolist()] for rows in self.poses]
        self.rays = [
            [((T @ mount).position, np.ascontiguousarray(beams @ T.rotation.T)) for T in row] for row in poses
        ]

    def physics(self, k: int) -> None:
        """Replay the controls of a step."""
        if k == 0:
            self.batch.state[:] = self.state
        for u, steps in enumerate(self.substeps):
            self.batch.ctrl[:] = self.controls[k * len(self.substeps) + u]
            self.batch.step(nstep=steps)

    def physics_beside(self, k: int, other: Recording) -> None:
        """Replay the controls of a step in two threads, of the other recording in the second."""
        beside = threading.Thread(target=other.physics, args=(k,))
        beside.start()
        self.physics(k)
        beside.join()

    def cast(self, k: int) -> None:
        """Cast the rays of a step."""
        for caster, (origin, directions) in zip(self.simulation.casters, self.rays[k], strict=True):
            caster.ranges(origin, directions, self.range_max)

    def mark(self, k: int) -> None:
        """Mark the ground that the scans of a step saw, where the reset's scan has marked its own."""
        if k == 0:
            self.seen = copy.deepcopy(self.begun)
        self.seen.add(ALL, self.ranges[k], self.range_max, self.poses[k])


def main() -> None:
    """Measure, and print the limits that are kept."""
    given = arguments(__doc__, quick=False)
    warnings.simplefilter("ignore")
    times = measure(*((3, 20) if given.quick else (9, 100)))
    print_rows([{f"{name}_us": value for name, value in times.items()}])
    figures = {
        "cpu_over_physics_and_rays": times["vector"] / (times["physics"] + times["rays"]),
        "thread_speedup": times["wall_1"] / times["wall_2"],
        "physics_thread_speedup": 2 * times["wall_physics_1"] / times["wall_physics_2"],  # two copies
        "marking_over_rays": times["marking"] / times["rays"],
        "sync_over_vector": times["sync"] / times["vector"],
        "async_over_vector": times["wall_async"] / times["wall_all"],
    }
    print_rows([figures])
    print_limits(figures, LIMITS)


def measure(rounds: int, steps: int) -> dict[str, float]:
    """Return the microseconds of everything that is compared."""
    drawn = np.random.default_rng(0).uniform(-1, 1, (-(-steps // HELD), N, 2)).astype(np.float32)
    actions = np.repeat(drawn, HELD, axis=0)[:steps]
    recording, other = Recording(steps, actions), Recording(steps, actions)
    one, two, several = vector(1), vector(2), vector(len(os.sched_getaffinity(0)))
    sync = SyncVectorEnv([lambda: gym.make("LIRS/Mapping-v2", **TASK) for _ in range(N)])
    sync.reset(seed=0)
    cpu, wall = time.process_time, time.perf_counter
    times = medians(
        {
            "vector": (lambda k: one.step(actions[k]), cpu),
            "physics": (recording.physics, cpu),
            "rays": (recording.cast, cpu),
            "marking": (recording.mark, cpu),
            "sync": (lambda k: sync.step(actions[k]), cpu),
            "wall_1": (lambda k: one.step(actions[k]), wall),
            "wall_2": (lambda k: two.step(actions[k]), wall),
            "wall_physics_1": (recording.physics, wall),
            "wall_physics_2": (lambda k: recording.physics_beside(k, other), wall),
        },
        rounds,
        steps,
    )
    peers = AsyncVectorEnv([lambda: gym.make("LIRS/Mapping-v2", **TASK) for _ in range(N)])
    peers.reset(seed=0)
    times |= medians(
        {
            "wall_async": (lambda k: peers.step(actions[k]), wall),
            "wall_all": (lambda k: several.step(actions[k]), wall),
        },
        rounds,
        steps,
    )
    peers.close()
    return times


if __name__ == "__main__":
    main()
