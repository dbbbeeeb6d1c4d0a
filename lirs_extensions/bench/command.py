"""The command `bench`: policies on fixed sets of tasks, one score each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lirs_validation.cli.progress import command_line, note, out, run_sweep, say
from lirs_validation.config import EngineOptions
from lirs_wct.errors import ConfigError, OutputError, SourceError, WctError
from lirs_wct.option import Options, argument, option, read_pairs

if TYPE_CHECKING:
    from lirs_extensions.bench.policies import PolicyChoice
    from lirs_extensions.bench.tasks import BenchTask, TaskSet

POLICY_HELP = (
    "random, straight, go_to_goal, pretrained, frontier, astar (the true map: the upper bound), or "
    "module:name of your own: a class or function that makes something with reset(info) and "
    "act(observation) -> action."
)
MAX_LISTED = 3
"""Episodes in which a policy failed that are named one by one."""


@dataclass(frozen=True, kw_only=True)
class BenchCommand(Options):
    """Policies, tasks and results of `bench`."""

    policies: tuple[str, ...] = argument(POLICY_HELP, "POLICIES...")
    set: str = option("lirs", "Set of tasks.", metavar="indoor|hills|lirs|generated|FILE.json")
    task: str = option("navigation", "Task.", metavar="navigation|mapping|traverse")
    split: str = option("test", "Which part of the set.", metavar="train|validation|test|all")
    data: Path | None = option(
        None, "Folder with the maps and pictures that do not ship; found by their content.", metavar="FOLDER"
    )
    parameters: str = option("", "Keywords for your own policy.", metavar="NAME=VALUE,...")
    pictures: bool = option(False, "Write a map with the path of each episode.")
    output: Path = option(Path("out"), "Folder for the episodes' folders and scores.json.")


def bench(options: BenchCommand, engine: EngineOptions) -> None:
    """Score policies on fixed tasks, and compare them with earlier ones in the folder.

    Differences are paired, from the first policy. The same command resumes an interrupted run.

    Examples:
    lirs-wct bench straight go_to_goal astar --set lirs --task navigation -o out/
    lirs-wct bench my_policy:MyPolicy --set hills -o out/
    """
    from lirs_extensions.bench.episode import EpisodeTask
    from lirs_extensions.bench.tasks import task_set
    from lirs_validation.sweep.sweep import Sweep

    tasks, data, output = task_set(options.set), options.data, options.output
    chosen = _with_sources(tasks.chosen(options.task, options.split), data)
    choices = _read_policies(options.policies, options.parameters, chosen[0], data)
    episodes = [
        EpisodeTask(
            set_name=tasks.name,
            set_version=tasks.version,
            task=each,
            policy=policy,
            data=data,
            pictures=options.pictures,
        )
        for policy in choices
        for each in chosen
    ]
    sweep = Sweep(episodes, output, command=command_line(), retry_failed=engine.retry_failed)
    try:
        run_sweep(sweep, engine, lambda: _show(output, tasks, chosen, choices))
    except OutputError:
        raise
    except WctError as error:  # a start or a goal of the set
        raise SourceError(f"{options.set}: {error}") from error


def _with_sources(tasks: Sequence[BenchTask], data: Path | None) -> list[BenchTask]:
    """Return the tasks whose worlds can be made; print the errors of the others."""
    if data is not None and not data.is_dir():
        raise SourceError(f"{data}: no such folder")
    missing: dict[str, str] = {}
    found = []
    for task in tasks:
        try:
            if task.world is not None:
                task.world.places(data)
            found.append(task)
        except SourceError as error:
            missing[str(error)] = task.place
    for reason, place in missing.items():
        count = sum(task.place == place for task in tasks)
        note(f"skipped {count} tasks in {reason}")
    if not found:
        raise SourceError(f"none of the {len(tasks)} tasks can be run: their worlds' files are missing")
    return found


def _read_policies(
    names: Sequence[str], parameters: str, task: BenchTask, data: Path | None
) -> list[PolicyChoice]:
    """Return the policies, each of which was made once for a task."""
    from lirs_extensions.bench.episode import make_task_env
    from lirs_extensions.bench.policies import BASELINES, PolicyChoice

    given = tuple(sorted(read_pairs(parameters, "--parameters").items()))
    choices = [PolicyChoice(name, () if name in BASELINES else given) for name in dict.fromkeys(names)]
    if given and all(choice.name in BASELINES for choice in choices):
        raise ConfigError("--parameters are for policies of your own (module:name)")
    for choice in choices:
        choice.check(task.task)
        if choice.name not in BASELINES:
            env = make_task_env(task, data, choice.observe)
            choice.make(env, task)
            env.close()
    return choices


def _show(
    output: Path, tasks: TaskSet, chosen: Sequence[BenchTask], policies: Sequence[PolicyChoice]
) -> None:
    """Print the scores of the policies and the table of all, and write them."""
    from lirs_extensions.bench.results import (
        bench_table,
        difference_line,
        read_results,
        score_line,
        write_scores,
    )

    results = read_results(output, tasks, chosen)
    if not results:
        return
    task, splits = chosen[0].task, {each.split for each in chosen}
    split = splits.pop() if len(splits) == 1 else "all"
    for result in results:
        if result.policy in policies:
            failed = {name: entry for name, entry in result.episodes.items() if entry["status"] != "ok"}
            for name, entry in list(failed.items())[:MAX_LISTED]:
                note(f"{result.policy.label} failed on {name}: {entry['reason']}", style="red")
            if len(failed) > MAX_LISTED:
                note(f"... and on {len(failed) - MAX_LISTED} other tasks", style="red")
    out.print(bench_table(results, task))
    path = output / f"scores-{tasks.name}-{task}-{split}.json"
    about = {"set": tasks.name, "version": tasks.version, "task": task, "split": split}
    write_scores(path, results, about)
    for result in results:
        if result.policy in policies:
            counted = f"{result.score.count} of {len(chosen)} {task} tasks of {tasks.name} ({split})"
            say(score_line(result, counted))
    own = [result for policy in policies for result in results if result.policy == policy]
    for other in own[1:]:
        say(difference_line(other, own[0]))
    say(path)
