"""The command `verdict`: decide whether methods work on a terrain."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lirs_validation.cli.progress import GATE_FAILED, err, out
from lirs_validation.cli.typer_options import Sources
from lirs_validation.config import EngineOptions, RunConfig, SourceOptions
from lirs_wct import ConfigError

if TYPE_CHECKING:
    from lirs_validation.decision.trials import Perform, Trial
    from lirs_validation.sweep.experiment import Outcome
    from lirs_validation.sweep.sweep import Sweep

Budget = Annotated[
    str,
    typer.Option(
        "--budget",
        metavar="TIME",
        help="Wall time after which no drive begins: 90s, 10min, 2h; 0s = forecast alone.",
    ),
]
Output = Annotated[Path, typer.Option("-o", "--output", help="Folder for page and drives.")]
UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def read_duration(text: str, flag: str) -> float:
    """Return the seconds of a duration such as `90s`, `10min` or `2h`.

    Raises:
        ConfigError: the text is none.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(s|min|h)\s*", text)
    if match is None:
        raise ConfigError(f"{flag} must be a duration such as 90s, 10min or 2h, got {text!r}")
    return float(match[1]) * UNITS[match[2]]


def verdict(
    sources: Sources,
    budget: Budget = "10min",
    output: Output = Path("verdict"),
    gate: Annotated[bool, typer.Option("--gate", help="Exit with code 4 unless every method works.")] = False,
    *,
    run: Annotated[dict[str, Any], RunConfig],
    engine: EngineOptions,
    options: SourceOptions,
) -> None:
    """Decide whether SLAM methods work on a terrain: drive until a sequential test decides.

    Seeds count up from --seed; each has another start, tour and sensor noise. The same command continues.
    """
    from lirs_validation.decision.decide import decide
    from lirs_validation.decision.page import changes_table, methods_table, write_decision
    from lirs_validation.sweep.suites import cross

    seconds = read_duration(budget, "--budget")
    if len(run.get("seed", ())) > 1:
        raise ConfigError(f"--seed is the first seed of the drives: one number, got {len(run['seed'])}")
    configs = cross(tuple(sources), build=options, **run)
    answers = decide(
        configs,
        output,
        _performer(engine),
        budget=seconds,
        report=_print_state,
        retry_failed=engine.retry_failed,
    )
    page = write_decision(output, answers, shlex.join(["lirs-wct", *sys.argv[1:]]))
    out.print(methods_table(answers))
    if any(answer.changed for answer in answers):
        out.print(changes_table(answers))
    out.print(f"{page}", soft_wrap=True, highlight=False)
    for answer in answers:
        out.print(f"verdict: {answer.sentence}", soft_wrap=True, highlight=False, markup=False)
    if gate and any(answer.trial.decision != "works" for answer in answers):
        raise typer.Exit(GATE_FAILED)


def _performer(engine: EngineOptions) -> Perform:
    """Return the function that runs a sweep with the engine, under a bar of progress."""
    from lirs_validation.cli.progress import run_with_progress
    from lirs_validation.sweep.sweep import make_executor

    executor = make_executor(engine)

    def perform(sweep: Sweep) -> Generator[Outcome]:
        yield from run_with_progress(sweep, executor, err)

    return perform


def _print_state(trial: Trial) -> None:
    """Print the forecast of a trial, or the verdict of its last drive and what it means for the decision."""
    from lirs_validation.decision.decide import forecast_text

    if not trial.drives:
        err.print(forecast_text(trial), soft_wrap=True, highlight=False, markup=False)
        return
    drive, test = trial.drives[-1], trial.test
    decided = "" if trial.decision == "undecided" else f": {trial.decision}"
    counts = f"{test.successes} of {test.successes + test.failures} worked{decided}"
    err.print(f"{drive.folder}: {drive.kind}; {counts}", soft_wrap=True, highlight=False, markup=False)
