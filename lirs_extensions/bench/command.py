"""The command `bench`: policies on fixed sets of tasks, one score each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from lirs_validation.cli.command import SOURCE_HELP, common, complete_source, map_logs
from lirs_validation.cli.progress import command_line, note, out, progress_bar, run_sweep, say
from lirs_validation.config import EngineOptions, World
from lirs_wct.errors import ConfigError, OutputError, SourceError, WctError, unknown_name, within
from lirs_wct.option import Options, argument, changed, option, read_names, read_pairs

if TYPE_CHECKING:
    from lirs_extensions.bench.policies import PolicyChoice
    from lirs_extensions.bench.tasks import BenchTask, TaskSet, WorldSpec

POLICY_HELP = (
    "random, straight, go_to_goal, pretrained, frontier, astar (the true map: the upper bound), or "
    "module:name of your own: a class or function that makes something with reset(info) and "
    "act(observation) -> action."
)
DRAWN = ("navigation", "mapping")
"""Tasks that are drawn; `traverse` has courses of its own."""
OF_SET, OF_WORLD = {"set", "split", "data"}, {"robot", "tasks", "seed"}
"""Options of tasks of a set, and of those that are drawn."""
MAX_LISTED = 3
"""Episodes in which a policy failed that are named one by one."""


@dataclass(frozen=True, kw_only=True)
class BenchCommand(Options):
    """Policies, tasks and results of `bench`."""

    policies: tuple[str, ...] = argument(POLICY_HELP, "POLICIES...", default=())
    task: str = option("navigation", "Task.", metavar="navigation|mapping|traverse")
    parameters: str = option("", "Keywords for your own policy.", metavar="NAME=VALUE,...")
    pictures: bool = option(False, "Write a map with the path of each episode.")
    output: Path = option(Path("out"), "Folder for the episodes' folders and the scores.")
    set: str = option("lirs", "Set of tasks.", metavar="indoor|hills|lirs|generated|FILE.json")
    split: str = option("test", "Which part of the set.", metavar="train|validation|test|all")
    data: Path | None = option(
        None, "Folder with the maps and pictures that do not ship; found by their content.", metavar="FOLDER"
    )
    world: tuple[str, ...] = option(
        (),
        f"Draw tasks in your own worlds: {SOURCE_HELP}",
        metavar="SOURCE...",
        reader=lambda text, label: (text,) if Path(text).exists() else read_names(text, label),
        complete=complete_source,
    )
    robot: str = option("jackal", "Robot in these worlds.")
    tasks: int = option(10, "Tasks in each of these worlds.", check=within("[1, 1000]"))
    seed: int = option(1, "Seed of these tasks.", check=within("[0, 1000]"))


@common("world", "robot", "tasks", "seed", "task", "set", "split", "data", "output", "pictures", "jobs")
def bench(given: Annotated[dict[str, Any], BenchCommand], engine: EngineOptions, build: World) -> None:
    """Score policies on tasks in your worlds or of a set.

    Earlier ones in the folder stand beside them. Differences are paired, from the first policy.
    The same command resumes an interrupted run.

    Examples:
    lirs-wct bench pretrained my_policy:MyPolicy --world map.yaml office.yaml --robot jackal -o out/
    lirs-wct bench straight go_to_goal astar --set lirs --task navigation -o out/
    """
    from lirs_extensions.bench import drawing, episode, policies, tasks as known_tasks
    from lirs_validation.sweep.sweep import Sweep

    options = BenchCommand(**given)
    places: Sequence[WorldSpec] = ()
    task, output, data = options.task, options.output, options.data
    names, worlds = _split_words(options.policies, options.world, policies.BASELINES)
    if worlds:
        if task not in DRAWN:
            raise unknown_name("--task in worlds of your own", task, DRAWN)
        _refuse(given.keys() & OF_SET, "for tasks of a set; --world draws its own")
        sources, build = map_logs(worlds, build, output)
        with progress_bar("tasks") as progress:
            places = drawing.find_worlds(sources, build)
            tasks = drawing.draw_set(places, task, options.robot, options.tasks, options.seed, progress)
        chosen = [*tasks.tasks]
    else:
        _refuse(given.keys() & OF_WORLD | changed(build).keys(), "for --world, which is not given")
        tasks = known_tasks.task_set(options.set)
        chosen = _with_sources(tasks.chosen(task, options.split), data)
    choices = _read_policies(names or policies.DEFAULTS[task], options.parameters, chosen[0], data)
    episodes = [
        episode.EpisodeTask(
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
        run_sweep(sweep, engine, lambda: _show(output, tasks, chosen, choices, places))
    except OutputError:
        raise
    except WctError as error:  # a start or a goal of the set
        raise SourceError(f"{tasks.name}: {error}") from error


def _split_words(
    words: Sequence[str], worlds: Sequence[str], baselines: Collection[str]
) -> tuple[Sequence[str], Sequence[str]]:
    """Return policies and worlds; after `--world`, words that name no policy are worlds too."""
    if not worlds:
        return words, worlds
    policies = [word for word in words if word in baselines or ":" in word]
    others = [word for word in words if word not in policies]
    for word in others:
        if not Path(word).exists() and word not in complete_source(word):
            raise unknown_name("policy or world", word, [*baselines, "module:name of your own", "a file"])
    return policies, [*worlds, *others]


def _refuse(given: Collection[str], reason: str) -> None:
    """Raise ConfigError if there are given options."""
    if given:
        flags = ", ".join(f"--{name.replace('_', '-')}" for name in sorted(given))
        raise ConfigError(f"{flags}: {reason}")


def _with_sources(tasks: Sequence[BenchTask], data: Path | None) -> list[BenchTask]:
    """Return the tasks whose worlds can be made; print the errors of the others."""
    if data is not None and not data.is_dir():
        raise SourceError(f"{data}: no such folder")
    missing = Counter[str]()
    found = []
    for task in tasks:
        try:
            if task.world is not None:
                task.world.places(data)
            found.append(task)
        except SourceError as error:
            missing[str(error)] += 1
    for reason, count in missing.items():
        note(f"skipped {count} tasks in {reason}")
    if not found:
        raise SourceError(f"none of the {len(tasks)} tasks can be run: their worlds' files are missing")
    return found


def _read_policies(
    names: Sequence[str], parameters: str, task: BenchTask, data: Path | None
) -> list[PolicyChoice]:
    """Return the policies, each of which was made once for a task."""
    from lirs_extensions.bench import episode, policies

    given = tuple(sorted(read_pairs(parameters, "--parameters").items()))
    choices = [
        policies.PolicyChoice(name, () if name in policies.BASELINES else given)
        for name in dict.fromkeys(names)
    ]
    if given and all(choice.name in policies.BASELINES for choice in choices):
        raise ConfigError("--parameters are for policies of your own (module:name)")
    for choice in choices:
        choice.check(task.task)
        if choice.name not in policies.BASELINES:
            env = episode.make_task_env(task, data, choice.observe)
            choice.make(env, task)
            env.close()
    return choices


def _show(
    output: Path,
    tasks: TaskSet,
    chosen: Sequence[BenchTask],
    policies: Sequence[PolicyChoice],
    worlds: Sequence[WorldSpec],
) -> None:
    """Print the scores of the policies and the table of all, and write them."""
    from lirs_extensions.bench import results as found

    results = found.read_results(output, tasks, chosen)
    if not results:
        return
    for result in results:
        if result.policy in policies:
            for name, reason in list(result.failed.items())[:MAX_LISTED]:
                note(f"{result.policy.label} failed on {name}: {reason}", style="red")
            if len(result.failed) > MAX_LISTED:
                note(f"... and on {len(result.failed) - MAX_LISTED} other tasks", style="red")
    out.print(found.bench_table(results, chosen[0].task))
    stem, about, places = _describe(tasks, chosen, worlds)
    path = output / f"scores-{stem}.json"
    found.write_scores(path, results, about)
    say(path)
    own = [result for policy in policies for result in results if result.policy == policy]
    for other in own[1:]:
        say(found.difference_line(other, own[0]))
    for where, held in places.items():
        say(found.answer_line(own, held, where))


def _describe(
    tasks: TaskSet, chosen: Sequence[BenchTask], worlds: Sequence[WorldSpec]
) -> tuple[str, dict[str, object], dict[str, Sequence[BenchTask]]]:
    """Return name of the scores' file, its entries about tasks, and tasks by place."""
    task, splits = chosen[0].task, {each.split for each in chosen}
    if not worlds:
        split = splits.pop() if len(splits) == 1 else "all"
        about = {"set": tasks.name, "version": tasks.version, "task": task, "split": split}
        return f"{tasks.name}-{task}-{split}", about, {f"{tasks.name} ({split})": chosen}
    places = {world.name: [each for each in chosen if each.world == world] for world in worlds}
    total = {f"{len(worlds)} worlds": chosen} if len(worlds) > 1 else {}
    return task, {"task": task, "worlds": [world.describe() for world in worlds]}, {**places, **total}
