"""Decision: does a method work on a terrain? Drive until it is decided, then try what changes it."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

from lirs_envs.lidar.presets import LIDARS, make_lidar_preset
from lirs_envs.robots.robot import make_robot
from lirs_validation.analysis.as_published import SUFFIX
from lirs_validation.config import RunConfig
from lirs_validation.decision.forecast import forecast
from lirs_validation.decision.trials import CONFIDENCE, Perform, Trial, run_trials
from lirs_validation.driving.choice import make_driver
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_wct import OccupancyGrid
from slam_baselines.mapper import MAPPERS, short_name

LEAST_SHARE = 0.8
"""Share of drives that a sentence promises if the whole interval lies above it."""
LESS, MORE = 0.5, 2.0
"""Factors of the odometry's noise."""


@dataclass(frozen=True)
class Answer:
    """Decision on one method.

    Attributes:
        world: name.
        trial: drives of the method.
        changed: changes by label, and their drives.
    """

    world: str
    trial: Trial
    changed: tuple[tuple[str, Trial], ...] = ()

    @property
    def sentence(self) -> str:
        """Conclusion for the user, with share and interval."""
        config, decision = self.trial.config, self.trial.decision
        if decision == "cannot be driven":
            return _impassable_text(self)
        lead = {"works": "works on", "does not work": "does not work on"}.get(decision, "is undecided on")
        parts = [f"{method_name(config)} {lead} {self.world}: {share_text(self.trial)}."]
        low, _ = self.trial.test.interval
        if decision == "works" and low >= LEAST_SHARE:
            parts.append(f"It works in at least {100 * LEAST_SHARE:.0f} % of the drives.")
        if decision == "undecided":
            parts.append("The budget ended before a decision.")
            if self.trial.forecast is not None:
                parts.append(
                    f"The forecast is that it works in {100 * self.trial.forecast:.0f} % of the drives."
                )
        parts += [_failures_text(self.trial), _changes_text(self), *self.trial.extents]
        return " ".join(part for part in parts if part)

    def to_dict(self) -> dict[str, Any]:
        """Return the answer as JSON stores it."""
        return {
            "world": self.world,
            "sentence": self.sentence,
            "changes": [{"change": label} | _trial_dict(trial) for label, trial in self.changed],
        } | _trial_dict(self.trial)


def decide(
    configs: Sequence[RunConfig],
    out: Path,
    perform: Perform,
    *,
    budget: float,
    report: Callable[[Trial], None] = lambda trial: None,
    retry_failed: bool = False,
) -> tuple[Answer, ...]:
    """Drive every config until its method is decided, then its changes (see `run_trials`).

    Args:
        configs: One config per method and world; seeds count up from theirs.
        out: Folder of the drives' folders.
        perform: Function that runs the drives.
        budget: Wall seconds.
        report: Called with a method's trial before its drives, and with any trial after each drive.
        retry_failed: Whether to repeat drives that failed.

    Raises:
        WctError: a config cannot be driven as it asks, or a drive not be written.
    """
    deadline = time.monotonic() + budget
    worlds, planned = zip(*plan_trials(configs), strict=True)
    for trial in planned:
        report(trial)
    drive = partial(
        run_trials, out=out, perform=perform, deadline=deadline, report=report, retry_failed=retry_failed
    )
    trials = drive(planned)
    named = [
        (k, change.label, Trial(change.config))
        for k, trial in enumerate(trials)
        if trial.decision in ("works", "does not work")
        for change in changes(trial.config, works=trial.decision == "works")
    ]
    tried = drive([t for *_, t in named])
    return tuple(
        Answer(
            worlds[k],
            trial,
            tuple((n[1], t) for n, t in zip(named, tried, strict=True) if n[0] == k and t.drives),
        )
        for k, trial in enumerate(trials)
    )


def plan_trials(configs: Sequence[RunConfig]) -> Iterator[tuple[str, Trial]]:
    """Yield world name and trial of each config; its driver finds a start there.

    Raises:
        WctError: a source or a driver's file cannot be used, or a robot fits nowhere.
    """
    scenarios = ScenarioCache()
    for config in configs:
        world, robot = scenarios.scenario(config).world, make_robot(config.robot)
        make_driver(world, robot, replace(config, seconds=1.0), _no_map)
        yield world.name, Trial(config, forecast=forecast(world, robot, config))


def _no_map() -> OccupancyGrid:
    raise NotImplementedError("no mapper runs while starts are checked")


def method_name(config: RunConfig) -> str:
    """Return mapper and robot as a sentence names them."""
    attitude = " without attitude" if config.attitude == "none" else ""
    return f"{short_name(config.mapper)}{attitude} on {config.robot}"


