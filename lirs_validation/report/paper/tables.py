"""The paper's tables beside ours."""

from __future__ import annotations

from collections.abc import Sequence

from lirs_validation.record.formatting import Entry
from lirs_validation.record.metric_catalog import Metric, metrics_named
from lirs_validation.record.run_record import succeeded
from lirs_validation.report.paper import published
from lirs_validation.report.paper.published import MAPPERS, OURS, SOLID, VIEWS, WORLDS
from lirs_validation.report.tables.metric_tables import EXTRAPOLATED, over_runs
from lirs_validation.report.tables.table import Content, ReportTable, Spread

RTF: Metric = metrics_named(["rtf.mean"])[0]


def paper_tables(entries: Sequence[Entry]) -> tuple[ReportTable, ...]:
    """Return Tables II to IV and the means by robot, each with the paper's values beside ours."""
    good = [entry for entry in entries if succeeded(entry)]
    return (*(_world_table(world, good) for world in WORLDS), _robot_table(good))


def _world_table(world: str, entries: Sequence[Entry]) -> ReportTable:
    """Return one of Tables II to IV."""
    rows: list[tuple[Content, ...]] = []
    for mapper, name in MAPPERS.items():
        row: list[Content] = [name]
        for view in VIEWS:
            if view != OURS:
                row.append(_published(published.RTF.get((world, mapper, view))))
            row.append(over_runs(RTF, husky_runs(entries, world, mapper, view)))
        rows.append(tuple(row))
    headings = (
        "SLAM method", "heightmap-based, paper", "heightmap-based, here", "solid-based, paper",
        "solid-based, here", "ours",
    )  # fmt: skip
    table = WORLDS[world]
    lost = "" if world != "simple" else "The paper's Table II is lost: it was printed without its values. "
    caption = (
        f"{lost}RTF, mean over seeds ± half width of its 95 % interval where there are several; Husky. The "
        "paper: Gazebo with ODE. Here: MuJoCo's height field with its own rays, the mesh with MuJoCo's rays, "
        f"and our rays on the height field. {EXTRAPOLATED} stopped at the wall limit and extrapolated."
    )
    return ReportTable(f"table-{table}", f"Table {table}: {world} map", caption, headings, tuple(rows))


def _robot_table(entries: Sequence[Entry]) -> ReportTable:
    """Return the average RTF by robot."""
    rows = []
    for robot, value in published.ROBOT_MEANS.items():
        runs = [entry for entry in entries if entry["config"]["robot"] == robot]
        here = [over_runs(RTF, [e for e in runs if _view(e) == view]) for view in (SOLID, OURS)]
        rows.append((robot, _published(value), *(_without_interval(spread) for spread in here)))
    caption = (
        "Mean RTF over all worlds, methods and seeds; without an interval, since worlds and methods are no "
        "repeats. The paper's are means on its solid worlds (Section III-D)."
    )
    headings = ("robot", "paper", "solid-based, here", "ours")
    return ReportTable("robots", "Average RTF by robot", caption, headings, tuple(rows))


def _without_interval(spread: Spread) -> Content:
    return RTF.formatted(None if spread.values is None else spread.values.mean) + spread.mark


def _published(value: float | None) -> str:
    return "lost" if value is None else f"{value:.2f}" if value > 0.02 else f"{value:.3f}"


def husky_runs(entries: Sequence[Entry], world: str, mapper: str, view: str) -> list[Entry]:
    """Return the runs of the paper's main robot in a world, with a mapper, in one representation."""
    return [
        e
        for e in entries
        if (e["world"]["name"], e["config"]["mapper"], e["config"]["robot"])
        == (world, mapper, published.HUSKY)
        and _view(e) == view
    ]


def _view(entry: Entry) -> str | None:
    held = (entry["config"]["terrain"], entry["config"]["rays"])
    return next((view for view, asked in VIEWS.items() if asked == held), None)
