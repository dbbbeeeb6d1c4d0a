"""Files and moves between files that a reader follows through a run, a tick, an `env.step` and a build.

    python benchmarks/walk.py

A product file counts if a function in it is called; a move is a call in another file than the call before.
The tick is the one with the median of moves.
"""

from __future__ import annotations

import inspect
import sys
import tempfile
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table

import lirs_envs  # noqa: F401  registers
from lirs_envs.simulation import Simulation
from lirs_validation.cli.command import PROGRAM

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("lirs_wct", "envs", "slam_baselines", "lirs_validation", "lirs_extensions")
FOLDERS = tuple(f"{ROOT / name}/" for name in PACKAGES)


def calls_of(function: Callable[..., object], *arguments: Any) -> list[CodeType]:
    """Return the product functions that a call enters, in order; bodies of modules and classes are none."""
    calls: list[CodeType] = []

    def note(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_flags & inspect.CO_OPTIMIZED and code.co_filename.startswith(FOLDERS):
            calls.append(code)

    sys.setprofile(note)
    try:
        function(*arguments)
    finally:
        sys.setprofile(None)
    return calls


def moves(calls: list[CodeType]) -> int:
    """Return the number of changes of file."""
    return sum(a.co_filename != b.co_filename for a, b in pairwise(calls))


def command(*words: str) -> list[CodeType]:
    """Return the calls of a command."""
    return calls_of(lambda: PROGRAM.main(words, "lirs-wct", standalone_mode=False))


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        picture = f"{folder}/picture.png"
        cv2.imwrite(picture, np.random.default_rng(1).integers(0, 256, (64, 64), np.uint8))
        drive = command("validate", "medium", "--mapper", "hector", "--seconds", "12", "-o", folder)
        build = command("build", picture, "-o", folder)
    ticks = [k for k, code in enumerate(drive) if code is Simulation.advance.__code__]
    every_tick = sorted((drive[a:b] for a, b in pairwise(ticks)), key=moves)
    env = gym.make("LIRS/Mapping-v2")
    env.reset(seed=0)
    step = calls_of(env.step, env.action_space.sample())
    rows = {
        "validate medium --mapper hector": drive,
        "a tick of it": every_tick[len(every_tick) // 2],
        "env.step": step,
        "build picture.png": build,
    }
    table = Table("", "files", "moves")
    for name, calls in rows.items():
        files = {code.co_filename for code in calls}
        table.add_row(name, str(len(files)), str(moves(calls)))
    Console().print(table)


if __name__ == "__main__":
    main()
