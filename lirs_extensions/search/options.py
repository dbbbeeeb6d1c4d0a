"""Options of the searches for failures and for parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from lirs_extensions.bench import UPPER_BOUND
from lirs_validation.config import DRIVABLE, RunConfig
from lirs_wct.errors import ConfigError
from lirs_wct.option import Options, declared, documented, option, within

SEARCH = "Search of parameters"
FAILURE_FACTOR = 3.0
"""Factor by which the path error of a mapper that fails exceeds the limit of `loses its way`."""
POLICY_TASK = "navigation"
"""Task on which `falsify` drives policies."""
_RUN = declared(RunConfig)


@documented
@dataclass(frozen=True, kw_only=True)
class PoolOptions(Options):
    """Processes of a search or replay."""

    jobs: int = option(
        1, "Concurrent drives, each in its own process.", metavar="N", panel=SEARCH, check=within("[1, 256]")
    )


@documented
@dataclass(frozen=True, kw_only=True)
class SearchOptions(PoolOptions):
    """Search of a space of parameters.

    Attributes:
        search: CMA-ES, or random values for comparison.
    """

    search: Literal["cma", "random"] = "cma"
    limits: str | None = option(
        None,
        "YAML file with other limits of the parameters, such as `NAME: [LOW, HIGH]`; a number holds one.",
        metavar="FILE.yaml",
        panel=SEARCH,
    )


@documented
@dataclass(frozen=True, kw_only=True)
class FalsifyOptions(SearchOptions):
    """Search for the failures of one mapper or policy."""

    mapper: str = option(
        "hector",
        "SLAM method under test; module:Class for your own.",
        metavar="NAME|module:Class",
        names=_RUN["mapper"].names,
    )
    policy: str | None = option(
        None, "Policy under test, in place of a mapper (see `bench`).", metavar="NAME|module:Class"
    )
    reference: str | None = option(
        None,
        "Mapper with whose path error a failure is compared; for a policy, the policy that must succeed "
        f"(default: {UPPER_BOUND}).",
        metavar="NAME|module:Class",
    )
    robot: str = option("husky", "Robot.", metavar="NAME", names=_RUN["robot"].names)
    drives: int = option(150, "Drives of the search, confirmations included.", check=within("[1, 100000]"))
    cases: int = option(3, "Cases after which the search ends.", check=within("[1, 20]"))
    seconds: float = option(60.0, "Simulated seconds of a drive.", check=DRIVABLE)
    seed: int = option(1, "Seed of the search, the layout and the first drive.", check=within("[0, inf)"))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.policy is not None and self.mapper != type(self).mapper:
            raise ConfigError(f"--mapper {self.mapper} and --policy {self.policy}: give one of them")
        if self.method == self.compared_with:
            raise ConfigError(f"--reference must be another method than {self.method}, which is under test")

    @property
    def decisive(self) -> dict[str, Any]:
        """Options that decide the results."""
        names = ("search", *(name for name in declared(type(self)) if name not in ("limits", "jobs")))
        return {name: getattr(self, name) for name in names}

    @property
    def method(self) -> str:
        """Name of the mapper or policy under test."""
        return self.policy or self.mapper

    @property
    def compared_with(self) -> str | None:
        """Name of the method that must succeed; None = none."""
        return self.reference or (UPPER_BOUND if self.policy else None)


@documented
@dataclass(frozen=True, kw_only=True)
class TuneOptions(SearchOptions):
    """Search for a mapper's parameters."""

    drives: int = option(120, "Drives of the search, shrinking not included.", check=within("[1, 100000]"))
    repeats: int = option(
        3, "Drives of each set of values, each with another seed.", check=within("[1, 100]")
    )
    unseen: int = option(
        10, "Unseen seeds on which the result is compared with the defaults.", check=within("[3, 1000]")
    )
    relations: str | None = option(None, "True relations between poses of a log.", metavar="FILE")
    reference: str | None = option(None, "Reference trajectory of a log.", metavar="FILE")
