"""Draw the learning curve of examples/train_pretrained.py: SPL of the episodes that the network drove.

python docs/pictures/make_learning_curve.py out/pretrained  # writes out/learning_curve.png
python docs/pictures/make_learning_curve.py docs/pictures -o docs/learning_curve.png  # the tracked one
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from lirs_wct.drawing.canvas import BLUE, VERMILLION, new_figure, plain_axes, title

ROBOTS = (("jackal", BLUE, 5), ("turtlebot2", VERMILLION, -5), ("turtlebot3_waffle", "0.55", 0))
"""Robots that drive floor plans in each third round, their colors, and offsets of their names."""


def main() -> None:
    """Draw a line for each robot on floor plans."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder with the example's curve.csv")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/learning_curve.png"))
    given = parser.parse_args()
    figure = new_figure(4.6, 2.4)
    axes = figure.subplots()
    rounds = np.genfromtxt(
        given.folder / "curve.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    for robot, color, up in ROBOTS:
        own = rounds[(rounds["robot"] == robot) & (rounds["physics"] == 0) & (rounds["episodes"] > 0)]
        axes.plot(own["choices"] / 1000, own["spl"], color=color, linewidth=0.9)
        axes.annotate(robot, (own["choices"][-1] / 1000, own["spl"][-1]), (4, up), textcoords="offset points",
                      color=color, fontsize=8, va="center", annotation_clip=False)  # fmt: skip
    plain_axes(axes, "thousand choices in the data", "SPL of a round")
    axes.set_ylim(0, 1)
    title(axes, "Imitation of the shortest route")
    given.output.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(given.output, dpi=110)


if __name__ == "__main__":
    main()
