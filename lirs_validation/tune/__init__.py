"""Tuning: search for parameters of a mapper that suit one world or log."""

from __future__ import annotations

from dataclasses import dataclass

from lirs_validation.config import SearchOptions
from lirs_wct.option import documented, option, within


@documented
@dataclass(frozen=True, kw_only=True)
class TuneOptions(SearchOptions):
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
    relations: str | None = option(None, "True relations between poses of a log.", metavar="FILE")
    reference: str | None = option(None, "Reference trajectory of a log.", metavar="FILE")
