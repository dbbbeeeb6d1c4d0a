"""The paper's tables beside ours, and its findings computed from the runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise, product
from typing import Final

from lirs_validation.record.metric_catalog import Entry, Metric, metrics_named, significant, span
from lirs_validation.record.run_record import succeeded
from lirs_validation.report.run_tables import EXTRAPOLATED, over_runs, without_rtf
from lirs_validation.report.table import Content, ReportTable
from lirs_validation.sweep.tasks import HEIGHTMAP, HUSKY, MAPPERS, OURS, SOLID, SUITES, VIEWS, WORLDS

PUBLISHED_RTF: Final[dict[tuple[str, str, str], float]] = {
    ("medium", "gmapping", HEIGHTMAP): 0.04,
    ("medium", "gmapping", SOLID): 0.46,
    ("medium", "hector", HEIGHTMAP): 0.06,
    ("medium", "hector", SOLID): 0.64,
    ("medium", "cartographer", HEIGHTMAP): 0.05,
    ("medium", "cartographer", SOLID): 0.59,
    ("advanced", "gmapping", HEIGHTMAP): 0.010,
    ("advanced", "gmapping", SOLID): 0.42,
    ("advanced", "hector", HEIGHTMAP): 0.012,
    ("advanced", "hector", SOLID): 0.60,
    ("advanced", "cartographer", HEIGHTMAP): 0.011,
    ("advanced", "cartographer", SOLID): 0.57,
}
"""Tables III and IV, by world, mapper and view. Table II (`simple`) was printed without its values."""
ROBOT_MEANS: Final = {"husky": 0.38, "turtlebot2": 0.52, "jackal": 0.47}
"""Average RTF over the three methods (Section III-D)."""
COMFORTABLE_RTF = 0.3
"""Below this RTF the paper calls navigation infeasible (Section V-B)."""
RTF: Metric = metrics_named(["rtf.mean"])[0]
Means = Mapping[tuple[str, str, str], float]
Finding = tuple[str, str, str]
"""A claim of the paper, whether it holds, and the runs that say so."""

COLLAPSE_RATIO = 10.0
"""Slowdown against solids from which on a heightmap collapses; all heightmaps of the paper do."""


def paper_tables(entries: Sequence[Entry]) -> tuple[ReportTable, ...]:
    """Return Tables II to IV and the means by robot, the paper's and ours."""
    return (*(_world_table(world, entries) for world in WORLDS), _robot_table(entries))


def suite_tables(suite: object, entries: Sequence[Entry]) -> tuple[ReportTable, ...]:
    """Return tables and findings for a suite of the paper; none for other suites."""
    return (*paper_tables(entries), findings_table(entries)) if str(suite) in SUITES else ()


def _world_table(world: str, entries: Sequence[Entry]) -> ReportTable:
    """Return one of Tables II to IV."""
    rows: list[tuple[Content, ...]] = []
    for mapper, name in MAPPERS.items():
        row: list[Content] = [name]
        for view in VIEWS:
            if view != OURS:
                row.append(_published_text(PUBLISHED_RTF.get((world, mapper, view))))
            row.append(_mean_rtf(husky_runs(entries, world, mapper, view)))
        rows.append(tuple(row))
    columns = (f"{view}, {whose}" for view in (HEIGHTMAP, SOLID) for whose in ("paper", "here"))
    headings = ("SLAM method", *columns, OURS)
    lines = (
        ["The paper prints this table empty; its text says 0.09 on the heightmap."]
        if world == "simple"
        else []
    )
    if any(EXTRAPOLATED in str(cell) for row in rows for cell in row):
        lines.append(f"{EXTRAPOLATED} stopped at the wall limit and extrapolated.")
    lines += without_rtf([e for e in entries if (e["world"]["name"], e["config"]["robot"]) == (world, HUSKY)])
    title = f"Table {WORLDS[world]}: {world} map, RTF"
    return ReportTable(f"table-{WORLDS[world]}", title, " ".join(lines), headings, tuple(rows))


def _mean_rtf(runs: Sequence[Entry], *, interval: bool = True) -> Content:
    """Return the mean RTF of runs, or the reason why they have none."""
    good = [run for run in runs if succeeded(run)]
    spread = over_runs(RTF, good)
    if spread.values is not None:
        return spread if interval else RTF.formatted(spread.values.mean) + spread.mark
    return "not given" if good else f"failed: {runs[0]['status']}" if runs else "not run"


def _robot_table(entries: Sequence[Entry]) -> ReportTable:
    """Return the average RTF by robot."""
    rows = []
    for robot, value in ROBOT_MEANS.items():
        runs = [entry for entry in entries if entry["config"]["robot"] == robot]
        views = ([entry for entry in runs if _view(entry) == view] for view in (SOLID, OURS))
        rows.append((robot, _published_text(value), *(_mean_rtf(view, interval=False) for view in views)))
    caption = (
        "Mean RTF over all worlds, methods and seeds; without an interval, since worlds and methods are no "
        "repeats. The paper's are means on its solid worlds (Section III-D)."
    )
    headings = ("robot", "paper", "solid-based, here", "ours")
    return ReportTable("robots", "Section III-D: average RTF by robot", caption, headings, tuple(rows))


def _published_text(value: float | None) -> str:
    return "not printed" if value is None else f"{value:.2f}" if value > 0.02 else f"{value:.3f}"