def forecast_text(trial: Trial) -> str:
    """Return the forecast of a trial as a sentence."""
    name = method_name(trial.config)
    if trial.forecast is None:
        return f"forecast: none for {name} (only for methods and sensors of the study)"
    return f"forecast: {name} works in {100 * trial.forecast:.0f} % of the drives"


def share_text(trial: Trial) -> str:
    """Return share and interval of the drives that worked."""
    test = trial.test
    total = test.successes + test.failures
    if not total:
        return "no drive was evaluated"
    low, high = test.interval
    return (
        f"it worked in {test.successes} of {total} drives ({100 * test.successes / total:.0f} %, "
        f"{100 * CONFIDENCE:.0f} % interval {100 * low:.0f} to {100 * high:.0f} %)"
    )


def _failures_text(trial: Trial) -> str:
    """Return the most frequent failure with an example; empty without one."""
    failed = [drive for drive in trial.drives if drive.kind not in ("works", "not evaluated")]
    if not failed:
        return ""
    kind, count = Counter(drive.kind for drive in failed).most_common(1)[0]
    example = next(drive for drive in failed if drive.kind == kind)
    cause = f": {example.reason.rstrip('.')}" if example.reason else ""
    return f"Most frequent failure: {kind} ({count} of {len(failed)}), as with seed {example.seed}{cause}."


def _impassable_text(answer: Answer) -> str:
    """Return why most drives were not evaluated: they ended early, or were too short."""
    trial, robot = answer.trial, answer.trial.config.robot
    count = f"{trial.unevaluated} of {len(trial.drives)} drives were not evaluated"
    ended = Counter(d.reason for d in trial.drives if d.kind == "not evaluated" and d.reason)
    if not ended:
        return f"{robot} drives too short a path on {answer.world}: {count}; raise --seconds."
    reason, often = ended.most_common(1)[0]
    return f"{robot} cannot drive {answer.world}: {count}; most often ({often}): {reason}."


def _changes_text(answer: Answer) -> str:
    """Return the changes that reverse the decision; empty without one."""
    wanted = "does not work" if answer.trial.decision == "works" else "works"
    found = [
        f"{'' if label.startswith(('with ', 'without ')) else 'with '}{label} "
        f"({trial.test.successes} of {trial.test.successes + trial.test.failures})"
        for label, trial in answer.changed
        if trial.decision == wanted
    ]
    if not found:
        return ""
    return f"It {'fails' if wanted == 'does not work' else 'works'} {', '.join(found)}."


def _trial_dict(trial: Trial) -> dict[str, Any]:
    low, high = trial.test.interval
    return {
        "robot": trial.config.robot,
        "mapper": trial.config.mapper,
        "forecast": trial.forecast,
        "decision": trial.decision,
        "share": trial.test.share,
        "interval": [low, high],
        "drives": [asdict(drive) for drive in trial.drives],
    }


@dataclass(frozen=True)
class Change:
    """A changed run.

    Attributes:
        label: the change in words.
        config: with the change.
    """

    label: str
    config: RunConfig


def changes(config: RunConfig, *, works: bool) -> tuple[Change, ...]:
    """Return changes that may reverse whether a method works."""
    found = [_attitude_change(config), _lidar_change(config, works=works)]
    factor = MORE if works else LESS
    odometry = replace(config, odometry_noise=config.odometry_noise * factor)
    found.append(Change("twice the odometry noise" if works else "half the odometry noise", odometry))
    return tuple(change for change in found if change is not None)


def _attitude_change(config: RunConfig) -> Change | None:
    """Return the run with the IMU's attitude, or without it.

    Methods as published do not use it: their terrain-aware version does. Mappers of clouds do not need it.
    """
    aware = config.mapper.removesuffix(SUFFIX)
    if aware != config.mapper and aware in MAPPERS:
        return Change(f"terrain-aware {aware}", replace(config, mapper=aware, attitude="imu"))
    if config.mapper not in MAPPERS:
        return None
    if config.attitude == "imu":
        return Change("without IMU attitude", replace(config, attitude="none"))
    return Change("with IMU attitude", replace(config, attitude="imu"))


def _lidar_change(config: RunConfig, *, works: bool) -> Change | None:
    """Return the run with the lidar of the next longer range, or the next shorter."""
    own = make_lidar_preset(config.lidar or make_robot(config.robot).lidar)
    others = [preset for preset in map(make_lidar_preset, LIDARS) if preset.rings == own.rings]
    reach = attrgetter("range_max")
    if works:
        chosen = max((p for p in others if reach(p) < own.range_max), key=reach, default=None)
    else:
        chosen = min((p for p in others if reach(p) > own.range_max), key=reach, default=None)
    if chosen is None:
        return None
    return Change(f"lidar {chosen.name} ({chosen.range_max:g} m)", replace(config, lidar=chosen.name))
