"""Picture of a decision: paths of the drives in the world by verdict, and where they failed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from lirs_validation.decision.decide import Answer, method_name
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.metrics.alignment import associated
from lirs_validation.metrics.verdict import VerdictClass
from lirs_validation.record.formatting import Entry
from lirs_validation.record.run_record import read_record
from lirs_wct import SourceError, Trajectory
from lirs_wct.arrays import FloatArray
from lirs_wct.drawing.canvas import Canvas, shaded_heights
from lirs_wct.drawing.style import BLACK, Drawing, legend, map_axes, new_figure, title
from lirs_wct.formats.tum import read_tum

COLORS: dict[VerdictClass, str] = {
    "works": "#0072b2",
    "path only": "#56b4e9",
    "adds nothing": "#e69f00",
    "loses its way": "#d55e00",
    "failed": "#000000",
    "not evaluated": "#8a8f98",
}
"""Color of a drive's path by the class of its verdict (Okabe and Ito)."""
PANEL = 4.6
"""Width of a panel, inches."""
COLUMNS = 3


def decision_figure(answers: Sequence[Answer], out: Path) -> Drawing:
    """Draw the drives of each method on the world's map.

    Args:
        answers: of the decision.
        out: folder of the drives' folders.
    """
    columns = min(COLUMNS, len(answers))
    rows = -(-len(answers) // columns)
    scenarios = ScenarioCache()
    figure = new_figure(PANEL * columns + 0.4, (PANEL + 0.5) * rows)
    for k, answer in enumerate(answers, start=1):
        world = scenarios.scenario(answer.trial.config).world
        axes = figure.add_subplot(rows, columns, k)
        canvas = Canvas.over(world.surface.bounds)
        map_axes(axes, canvas, shaded_heights(world, canvas))
        _draw_drives(axes, answer, out)
        name = method_name(answer.trial.config)
        title(axes, f"{name}: {answer.trial.decision}", above_legend=True)
    return figure


def _draw_drives(axes: Axes, answer: Answer, out: Path) -> None:
    """Draw the path of each drive, and a cross where it failed."""
    drawn: list[VerdictClass] = []
    failures = False
    for drive in answer.trial.drives:
        folder = out / drive.folder
        try:
            truth, estimate = (read_tum(folder / f"{name}.tum") for name in ("truth", "estimate"))
        except SourceError:
            continue  # a failed run has no trajectories
        axes.plot(*truth.xy.T, color="white", linewidth=2.6, alpha=0.6, zorder=3)
        axes.plot(*truth.xy.T, color=COLORS[drive.kind], linewidth=1.5, zorder=4)
        drawn.append(drive.kind)
        place = failure_place(read_record(folder), truth, estimate)
        if place is not None:
            failures = True
            axes.plot(*place, "X", color=COLORS[drive.kind], markeredgecolor="white", markersize=9, zorder=6)
    kinds = [kind for kind in COLORS if kind in drawn]
    handles = [Line2D([], [], color=COLORS[kind], label=f"{kind} ({drawn.count(kind)})") for kind in kinds]
    if failures:
        handles.append(Line2D([], [], color=BLACK, marker="X", linestyle="", label="failure"))
    legend(axes, handles)


def failure_place(entry: Entry, truth: Trajectory, estimate: Trajectory) -> FloatArray | None:
    """Return x and y where a drive failed; None of a drive whose verdict is on its whole path or map.

    That is where it ended early, or where the error from the start on first exceeds the verdict's limit.
    """
    if entry["status"] not in ("ok", "wall limit"):
        return np.asarray(truth.xy[-1])
    limits = [r["limit"] for r in entry["verdict"]["reasons"] if r["figure"] == "trajectory error"]
    if entry["verdict"]["class"] != "loses its way" or not limits:
        return None
    i, j = associated(truth.stamps, estimate.stamps)
    places: FloatArray = truth.xy[i]
    over = np.flatnonzero(np.hypot(*(estimate.xy[j] - places).T) > limits[0])
    return None if len(over) == 0 else np.asarray(places[over[0]])