def husky_runs(entries: Sequence[Entry], world: str, mapper: str, view: str) -> list[Entry]:
    """Return the Husky's runs in a world, with a mapper, in one representation."""
    wanted = (world, mapper, HUSKY, view)
    return [
        e
        for e in entries
        if (e["world"]["name"], e["config"]["mapper"], e["config"]["robot"], _view(e)) == wanted
    ]


def _view(entry: Entry) -> str | None:
    geometry = (entry["config"]["terrain"], entry["config"]["rays"])
    return next((view for view, pair in VIEWS.items() if pair == geometry), None)


def findings_table(entries: Sequence[Entry]) -> ReportTable:
    """Return the paper's findings, each checked against the runs."""
    good = [entry for entry in entries if succeeded(entry)]
    means = {
        key: values.mean
        for key in product(WORLDS, MAPPERS, VIEWS)
        if (values := over_runs(RTF, husky_runs(good, *key)).values) is not None
    }
    rows = (
        _collapse(means),
        _worse_with_terrain(means),
        _rank_finding(means, "hector", "fastest", max),
        _rank_finding(means, "gmapping", "slowest", min),
        _comfortable(means),
    )
    headings, caption = ("the paper says", "here", "because"), " ".join(without_rtf(entries))
    return ReportTable("findings", "Section V-B: which findings hold here", caption, headings, rows, 3)


def _answer(yes: int, of: int) -> str:
    """Return the answer for `yes` of `of` cases; in part = at least half."""
    if of == 0:
        return "cannot be said"
    return "holds" if yes == of else "holds in part" if 2 * yes >= of else "does not hold"


def _collapse(means: Means) -> Finding:
    """Check the finding that only heightmap-based worlds are unusably slow."""
    claim = "Heightmap-based worlds collapse: their RTF falls towards zero, solid-based ones stay usable."
    ratios = _ratios(means)
    if not ratios:
        return (claim, "cannot be said", "no heightmap-based RTF has a solid-based one beside it.")
    slow = [rtf for key, rtf in means.items() if key[2] == HEIGHTMAP]
    published = list(_ratios(PUBLISHED_RTF).values())
    collapsed = sum(
        ratio >= COLLAPSE_RATIO and means[(*key, HEIGHTMAP)] < COMFORTABLE_RTF
        for key, ratio in ratios.items()
    )
    because = (
        f"{collapsed} of {len(ratios)} heightmap-based groups are below RTF {COMFORTABLE_RTF:g} and at least "
        f"{COLLAPSE_RATIO:g} times as slow as their solid-based twin; RTF {span(slow)}, solid-based "
        f"{span(list(ratios.values()))} times as fast (paper: {span(published)} times)."
    )
    return (claim, _answer(collapsed, len(ratios)), because)


def _worse_with_terrain(means: Means) -> Finding:
    """Check the finding that heightmaps get slower with rougher terrain."""
    claim = "Heightmaps get slower with the terrain's complexity (0.09, 0.05, 0.011)."
    series = {m: [v for w in WORLDS if (v := means.get((w, m, HEIGHTMAP)))] for m in MAPPERS}
    whole = {m: values for m, values in series.items() if len(values) == len(WORLDS)}
    falling = sum(all(a > b for a, b in pairwise(v)) for v in whole.values())
    texts = "; ".join(f"{MAPPERS[m]} {', '.join(map(significant, v))}" for m, v in whole.items())
    return (claim, _answer(falling, len(whole)), f"{texts}." if texts else "not all worlds have such an RTF.")


def _rank_finding(means: Means, mapper: str, rank: str, best: Callable[[Iterable[float]], float]) -> Finding:
    """Check the finding that one method is always the fastest, or the slowest."""
    claim = f"{MAPPERS[mapper]} is the {rank} of the three methods."
    won: dict[str, list[str]] = {m: [] for m in MAPPERS}
    for world, view in product(WORLDS, VIEWS):
        values = {m: means[(world, m, view)] for m in MAPPERS if (world, m, view) in means}
        if len(values) == len(MAPPERS):
            wanted = best(values.values())
            won[next(m for m, v in values.items() if v == wanted)].append(f"{world} {view}")
    asked = sum(map(len, won.values()))
    if not asked:
        return (claim, "cannot be said", "no world has the RTF of all three.")
    others = [f"{MAPPERS[m]} ({', '.join(where)})" for m, where in won.items() if where and m != mapper]
    because = (
        f"in {len(won[mapper])} of {asked} comparisons (world and representation, Husky, by the mean RTF)"
    )
    because += f"; else {'; '.join(others)}." if others else "."
    return (claim, _answer(len(won[mapper]), asked), because)


def _comfortable(means: Means) -> Finding:
    """Check the finding that all methods are fast enough on solid worlds."""
    claim = f"On solid-based worlds every method reaches RTF {COMFORTABLE_RTF:g} or more (0.42 to 0.73)."
    values = [rtf for key, rtf in means.items() if key[2] == SOLID]
    ours = [rtf for key, rtf in means.items() if key[2] == OURS]
    enough = sum(rtf >= COMFORTABLE_RTF for rtf in values)
    because = f"{enough} of {len(values)} solid-based groups, RTF {span(values)}" if values else "no such RTF"
    because += f"; ours {span(ours)}." if ours else "."
    return (claim, _answer(enough, len(values)), because)


def _ratios(means: Means) -> dict[tuple[str, str], float]:
    """Return the RTF on solids over the RTF on heightmaps, by world and mapper."""
    pairs = {(w, m): (means.get((w, m, SOLID)), means.get((w, m, HEIGHTMAP))) for w, m, _ in means}
    return {key: solid / slow for key, (solid, slow) in pairs.items() if solid and slow}
