"""The report as one HTML page that needs nothing else: no network, no scripts, no files beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from lirs_validation.analysis.result_folders import RunFolder
from lirs_validation.record.catalog import figures_named, rtf_counts, span
from lirs_validation.report.charts import AROUND, distribution_chart, rtf_chart
from lirs_validation.report.contents import Report
from lirs_validation.report.pictures import Painter
from lirs_validation.report.tables.metric_tables import sound
from lirs_validation.report.tables.table import Sheet

MOST_PICTURES = 120
"""Runs that are shown in pictures; of more, the first seed of each cell."""
SPREAD = ("rtf.mean", "trajectory.ate_rmse", "map.f1", "map.false_occupied")
INTROS = {
    "rtf": "Simulated seconds per wall second of the whole loop, compilation left out; its parts in wall "
    "milliseconds per simulated second; and the same drive replayed through MuJoCo's step alone.",
    "trajectory": "Errors of the mapper's final trajectory in the plane, against the simulator's truth.",
    "map": "The built map, moved by the true start pose and by nothing else, against the map that the same "
    "update makes of the same scans at the true poses; false occupied against the world's geometry.",
    "contacts": "What the robot touched, and how deeply, while it was mapping.",
    "cost": "Processor time of the drive, peak memory of the process, compilation before the clock starts, "
    "and what a scan costs the mapper.",
}


@dataclass(frozen=True)
class Picture:
    """A run's picture on the page."""

    name: str
    url: str
    alt: str
    note: str


def page(report: Report, command: str) -> str:
    """Return the report as HTML.

    Args:
        report: what it tells.
        command: the command line that makes it.
    """
    environment = Environment(
        loader=PackageLoader("lirs_validation.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    style, _, _ = PackageLoader("lirs_validation.report").get_source(environment, "report.css")
    pictures, note = _pictures(report.runs)
    context: dict[str, Any] = {
        "title": report.title,
        "subtitle": report.subtitle,
        "style": style,
        "tiles": _tiles(report),
        "failures": report.failures if report.failures.rows else None,
        "checks_failed": report.checks_failed if report.checks_failed.rows else None,
        "skipped": report.skipped if report.skipped.rows else None,
        "summary": report.summary,
        "paper": report.paper,
        "groups": [_group(report, key, cells, runs) for key, cells, runs in report.groups],
        "collisions": report.collisions if report.collisions.rows else None,
        "spread": _spread(report),
        "pictures": pictures,
        "pictures_note": note,
        "sound": sum(map(sound, report.entries)),
        "command": report.command,
        "report_command": command,
        "origins": report.origins,
        "commands": report.commands,
    }
    context["contents"] = _contents(context)
    return environment.get_template("report.html.j2").render(context)


def _group(report: Report, key: str, cells: Sheet, runs: Sheet) -> dict[str, Any]:
    made = rtf_chart(report.entries) if key == "rtf" else None
    svg, left_out = made or ("", 0)
    caption = (
        "RTF over simulated time, as in the paper's Fig. 13: mean and a band of one standard deviation, over "
        f"seeds; where a method has one seed, over {2 * AROUND + 1} s of its run."
    )
    if left_out:
        caption += f" {left_out} more panels are left out; their figures stand in the table."
    return {
        "key": key,
        "title": cells.title,
        "intro": INTROS[key],
        "cells": cells,
        "runs": runs,
        "chart": svg,
        "chart_caption": caption,
    }


def _spread(report: Report) -> dict[str, str] | None:
    made = distribution_chart(report.entries, figures_named(SPREAD))
    if made is None:
        return None
    caption = "Every sound run is a dot, the bar their median; one row a cell."
    if made[1]:
        caption += f" {made[1]} more cells are left out; their figures stand in the tables."
    return {"svg": made[0], "caption": caption}


def _pictures(runs: Sequence[RunFolder]) -> tuple[list[Picture], str]:
    """Return the pictures of runs that have maps, failures included, and which are shown."""
    drawn = [run for run in runs if run.entry["map"]]
    note = ""
    chosen = drawn
    if len(drawn) > MOST_PICTURES:
        first = min((int(run.entry["seed"]) for run in drawn), default=0)
        chosen = [run for run in drawn if int(run.entry["seed"]) == first][:MOST_PICTURES]
        note = f"Shown are {len(chosen)} of {len(drawn)} runs: seed {first} of each cell."
    painter = Painter(len(chosen))
    pictures = []
    for run in chosen:
        c, picture = run.entry["config"], painter.paint(run)
        name = (
            f"{run.entry['world']['name']}, {c['robot']}, {c['mapper']}, {c['terrain']}, {c['rays']} rays, "
        )
        name += f"seed {c['seed']}" + ("" if run.entry["status"] == "ok" else f": {run.entry['status']}")
        pictures.append(Picture(name, picture.url, f"Paths and maps of {name}", picture.note))
    return pictures, note


def _tiles(report: Report) -> list[dict[str, Any]]:
    entries = report.entries
    good = [entry for entry in entries if sound(entry)]
    failed = len(entries) - len(good)
    tiles: list[dict[str, Any]] = [
        {"value": f"{len(good)} of {len(entries)}", "name": "runs are sound", "bad": failed > 0},
        {"value": str(report.seeds), "name": "seed" if report.seeds == 1 else "seeds", "bad": False},
    ]
    ate, f1 = (figures_named([place])[0] for place in ("trajectory.ate_rmse", "map.f1"))
    alone = [float(e["rtf"]["mean"]) for e in good if rtf_counts(e) and not e["rtf"]["extrapolated"]]
    if alone:
        tiles.append({"value": span(alone), "name": "RTF", "bad": False})
    for figure, name in ((ate, "median ATE [m]"), (f1, "median F1")):
        values = sorted(v for e in good if (v := figure.of(e)) is not None)
        if values:
            tiles.append({"value": figure.told(values[len(values) // 2]), "name": name, "bad": False})
    if report.collisions.rows:
        passed, of = report.checks
        tiles.append({"value": f"{passed} of {of}", "name": "collision checks passed", "bad": passed < of})
    return tiles


def _contents(context: dict[str, Any]) -> list[tuple[str, str]]:
    """Return anchors and names of the sections that the page has."""
    failed = context["failures"] or context["checks_failed"] or context["skipped"]
    sections = [
        ("failed", "Failures", failed),
        ("overview", "Summary", context["summary"].rows),
        ("paper", "The paper", context["paper"]),
        *((f"{g['key']}-section", g["title"], True) for g in context["groups"]),
        ("collisions", "Collisions", context["collisions"]),
        ("distributions", "Distributions", context["spread"]),
        ("pictures", "Maps and paths", context["pictures"]),
        ("provenance", "Commands and versions", True),
    ]
    return [(key, name) for key, name, there in sections if there]
