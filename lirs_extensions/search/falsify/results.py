"""Files of a search: folders of cases, suite, table, pictures, page and JSON."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import yaml
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from lirs_extensions.bench.episode import run_episode
from lirs_extensions.bench.policies import PolicyChoice
from lirs_extensions.bench.tasks import TaskSet, set_entry
from lirs_extensions.search.case_search import Case, SearchParameter
from lirs_extensions.search.falsify.search import (
    MIN_RATIO,
    NEW_SEEDS,
    WORST,
    CaseDrives,
    FoundCase,
    SearchLimits,
    policy_task,
    write_case,
)
from lirs_extensions.search.options import FAILURE_FACTOR, FalsifyOptions
from lirs_validation.experiment.run import run
from lirs_validation.report.page import PageFigure, PageSection, data_url, page_html, png
from lirs_validation.report.table import ReportTable
from lirs_validation.sweep.tasks import CASE
from lirs_wct import MapperError, Pose2, Trajectory, World
from lirs_wct.drawing.canvas import (
    BLACK,
    BLUE,
    GRAY,
    GREEN,
    VERMILLION,
    Canvas,
    Drawing,
    legend,
    map_axes,
    new_figure,
    path_ends,
    plain_axes,
    shaded_heights,
    title,
)
from lirs_wct.files import staged_files, write_json
from slam_baselines.mapper import short_name

Values = Mapping[str, float]


def _slope(v: Values) -> str:
    across = abs(math.sin(math.radians(v["slope_direction"])))
    kind = "cross slope" if across > 0.87 else "slope" if across < 0.5 else "diagonal slope"
    return f"{v['slope']:.2g} deg {kind}"


PHRASES: Mapping[str, Callable[[Values], str]] = {
    "slope": _slope,
    "relief": lambda v: f"hills of {v['relief']:.2g} m",
    "roughness": lambda v: f"rough ground ({100 * v['roughness']:.2g} cm)",
    "corridor": lambda v: (
        f"two parallel walls {v['corridor']:.2g} m long and {v['corridor_width']:.2g} m apart"
    ),
    "obstacles": lambda v: f"{v['obstacles']:.0f} obstacles",
    "obstacle_height": lambda v: f"obstacles {v['obstacle_height']:.2g} m high",
    "round_obstacles": lambda v: f"{100 * v['round_obstacles']:.0f} % round obstacles",
    "symmetry": lambda v: f"obstacles in a regular grid ({100 * v['symmetry']:.0f} %)",
    "boundary": lambda v: f"an outer wall of which {100 * v['boundary']:.0f} % stands",
    "actors": lambda v: f"{v['actors']:.0f} walkers",
    "speed": lambda v: f"{v['speed']:.2g} times the usual speed",
    "turn_rate": lambda v: f"{v['turn_rate']:.2g} times the usual turn rate",
    "reversing": lambda v: f"driving backwards for {100 * v['reversing']:.0f} % of the time",
    "stand": lambda v: f"{v['stand']:.2g} s of standing at the start",
    "sigma": lambda v: f"range noise of {1000 * v['sigma']:.2g} mm",
    "dropout": lambda v: f"{100 * v['dropout']:.0f} % lost beams",
    "lag": lambda v: f"scans {1000 * v['lag']:.0f} ms late",
    "field_of_view": lambda v: f"a field of view of {v['field_of_view']:.0f} deg",
    "dust": lambda v: f"dust in {100 * v['dust']:.2g} % of the beams",
    "slip": lambda v: f"wheel slip of {100 * v['slip']:.0f} % of the slope",
}
"""Words for a changed parameter; directions and widths belong to another one."""


def cause(case: Case, limits: SearchLimits) -> str:
    """Return the changed parameters as words; empty if none is changed."""
    names = [p.name for p in limits.difference(case)]
    words = [PHRASES[name](case.values) for name in names if name in PHRASES]
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} and {words[-1]}"


def sentence(options: FalsifyOptions, case: Case, limits: SearchLimits) -> str:
    """Return one sentence on the failure of a method."""
    who = f"{short_name(options.method)} on {options.robot}"
    found = cause(case, limits)
    fails = f"{who} fails with {found}" if found else f"{who} fails on the easiest ground already"
    reference = options.compared_with
    return f"{fails}; {short_name(reference)} does not." if reference else f"{fails}."


STAGES = {"search": BLUE, "confirmation": VERMILLION, "shrinking": GREEN}
"""Color of a drive by its part of the search."""


@dataclass(frozen=True)
class CasePaths:
    """Paths of a failed drive, world frame.

    Attributes:
        truth: True poses.
        estimate: Poses of the mapper, moved by the true start pose; None of a policy.
        limit: Path error of a failure, meters.
    """

    truth: Trajectory
    estimate: Trajectory | None = None
    limit: float = np.inf

    @property
    def errors(self) -> tuple[Any, Any]:
        """Stamps and distances between estimate and truth, both (n,), seconds and meters."""
        assert self.estimate is not None, "a policy has no estimate"
        stamps = self.truth.stamps
        return stamps, np.hypot(*(self.estimate.planar_at(stamps)[:, :2] - self.truth.xy).T)

    @property
    def failure(self) -> float | None:
        """Time when the error first exceeds the limit, or a policy ends; None = never."""
        if self.estimate is None:
            return float(self.truth.stamps[-1])
        stamps, errors = self.errors
        over = np.flatnonzero(errors > self.limit)
        return float(stamps[over[0]]) if len(over) else None


def case_figure(world: World, paths: CasePaths | None, heading: str) -> Drawing:
    """Draw world, paths (None if the mapper raised) and moment of failure."""
    wide = paths is not None and paths.estimate is not None
    figure = new_figure(10.4 if wide else 5.4, 5.2)
    axes = figure.add_subplot(1, 1 + wide, 1)
    canvas = Canvas.over(world.surface.bounds)
    map_axes(axes, canvas, shaded_heights(world, canvas))
    title(axes, heading, above_legend=paths is not None)
    if paths is not None:
        _draw_paths(axes, paths)
    if paths is not None and wide:
        _draw_errors(figure.add_subplot(1, 2, 2), paths)
    return figure


def _draw_paths(axes: Axes, paths: CasePaths) -> None:
    axes.plot(*paths.truth.xy.T, color=BLUE, linewidth=2.6, zorder=4)
    handles: list[Line2D] = [Line2D([], [], color=BLUE, linewidth=2.6, label="true")]
    if paths.estimate is not None:
        axes.plot(*paths.estimate.xy.T, color=VERMILLION, linewidth=1.2, zorder=5)
        handles.append(Line2D([], [], color=VERMILLION, linewidth=1.2, label="estimated"))
    handles += path_ends(axes, paths.truth)
    if paths.failure is not None:
        place = paths.truth.xy[int(np.searchsorted(paths.truth.stamps, paths.failure))]
        axes.plot(*place, "X", color=BLACK, markeredgecolor="white", markersize=11, zorder=7)
        handles.append(Line2D([], [], color=BLACK, marker="X", linestyle="", label="failure"))
    legend(axes, handles)


def _draw_errors(axes: Axes, paths: CasePaths) -> None:
    """Draw the distance between estimate and truth over time."""
    stamps, errors = paths.errors
    axes.plot(stamps, errors, color=VERMILLION, linewidth=1.4)
    axes.axhline(paths.limit, color=GRAY, linewidth=1.0, linestyle="--")
    if paths.failure is not None:
        axes.axvline(paths.failure, color=BLACK, linewidth=1.0)
    plain_axes(axes, "time [s]", "distance from the true position [m]")
    axes.set_xlim(stamps[0], stamps[-1])
    axes.set_ylim(0.0, None)
    handles = [
        Line2D([], [], color=GRAY, linestyle="--", label="limit of a failure"),
        Line2D([], [], color=BLACK, label="failure"),
    ]
    legend(axes, handles)


def search_figure(drives: CaseDrives, found: Sequence[int]) -> Drawing:
    """Draw each drive's ratio of error and limit, and lines at confirmed cases."""
    figure = new_figure(10.4, 3.6)
    axes = figure.add_subplot()
    handles = []
    for stage, color in STAGES.items():
        points = [(k, s) for k, (name, *_, s) in enumerate(drives.history, start=1) if name == stage]
        if not points:
            continue
        for counted in (True, False):
            chosen = [(k, min(max(s.ratio, MIN_RATIO), WORST)) for k, s in points if s.counted == counted]
            if chosen:
                face = color if counted else "none"
                axes.plot(*zip(*chosen, strict=True), "o", color=color, markerfacecolor=face, markersize=4)
        handles.append(Line2D([], [], color=color, marker="o", linestyle="", label=stage))
    for number in found:
        axes.axvline(number, color=BLACK, linewidth=0.8)
    axes.axhline(FAILURE_FACTOR, color=GRAY, linestyle="--", linewidth=1.0)
    axes.set_yscale("log")
    plain_axes(axes, "drive", "error / limit of `loses its way`")
    handles.append(Line2D([], [], color=GRAY, linestyle="--", label="failure"))
    legend(axes, handles)
    return figure


