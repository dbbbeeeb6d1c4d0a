"""Tables, page and JSON of a decision."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from lirs_extensions.decide.decide import Answer, Trial
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.metrics.trajectory import associated
from lirs_validation.record.metric_catalog import NOTHING, Entry
from lirs_validation.record.run_record import read_record
from lirs_validation.record.verdict import VerdictClass
from lirs_validation.report.page import PageFigure, PageSection, data_url, page_html, png
from lirs_validation.report.table import ReportTable
from lirs_wct import FloatArray, SourceError, Trajectory
from lirs_wct.drawing.canvas import (
    BLACK,
    Canvas,
    Drawing,
    legend,
    map_axes,
    new_figure,
    shaded_heights,
    title,
)
from lirs_wct.files import atomic_write, write_json
from lirs_wct.formats.drive_files import read_tum

CAPTION = (
    "Share of the evaluated drives that worked, with its exact 95 % interval (Clopper and Pearson). A "
    "sequential test decides: it accepts a share of 90 % and rejects one of 65 %, with at most 5 % errors "
    "each (Wald). The forecast is the share that a model expected before the drives."
)
HEADINGS = ("decision", "worked", "share", "95 % interval", "not evaluated", "verdicts")
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


def methods_table(answers: Sequence[Answer]) -> ReportTable:
    """Return the decision on each method."""
    rows = tuple((a.world, a.trial.name, _percent(a.trial.forecast), *_cells(a.trial)) for a in answers)
    headings = ("world", "method", "forecast", *HEADINGS)
    return ReportTable("methods", "Decision", CAPTION, headings, rows, 4, remarks=True)


def changes_table(answers: Sequence[Answer]) -> ReportTable:
    """Return the decision on each changed run."""
    rows = tuple(
        (answer.world, answer.trial.name, label, *_cells(trial))
        for answer in answers
        for label, trial in answer.changed
    )
    headings = ("world", "method", "change", *HEADINGS)
    return ReportTable("changes", "What changes the decision", "", headings, rows, 4, remarks=True)


def drives_table(answers: Sequence[Answer]) -> ReportTable:
    """Return every drive with its verdict."""
    trials = [t for a in answers for t in (a.trial, *(trial for _, trial in a.changed))]
    rows = tuple((drive.folder, drive.kind, drive.sentence) for trial in trials for drive in trial.drives)
    return ReportTable("drives", "Drives", "", ("folder", "verdict", "sentence"), rows, 3)


def _cells(trial: Trial) -> tuple[str, ...]:
    test = trial.test
    low, high = test.interval
    kinds = Counter(drive.kind for drive in trial.drives)
    return (
        trial.decision,
        f"{test.successes} of {test.total}",
        _percent(test.share),
        f"{100 * low:.0f} to {100 * high:.0f} %" if test.total else NOTHING,
        str(trial.unevaluated),
        ", ".join(f"{kind} {count}" for kind, count in kinds.most_common()),
    )


def _percent(share: float | None) -> str:
    return NOTHING if share is None else f"{100 * share:.0f} %"


def write_decision(out: Path, answers: Sequence[Answer], command: str) -> Path:
    """Write `verdict.html`, `verdict.png` and `verdict.json`; return the page's path."""
    picture = png(decision_figure(answers, out))
    write_json(out / "verdict.json", {"command": command, "answers": [a.to_dict() for a in answers]})
    with atomic_write(out / "verdict.png") as path:
        path.write_bytes(picture)
    drawn = PageFigure(data_url(picture), "Paths of the drives by verdict, and where they failed")
    changes = changes_table(answers)
    sections = (
        PageSection("methods", "Decision", tables=(methods_table(answers),)),
        PageSection("map", "Where it worked and failed", figures=(drawn,)),
        *([PageSection("changes", changes.title, tables=(changes,))] if changes.rows else []),
        PageSection("drives", "Drives", tables=(drives_table(answers),)),
        PageSection("command", "Command", commands=(command,)),
    )
    html = page_html(
        "Verdict: " + ", ".join(dict.fromkeys(answer.world for answer in answers)),
        [answer.sentence for answer in answers],
        sections,
    )
    page = out / "verdict.html"
    with atomic_write(page) as path:
        path.write_text(html, encoding="utf-8")
    return page


def decision_figure(answers: Sequence[Answer], out: Path) -> Drawing:
    """Draw the drives of each method on the world's map."""
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
        title(axes, f"{answer.trial.name}: {answer.trial.decision}", above_legend=True)
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
    """Return x and y where a drive failed; None if its verdict names no place.

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
