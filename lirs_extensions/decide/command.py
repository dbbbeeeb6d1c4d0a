"""The command `verdict`: decide whether methods work on a terrain."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from click.exceptions import Exit

from lirs_validation.cli.command import common, map_logs, sources_argument
from lirs_validation.cli.exit_codes import ExitCode
from lirs_validation.cli.progress import command_line, out, say
from lirs_validation.config import EngineOptions, RunConfig, World
from lirs_wct import ConfigError
from lirs_wct.option import Options, option

UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def read_duration(text: str, flag: str) -> float:
    """Return the seconds of a duration such as `90s`, `10min` or `2h`."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(s|min|h)\s*", text)
    if match is None:
        raise ConfigError(f"{flag} must be a duration such as 90s, 10min or 2h, got {text!r}")
    return float(match[1]) * UNITS[match[2]]


@dataclass(frozen=True, kw_only=True)
class VerdictOptions(Options):
    """Sources, budget and results of `verdict`."""

    sources: tuple[str, ...] = sources_argument()
    budget: float = option(
        UNITS["min"] * 10,
        "Wall time of the command: 90s, 10min, 2h; 0s = forecast alone.",
        metavar="TIME",
        unit="s",
        reader=read_duration,
    )
    output: Path = option(Path("verdict"), "Folder for page and drives.")
    gate: bool = option(False, "Exit with code 4 unless every method works.")


@common(
    *("robot", "mapper", "lidar", "budget", "seconds", "output", "jobs", "gate", "attitude", "driver"),
    *("actors", "size", "height"),
)
def verdict(
    options: VerdictOptions, run: Annotated[dict[str, Any], RunConfig], engine: EngineOptions, build: World
) -> None:
    """Decide whether SLAM methods work on a terrain: drive until a sequential test decides.

    Seeds count up from --seed; each has another start, tour and sensor noise. The same command continues.

    Examples:
    lirs-wct verdict medium --robot jackal --mapper hector,gmapping --budget 10min -o verdict/
    """
    begun = time.monotonic()
    from lirs_extensions.decide.decide import Budget, decide
    from lirs_extensions.decide.page import conclusion, methods_table, write_decision
    from lirs_validation.experiment.scenario import ScenarioCache
    from lirs_validation.sweep.tasks import cross

    if len(run.get("seed", ())) > 1:
        raise ConfigError(f"--seed is the first seed of the drives: one number, got {len(run['seed'])}")
    sources, build = map_logs(options.sources, build, options.output)
    configs = cross(sources, build=build, **run)
    budget, scenarios = Budget(options.budget, begun), ScenarioCache()
    answers = decide(configs, options.output, engine, budget, scenarios=scenarios, again=command_with_budget)
    page = write_decision(options.output, answers, command_line(), scenarios)
    out.print(methods_table(answers))
    say(page)
    for answer in answers:
        say(f"verdict: {conclusion(answer)}")
    if options.gate and any(answer.trial.decision != "works" for answer in answers):
        raise Exit(ExitCode.GATE_FAILED)


def command_with_budget(budget: str | None) -> str:
    """Return the command of this process with another budget; None = the default."""
    command = re.sub(r" --budget[= ]('[^']*'|\S+)", "", command_line())
    return command if budget is None else f"{command} --budget {budget}"