RUN = "run"
"""Folder of a case's run."""
PAGE, MAPPER_SUITE, POLICY_SUITE = "falsify.html", "cases.yaml", "cases.json"
CAPTION = (
    "A case is confirmed if the method fails with at least 4 of 5 new seeds, which change tour and noise. "
    "Drives: of the search up to the confirmation. Ratio: median of the path error over the limit of "
    "`loses its way`; a policy that fails has a ratio above the search's factor."
)


SEARCH_TEXT = (
    "One point per drive. Hollow points do not count: the robot could not drive, its lidar saw no walls, or "
    "the reference fails there, too. Vertical lines: confirmed cases."
)


@dataclass(frozen=True)
class WrittenCase:
    """A case with its folder, its failures with new seeds, and its PNG."""

    name: str
    found: FoundCase
    failures: int
    sentence: str
    picture: bytes


def conclusion(drives: CaseDrives, cases: Sequence[FoundCase]) -> tuple[str, ...]:
    """Return a sentence on each case, or that none was found."""
    options = drives.options
    if cases:
        return tuple(sentence(options, found.case, drives.limits) for found in cases)
    worst = max((s.ratio for *_, s in drives.history if s.counted), default=0.0)
    return (
        f"No confirmed failure of {short_name(options.method)} on {options.robot} was found in "
        f"{drives.count} drives; the largest ratio of error and limit was {worst:.2g}.",
    )


