"""Sentences, tables, page and JSON of a decision."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from lirs_extensions.decide.decide import CONFIDENCE, Answer, Change, SequentialTest, Trial
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.metrics.trajectory import ErrorSpread, associated
from lirs_validation.record.metric_catalog import NOTHING, Entry
from lirs_validation.record.run_record import read_record
from lirs_validation.record.verdict import VerdictClass
from lirs_validation.report.page import PageFigure, PageSection, data_url, page_html, png
from lirs_validation.report.run_tables import command_of, spread_sentence
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

PROMISED_SHARE = 0.8
"""Share of drives that a sentence promises if the whole interval lies above it."""
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


def conclusion(answer: Answer) -> str:
    """Return the conclusion for the user, with share and interval."""
    trial, decision = answer.trial, answer.trial.decision
    if decision == "cannot be driven":
        return " ".join(filter(None, (_impassable_text(answer), _next_text(answer))))
    lead = "is undecided on" if decision == "undecided" else f"{decision} on"
    parts = [f"{trial.name} {lead} {answer.world}: {trial.obstacle or _share_text(trial.test)}."]
    if decision == "works" and trial.test.interval[0] >= PROMISED_SHARE:
        parts.append(f"It works in at least {100 * PROMISED_SHARE:.0f} % of the drives.")
    if decision == "undecided" and trial.forecast is not None:
        parts.append(f"The forecast is that it works in {100 * trial.forecast:.0f} % of the drives.")
    extents = dict.fromkeys(drive.extent for drive in trial.drives)
    spread = spread_sentence((drive.kind, drive.error, drive.distance) for drive in trial.drives)
    parts += [spread, _failures_text(trial), *extents, _next_text(answer)]
    return " ".join(filter(None, parts))


def _impassable_text(answer: Answer) -> str:
    """Return why most drives were not evaluated: they ended early, or were too short."""
    trial, robot = answer.trial, answer.trial.config.robot
    count = f"{trial.unevaluated} of {len(trial.drives)} drives were not evaluated"
    ended = Counter(d.reason for d in trial.drives if d.kind == "not evaluated" and d.reason)
    if not ended:
        return f"{robot} drives too short a path on {answer.world}: {count}."
    reason, often = ended.most_common(1)[0]
    return f"{robot} cannot drive {answer.world}: {count}; most often ({often}): {reason}."


def _next_text(answer: Answer) -> str:
    """Return the command of the best change, or the one that continues."""
    best = max(answer.changes, key=lambda change: (change.rank, change.test.successes), default=None)
    if best is not None and best.rank > best.least:
        kind, count = Counter(drive.kind for drive in best.drives).most_common(1)[0]
        seed = next(drive.seed for drive in best.drives if drive.kind == kind)
        result = "worked" if kind == "works" else f"gave `{kind}`"
        command = command_of(replace(best.config, seed=seed))
        return f"Next: `{command}` {result} in {count} of {len(best.drives)} drives."
    if answer.continuation:
        return f"{answer.continuation}."
    if best is not None:
        judged = ", ".join(change.label for change in answer.changes if change.test.total)
        unjudged = ", ".join(change.label for change in answer.changes if not change.test.total)
        parts = (judged and f"Nothing tried is better: {judged}.", unjudged and f"Not evaluated: {unjudged}.")
        return " ".join(filter(None, parts))
    decided = answer.trial.decision == "does not work"
    return "There is no other method, lidar or drive to try." if decided else ""


def _share_text(test: SequentialTest) -> str:
    """Return share and interval of the drives that worked."""
    if not test.total:
        return "no drive was evaluated"
    low, high = test.interval
    return (
        f"it worked in {test.successes} of {test.total} drives ({100 * test.successes / test.total:.0f} %, "
        f"{100 * CONFIDENCE:.0f} % interval {100 * low:.0f} to {100 * high:.0f} %)"
    )


def _failures_text(trial: Trial) -> str:
    """Return the most frequent failure with an example; empty without one."""
    failed = [drive for drive in trial.drives if drive.kind not in ("works", "not evaluated")]
    if not failed:
        return ""
    kind, count = Counter(drive.kind for drive in failed).most_common(1)[0]
    same = [drive for drive in failed if drive.kind == kind]
    example = next((drive for drive in same if drive.reason), same[0])
    cause = f": {example.reason.rstrip('.')}" if example.reason else ""
    return f"Most frequent failure: {kind} ({count} of {len(failed)}), as with seed {example.seed}{cause}."


def methods_table(answers: Sequence[Answer]) -> ReportTable:
    """Return the decision on each method, and the drives of each change."""
    trials = [(answer, trial) for answer in answers for trial in (answer.trial, *answer.changes)]
    rows = tuple((a.world, a.trial.name, _label(t), _percent(t.forecast), *_cells(t)) for a, t in trials)
    headings = ("world", "method", "change", "forecast", *HEADINGS)
    return ReportTable("methods", "Decision", CAPTION, headings, rows, 5, remarks=True)


def drives_table(answers: Sequence[Answer]) -> ReportTable:
    """Return every drive with its verdict."""
    trials = [trial for answer in answers for trial in (answer.trial, *answer.changes)]
    drives = {drive.folder: drive for trial in trials for drive in trial.drives}
    labels: dict[str, dict[str, None]] = {name: {} for name in drives}
    for trial in trials:
        for drive in trial.drives:
            labels[drive.folder][_label(trial)] = None
    rows = tuple((name, ", ".join(labels[name]), d.kind, d.sentence) for name, d in drives.items())
    return ReportTable("drives", "Drives", "", ("folder", "change", "verdict", "sentence"), rows, 4)


def _label(trial: Trial) -> str:
    return trial.label if isinstance(trial, Change) else NOTHING


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


def write_decision(out: Path, answers: Sequence[Answer], command: str, scenarios: ScenarioCache) -> Path:
    """Write `verdict.html`, `verdict.png` and `verdict.json`; return the page's path."""
    figure = decision_figure(answers, out, scenarios)
    picture, alt = png(figure), "Paths of the drives by verdict, and where they failed"
    sentences = [conclusion(answer) for answer in answers]
    entries = [
        {"world": answer.world, "sentence": sentence}
        | {"changes": [{"change": change.label} | _entry(change) for change in answer.changes]}
        | _entry(answer.trial)
        for answer, sentence in zip(answers, sentences, strict=True)
    ]
    write_json(out / "verdict.json", {"command": command, "answers": entries})
    with atomic_write(out / "verdict.png") as path:
        path.write_bytes(picture)
    drawn = PageFigure(data_url(picture), alt, width=f"{figure.bbox.width:g}px")
    sections = (
        PageSection("methods", "Decision", tables=(methods_table(answers),)),
        PageSection("map", "Where it worked and failed", figures=(drawn,)),
        PageSection("drives", "Drives", tables=(drives_table(answers),)),
        PageSection("command", "Command", commands=(command,)),
    )
    worlds = ", ".join(dict.fromkeys(answer.world for answer in answers))
    html = page_html(f"Verdict: {worlds}", sentences, sections)
    page = out / "verdict.html"
    with atomic_write(page) as path:
        path.write_text(html, encoding="utf-8")
    return page


def _entry(trial: Trial) -> dict[str, Any]:
    """Return a trial as JSON stores it."""
    spread = ErrorSpread.of(drive.error for drive in trial.drives if drive.kind != "not evaluated")
    return {
        "robot": trial.config.robot,
        "mapper": trial.config.mapper,
        "forecast": trial.forecast,
        "decision": trial.decision,
        "share": trial.test.share,
        "interval": list(trial.test.interval),
        "path_error": None if spread is None else asdict(spread),
        "drives": [asdict(drive) for drive in trial.drives],
    }


def decision_figure(answers: Sequence[Answer], out: Path, scenarios: ScenarioCache) -> Drawing:
    """Draw the drives of each method on the world's map."""
    columns = min(COLUMNS, len(answers))
    rows = -(-len(answers) // columns)
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
