"""The policy that a command names: one that ships, or the user's own as `module:name`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from lirs_envs.env import RobotEnv
from lirs_envs.policies.blind import RandomActions, StraightAhead
from lirs_envs.policies.go_to_goal import GoToGoal
from lirs_envs.policies.policy import Policy, PolicyContext
from lirs_validation.bench.policies.explorer import Explorer
from lirs_validation.bench.policies.true_map import OnTrueMap
from lirs_validation.bench.tasks import TASKS, BenchTask
from lirs_validation.experiment.own_code import make_own, own_class, own_source_file
from lirs_wct.errors import ConfigError, unknown_name

METHODS = ("reset", "act")


class Baseline(NamedTuple):
    """A policy that ships.

    Attributes:
        make: of what it drives and of its context.
        tasks: that it can be asked for.
        observe: groups of observations that it is given; None = the task's own.
    """

    make: Callable[[RobotEnv, PolicyContext], Policy]
    tasks: tuple[str, ...] = TASKS
    observe: tuple[str, ...] | None = None


BASELINES: Mapping[str, Baseline] = {
    "random": Baseline(lambda env, context: RandomActions(context), observe=("attitude",)),
    "straight": Baseline(lambda env, context: StraightAhead(context), observe=("attitude",)),
    "go_to_goal": Baseline(
        lambda env, context: GoToGoal(context), ("navigation", "traverse"), ("scan", "goal")
    ),
    "frontier": Baseline(Explorer, ("navigation", "mapping")),
    "astar": Baseline(OnTrueMap),
}
"""Policies that ship, by name; the last one plans on the true map and is the upper bound."""
UPPER_BOUND = "astar"


@dataclass(frozen=True)
class PolicyChoice:
    """A policy as a user names it.

    Attributes:
        name: of `BASELINES`, or `module:name`.
        arguments: keywords for a policy of the user's own, as text.
    """

    name: str
    arguments: tuple[tuple[str, str], ...] = ()

    @property
    def label(self) -> str:
        """The name and the arguments, as tables show them."""
        given = ",".join(f"{key}={value}" for key, value in self.arguments)
        return f"{self.name}({given})" if given else self.name

    @property
    def short(self) -> str:
        """The name without its module, fit for a folder's name."""
        return self.name.rpartition(":")[2].replace(".", "_")

    @property
    def files(self) -> list[Path]:
        """Files that decide what it does, as far as they are known: its module's and its arguments'."""
        source = own_source_file(self.name, "policy")
        given = [Path(value) for _, value in self.arguments if Path(value).is_file()]
        return [*([source] if source else []), *given]

    @property
    def observe(self) -> tuple[str, ...] | None:
        """Groups of observations that it asks for; None = the task's own.

        Raises:
            ConfigError: the module cannot be imported, or `observe` is no list of names.
        """
        if self.name in BASELINES:
            return BASELINES[self.name].observe
        names = getattr(self._maker(), "observe", None)
        if names is None:
            return None
        if isinstance(names, str) or not all(isinstance(name, str) for name in names):
            raise ConfigError(f"policy {self.name!r}: observe must be a list of groups, got {names!r}")
        return tuple(names)

    def check(self, task: str) -> None:
        """Look for the policy.

        Raises:
            ConfigError: there is none of that name, or it cannot be asked for this task.
        """
        if self.name not in BASELINES:
            self._maker()
            return
        if task not in BASELINES[self.name].tasks:
            legal = [name for name, baseline in BASELINES.items() if task in baseline.tasks]
            raise ConfigError(
                f"the policy {self.name} is for other tasks than {task}; legal: {', '.join(legal)}"
            )
        if self.arguments:
            raise ConfigError(f"the policy {self.name} takes no arguments, got {self.label}")

    def make(self, env: RobotEnv, task: BenchTask) -> Policy:
        """Make the policy for an episode of a task.

        A class of the user's own gets as keywords what it takes of `context` (see `PolicyContext`),
        `observation_space`, `action_space`, `seed`, and its arguments.

        Raises:
            ConfigError: it cannot be made, does not take its arguments, or is no policy.
        """
        context = PolicyContext.of(env.episodes.config, task.seed)
        if self.name in BASELINES:
            return BASELINES[self.name].make(env, context)
        offered = {
            "context": context,
            "observation_space": env.observation_space,
            "action_space": env.action_space,
            "seed": task.seed,
        }
        maker, arguments = self._maker(), dict(self.arguments)
        _check_taken(maker, arguments, self.name)
        policy = make_own(maker, offered | arguments, self.name, "policy")
        lacking = [f"{name}()" for name in METHODS if not callable(getattr(policy, name, None))]
        if lacking:
            raise ConfigError(
                f"policy {self.name!r}: lacks {', '.join(lacking)}; "
                "a policy has reset(info) and act(observation)"
            )
        made: Policy = policy
        return made

    def _maker(self) -> Callable[..., Any]:
        if ":" not in self.name:
            raise unknown_name("policy", self.name, [*BASELINES, "module:name of your own"])
        return own_class(self.name, "policy", "act")


def _check_taken(maker: Callable[..., Any], arguments: Mapping[str, str], name: str) -> None:
    try:
        parameters = inspect.signature(maker).parameters
    except ValueError:
        return
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values()):
        return
    for argument in arguments:
        if argument not in parameters:
            legal = ", ".join(parameters) or "none"
            raise ConfigError(f"policy {name!r}: takes no argument {argument!r}; it takes {legal}")