def write_results(out: Path, drives: CaseDrives, cases: Sequence[FoundCase], command: str) -> Path:
    """Write everything but the archive of drives; return the page's path.

    The results of an earlier search stay until all files are written.
    """
    with staged_files(out) as staged:
        _write_files(staged, out, drives, cases, command)
        for old in out.glob(f"case-*/{CASE}"):
            shutil.rmtree(old.parent)
        for name in (MAPPER_SUITE, POLICY_SUITE):
            (out / name).unlink(missing_ok=True)
    return out / PAGE


def _write_files(
    folder: Path, out: Path, drives: CaseDrives, cases: Sequence[FoundCase], command: str
) -> None:
    """Write the files into a folder whose content moves to `out`."""
    written = [_write_case(folder, out, drives, k, found) for k, found in enumerate(cases, start=1)]
    _write_suite(folder, drives, written)
    table, sentences = cases_table(written), conclusion(drives, cases)
    limits = [asdict(p) for p in drives.limits.parameters] + [{"returns": drives.limits.returns}]
    entries = [{"name": c.name, "sentence": c.sentence} | asdict(c.found) for c in written]
    summary = {"options": drives.options.decisive, "limits": limits, "sentences": list(sentences)}
    write_json(folder / "falsify.json", summary | {"drives": drives.count, "cases": entries})
    (folder / "cases.md").write_text(table.as_markdown(), encoding="utf-8")
    chart = png(search_figure(drives, [c.found.position for c in written]))
    (folder / "search.png").write_bytes(chart)
    sections = (
        *([PageSection("cases", "Cases", tables=(table,))] if table.rows else []),
        *(case_section(case, drives.limits.parameters) for case in written),
        PageSection(
            "search",
            "Search",
            SEARCH_TEXT,
            figures=(PageFigure(data_url(chart), "Error over limit of each drive"),),
        ),
        PageSection("command", "Command", commands=(command,)),
    )
    html = page_html(f"Failures of {short_name(drives.options.method)}", sentences, sections)
    (folder / PAGE).write_text(html, encoding="utf-8")


