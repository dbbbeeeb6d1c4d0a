"""The command `bench`: policies on fixed sets of tasks, one score each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lirs_validation.cli.progress import err, manifest_of_command, out, run_sweep
from lirs_validation.config import EngineOptions
from lirs_wct.errors import ConfigError, OutputError, SourceError, WctError

if TYPE_CHECKING:
    from lirs_extensions.bench.experiment import PolicyResult
    from lirs_extensions.bench.policies import PolicyChoice
    from lirs_extensions.bench.tasks import BenchTask, TaskSet

POLICY_HELP = (
    "random, straight, go_to_goal, pretrained, frontier, astar (the true map: the upper bound), or "
    "module:name of your own: a class or function that makes something with reset(info) and "
    "act(observation) -> action."
)
SetName = Annotated[
    str, typer.Option("--set", metavar="indoor|hills|lirs|generated|FILE.json", help="Set of tasks.")
]
TaskName = Annotated[str, typer.Option(metavar="navigation|mapping|traverse", help="Task.")]
Split = Annotated[str, typer.Option(metavar="train|validation|test|all", help="Which part of the set.")]
Data = Annotated[
    Path | None,
    typer.Option(help="Folder with the maps and pictures that do not ship; found by their content."),
]
PolicyArguments = Annotated[
    list[str] | None,
    typer.Option("--policy-arg", metavar="NAME=VALUE", help="Keyword for your own policy; repeatable."),
]
Pictures = Annotated[bool, typer.Option("--pictures", help="Write a map with the path of each episode.")]
Against = Annotated[
    str | None,
    typer.Option(metavar="POLICY", help="Print paired differences of the scores from those of this policy."),
]
Output = Annotated[
    Path, typer.Option("-o", "--output", help="Folder for the episodes' folders and scores.json.")
]
FEW = 3
"""Episodes in which a policy failed that are named one by one."""


def bench(
    policies: Annotated[list[str], typer.Argument(help=POLICY_HELP)],
    set_name: SetName = "lirs",
    task: TaskName = "navigation",
    split: Split = "test",
    data: Data = None,
    arguments: PolicyArguments = None,
    pictures: Pictures = False,
    against: Against = None,
    output: Output = Path("out"),
    *,
    engine: EngineOptions,
) -> None:
    """Score policies on fixed tasks, and compare them with earlier ones in the folder.

    The same command resumes an interrupted run.
    """
    from lirs_extensions.bench.experiment import BenchExperiment
    from lirs_extensions.bench.policies import PolicyChoice
    from lirs_extensions.bench.tasks import task_set
    from lirs_validation.sweep.sweep import Sweep

    tasks = task_set(set_name)
    chosen = _with_sources(tasks.chosen(task, split), data)
    if against is not None:
        PolicyChoice(against).check(task)
    choices = _read_policies(policies, arguments or [], chosen[0], data)
    experiments = [
        BenchExperiment(
            set_name=tasks.name,
            set_version=tasks.version,
            task=each,
            policy=policy,
            data=data,
            pictures=pictures,
        )
        for policy in choices
        for each in chosen
    ]
    sweep = Sweep(experiments, output, manifest=manifest_of_command(), retry_failed=engine.retry_failed)
    try:
        run_sweep(sweep, engine, lambda: _show(output, tasks, chosen, choices, against))
    except OutputError:
        raise
    except WctError as error:  # a start or a goal of the set
        raise SourceError(f"{set_name}: {error}") from error


def _with_sources(tasks: Sequence[BenchTask], data: Path | None) -> list[BenchTask]:
    """Return the tasks whose worlds can be made; print the errors of the others.

    Raises:
        SourceError: the folder is none, or no world can be made.
    """
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
        err.print(f"skipped {count} tasks in {reason}", markup=False, highlight=False, soft_wrap=True)
    if not found:
        raise SourceError(f"none of the {len(tasks)} tasks can be run: their worlds' files are missing")
    return found


def _read_policies(
    names: Sequence[str], arguments: Sequence[str], task: BenchTask, data: Path | None
) -> list[PolicyChoice]:
    """Return the policies, each of which was made once for a task.

    Raises:
        ConfigError: an argument is no pair, or a policy is none.
    """
    from lirs_extensions.bench.episode import make_task_env
    from lirs_extensions.bench.policies import BASELINES, PolicyChoice

    pairs = [text.partition("=") for text in arguments]
    if not all(name and equals for name, equals, _ in pairs):
        raise ConfigError(f"--policy-arg must be NAME=VALUE, got {' '.join(arguments)!r}")
    given = tuple(sorted((name, value) for name, _, value in pairs))
    choices = [PolicyChoice(name, () if name in BASELINES else given) for name in dict.fromkeys(names)]
    if given and all(choice.name in BASELINES for choice in choices):
        raise ConfigError("--policy-arg is for policies of your own (module:name)")
    for choice in choices:
        choice.check(task.task)
        if choice.name not in BASELINES:
            env = make_task_env(task, data, choice.observe)
            choice.make(env, task)
            env.close()
    return choices


def _show(
    output: Path,
    tasks: TaskSet,
    chosen: Sequence[BenchTask],
    policies: Sequence[PolicyChoice],
    against: str | None,
) -> None:
    """Print the scores of the policies and the table of all, and write them."""
    from lirs_extensions.bench.bench_table import bench_table, score_line, write_scores
    from lirs_extensions.bench.experiment import read_results

    results = read_results(output, tasks, chosen)
    if not results:
        return
    task, splits = chosen[0].task, {each.split for each in chosen}
    split = splits.pop() if len(splits) == 1 else "all"
    for result in results:
        if result.policy in policies:
            _tell_failures(result)
    out.print(bench_table(results, task))
    path = output / f"scores-{tasks.name}-{task}-{split}.json"
    about = {"set": tasks.name, "version": tasks.version, "task": task, "split": split}
    write_scores(path, results, about)
    for result in results:
        if result.policy in policies:
            counted = f"{result.score.count} of {len(chosen)} {task} tasks of {tasks.name} ({split})"
            out.print(score_line(result, counted), markup=False, highlight=False, soft_wrap=True)
    if against is not None:
        _tell_differences(results, against)
    out.print(str(path), markup=False, highlight=False, soft_wrap=True)


def _tell_differences(results: Sequence[PolicyResult], against: str) -> None:
    from lirs_extensions.bench.bench_table import difference_line

    others = [result for result in results if result.policy.name == against]
    if not others:
        err.print(f"no episodes of {against} in the folder: no differences", markup=False, highlight=False)
    for result in results:
        for other in others:
            if result.policy != other.policy:
                out.print(difference_line(result, other), markup=False, highlight=False, soft_wrap=True)


def _tell_failures(result: PolicyResult) -> None:
    failed = {name: entry for name, entry in result.episodes.items() if entry["status"] != "ok"}
    for name, entry in list(failed.items())[:FEW]:
        line = f"{result.policy.label} failed on {name}: {entry['reason']}"
        err.print(line, markup=False, highlight=False, soft_wrap=True, style="red")
    if len(failed) > FEW:
        err.print(f"... and on {len(failed) - FEW} other tasks", highlight=False, style="red")
