"""Draw the learning curves of examples/train_navigation.py: share of episodes that reach the goal.

python docs/pictures/make_learning_curve.py out/navigation  # writes out/learning_curve.png
python docs/pictures/make_learning_curve.py out/seed-* -o docs/learning_curve.png  # the tracked one
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from lirs_wct.drawing.style import BLUE, VERMILLION, new_figure, plain_axes, title

WINDOW = 100
"""Episodes over which shares are taken."""


def main() -> None:
    """Draw success and collisions of each training."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path, help="what the example wrote, a folder a seed")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/learning_curve.png"))
    given = parser.parse_args()
    figure = new_figure(4.6, 2.4)
    axes = figure.subplots()
    for folder in given.folders:
        episodes = np.genfromtxt(
            folder / "curve.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
        )
        steps = np.convolve(episodes["steps"], np.full(WINDOW, 1 / WINDOW), "valid") / 1000
        for name, color in (("success", BLUE), ("collision", VERMILLION)):
            share = np.convolve(episodes[name], np.full(WINDOW, 1 / WINDOW), "valid")
            axes.plot(steps, share, color=color, linewidth=0.9)
            if folder == given.folders[0]:
                axes.annotate(name, (steps[-1], share[-1]), (4, 0), textcoords="offset points", color=color,
                              fontsize=8, va="center", annotation_clip=False)  # fmt: skip
    plain_axes(axes, "thousand environment steps", f"share of the last {WINDOW} episodes")
    axes.set_ylim(0, 1)
    title(axes, "PPO on LIRS/Navigation-v1")
    given.output.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(given.output, dpi=110)


if __name__ == "__main__":
    main()