def cases_table(cases: Sequence[WrittenCase]) -> ReportTable:
    """Return one row per case, with its sentence."""
    rows = tuple(
        (
            case.name,
            str(case.found.drives),
            f"{case.failures} of {NEW_SEEDS}",
            f"{median(s.ratio for s in case.found.scores):.1f}",
            str(case.found.shrinking),
            case.sentence,
        )
        for case in cases
    )
    headings = ("case", "drives", "seeds that fail", "ratio", "drives to shrink", "failure")
    return ReportTable("cases", "Cases", CAPTION, headings, rows, 1, remarks=True)


def case_section(case: WrittenCase, parameters: Sequence[SearchParameter]) -> PageSection:
    """Return the picture of a case, and its changed parameters as found and after shrinking."""
    simple, found = case.found.case.values, case.found.found.values
    rows = tuple(
        (p.name, f"{p.default:g} {p.unit}", f"{found[p.name]:g} {p.unit}", f"{simple[p.name]:g} {p.unit}")
        for p in parameters
        if simple[p.name] != p.default
    )
    headings = ("parameter", "default", "as found", "simplest")
    table = ReportTable(f"{case.name}-parameters", f"Parameters of {case.name}", "", headings, rows)
    figure = PageFigure(data_url(case.picture), f"World, paths and moment of failure of {case.name}")
    tables = (table,) if rows else ()
    return PageSection(case.name, case.name, case.sentence, figures=(figure,), tables=tables)


def _write_case(staged: Path, out: Path, drives: CaseDrives, number: int, found: FoundCase) -> WrittenCase:
    """Write, drive and draw a case, in a folder that moves to `out`."""
    name, options = f"case-{number}", drives.options
    folder, text = staged / name, sentence(options, found.case, drives.limits)
    config = write_case(folder, found.case, options, method=options.mapper, seed=found.seed, comment=text)
    if options.policy is None:
        paths = None
        try:
            driven = run(config)
            # The world moves to another folder.
            record, old, new = driven.record, str(folder), str(out / name)
            source, noise = (text.replace(old, new) for text in (record.config.source, record.config.noise))
            files = [file | {"path": file["path"].replace(old, new)} for file in record.world["files"]]
            config = replace(record.config, source=source, noise=noise)
            record = replace(record, config=config, world=record.world | {"files": files})
            replace(driven, record=record).write(folder / RUN)
            truth, estimate, _ = driven.log.trajectories()
            limit = next((s.limit for s in found.scores if s.limit), 0.0)
            paths = CasePaths(truth, estimate, FAILURE_FACTOR * limit)
        except MapperError as error:  # the failure itself: there is no run to draw
            text = f"{text.removesuffix('.')}: {error}".replace(str(staged), str(out))
    else:
        task = policy_task(options, found.case, found.seed)
        log = run_episode(task, PolicyChoice(options.method))
        stamps = np.linspace(0.0, float(log.last["time"]), len(log.poses))
        paths = CasePaths(Trajectory.from_poses(stamps, [Pose2(*pose.tolist()) for pose in log.poses]))
    picture = png(case_figure(World.load(folder), paths, name))
    (folder / "case.png").write_bytes(picture)
    failures = sum(map(drives.fails, found.scores))
    return WrittenCase(name, found, failures, text, picture)


def _write_suite(out: Path, drives: CaseDrives, cases: Sequence[WrittenCase]) -> None:
    """Write the suite of all cases, for `validate --suite` or `bench --set`."""
    if not cases:
        return
    if drives.options.policy is None:
        names = yaml.safe_dump({"cases": [case.name for case in cases]})
        (out / MAPPER_SUITE).write_text(names, encoding="utf-8")
        return
    tasks = tuple(policy_task(drives.options, c.found.case, c.found.seed, c.name) for c in cases)
    write_json(out / POLICY_SUITE, set_entry(TaskSet(name="cases", version=1, tasks=tasks)))
