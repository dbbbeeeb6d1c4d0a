"""Render mode human: a window on a screen, or one sentence."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

WINDOW = """
import os
import sys

import gymnasium as gym
import numpy as np
from PIL import ImageGrab

import lirs_envs
from lirs_envs.generators.terrain import generate

def colors():
    picture = ImageGrab.grab(xdisplay=os.environ["DISPLAY"])
    return len(picture.getcolors(1 << 24))

world = generate("waves", 0.3, np.random.default_rng(0)).world()
assert colors() == 1, "the screen is empty"
env = gym.make("LIRS/Mapping-v2", world=world, render_mode="human")
env.reset(seed=1)
for _ in range(3):
    env.step(np.array((1.0, 0.3), np.float32))
assert env.render() is None
window = env.unwrapped._views._viewer._window
assert window.is_running()
for _ in range(100):
    if colors() > 100:
        break
    env.step(np.zeros(2, np.float32))
assert colors() > 100, "the window shows a world"
if "close" in sys.argv:
    env.close()
    assert not window.is_running()
"""
"""A program that shows an episode; it leaves the window open at its end unless it is told to close it."""


def environment(**changed: str) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if name != "WAYLAND_DISPLAY"}
    return kept | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)} | changed


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize("end", ["close", "leave"])
def test_a_window_shows_each_step_and_ends_with_the_program(end: str, tmp_path: Path) -> None:
    xvfb = shutil.which("xvfb-run")
    if xvfb is None:
        pytest.skip("there is no virtual screen (xvfb-run)")
    program = tmp_path / "window.py"
    program.write_text(WINDOW, encoding="utf-8")
    screen = [xvfb, "--auto-servernum", "--server-args", "-screen 0 1024x768x24"]
    done = subprocess.run(
        [*screen, sys.executable, str(program), end],
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
def test_a_screen_that_opens_no_window_is_refused_in_one_sentence() -> None:
    program = "from lirs_envs.rendering import check_screen; check_screen()"
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment(DISPLAY=":4093"),
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    lines = done.stderr.strip().splitlines()
    assert (
        "SimulationError: render mode human needs a screen with OpenGL, ':4093' opens no window" in lines[-1]
    )
