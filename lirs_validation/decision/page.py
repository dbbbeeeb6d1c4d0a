"""Tables, page and JSON of a decision."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

from lirs_validation.decision.decide import Answer, method_name
from lirs_validation.decision.picture import decision_figure
from lirs_validation.decision.trials import Trial
from lirs_validation.record.formatting import NOTHING
from lirs_validation.report.page import render
from lirs_validation.report.table import ReportTable
from lirs_wct.files import atomic_write, write_json

CAPTION = (
    "Share of the evaluated drives that worked, with its exact 95 % interval (Clopper and Pearson). A "
    "sequential test decides: it accepts a share of 90 % and rejects one of 65 %, with at most 5 % errors "
    "each (Wald). The forecast is the share that a model expected before the drives."
)
HEADINGS = ("decision", "worked", "share", "95 % interval", "not evaluated", "verdicts")


def methods_table(answers: Sequence[Answer]) -> ReportTable:
    """Return the decision on each method."""
    rows = tuple(
        (a.world, method_name(a.trial.config), _percent(a.trial.forecast), *_cells(a.trial)) for a in answers
    )
    headings = ("world", "method", "forecast", *HEADINGS)
    return ReportTable("methods", "Decision", CAPTION, headings, rows, 4, remarks=True)


def changes_table(answers: Sequence[Answer]) -> ReportTable:
    """Return the decision on each changed run."""
    rows = tuple(
        (answer.world, method_name(answer.trial.config), label, *_cells(trial))
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
    total = test.successes + test.failures
    low, high = test.interval
    kinds = Counter(drive.kind for drive in trial.drives)
    return (
        trial.decision,
        f"{test.successes} of {total}",
        _percent(test.share),
        f"{100 * low:.0f} to {100 * high:.0f} %" if total else NOTHING,
        str(trial.unevaluated),
        ", ".join(f"{kind} {count}" for kind, count in kinds.most_common()),
    )


def _percent(share: float | None) -> str:
    return NOTHING if share is None else f"{100 * share:.0f} %"


def write_decision(out: Path, answers: Sequence[Answer], command: str) -> Path:
    """Write `verdict.html`, `verdict.png` and `verdict.json`; return the page's path.

    Raises:
        OutputError: a file cannot be written.
    """
    picture = BytesIO()
    decision_figure(answers, out).savefig(picture, dpi=110, format="png")
    write_json(out / "verdict.json", {"command": command, "answers": [a.to_dict() for a in answers]})
    with atomic_write(out / "verdict.png") as path:
        path.write_bytes(picture.getvalue())
    html = render(
        "decision.html.j2",
        title="Verdict: " + ", ".join(dict.fromkeys(answer.world for answer in answers)),
        sentences=[answer.sentence for answer in answers],
        methods=methods_table(answers),
        changed=changes_table(answers),
        drives=drives_table(answers),
        picture="data:image/png;base64," + base64.b64encode(picture.getvalue()).decode(),
        command=command,
    )
    page = out / "verdict.html"
    with atomic_write(page) as path:
        path.write_text(html, encoding="utf-8")
    return page
