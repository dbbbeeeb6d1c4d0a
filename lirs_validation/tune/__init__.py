"""Tuning: search for parameters of a mapper that suit one world or log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from lirs_wct.option import Options, documented, one_of, option, within

SEARCHES = ("cma", "random")


@documented
@dataclass(frozen=True, kw_only=True)
class TuneOptions(Options):
    """Search for a mapper's parameters.

    Raises:
        ConfigError: a value is not legal.
    """

    drives: int = option(120, "Drives of the search, shrinking not included.", check=within("[1, 100000]"))
    repeats: int = option(
        3, "Drives of each set of values, each with another seed.", check=within("[1, 100]")
    )
    unseen: int = option(
        10, "Unseen seeds on which the result is compared with the defaults.", check=within("[3, 1000]")
    )
    search: Literal["cma", "random"] = option(
        "cma",
        "CMA-ES (extra `search`), or random values for comparison.",
        metavar="cma|random",
        check=one_of(SEARCHES),
    )
    limits: str | None = option(
        None,
        "YAML file with other limits of the parameters, such as `srr: [0.05, 0.2]`; a number holds one.",
        flags=("--within",),
        metavar="FILE.yaml",
    )
    jobs: int = option(
        1, "Concurrent drives, each in its own process.", metavar="N", check=within("[1, 256]")
    )
    relations: str | None = option(None, "True relations between poses of a log.", metavar="FILE")
    reference: str | None = option(None, "Reference trajectory of a log.", metavar="FILE")
