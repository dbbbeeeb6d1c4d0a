"""Arguments that several commands take, and the readers of lists in them."""

from __future__ import annotations

import re
from typing import Annotated

import typer

from lirs_validation.config import DRIVERS, driver_parts
from lirs_wct.errors import ConfigError

SOURCE_HELP = "simple, medium, advanced, a picture, a map YAML, a laser log, a mesh or a built folder."
Sources = Annotated[list[str], typer.Argument(help=SOURCE_HELP)]
Source = Annotated[str, typer.Argument(help=SOURCE_HELP)]
MAX_SEEDS = 100_000


def read_names(text: str, flag: str) -> tuple[str, ...]:
    """Return the names of a comma-separated list, each once.

    Raises:
        ConfigError: a name is missing.
    """
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise ConfigError(f"{flag} must be a list such as a,b,c, got {text!r}")
    return tuple(dict.fromkeys(names))


def read_fields(text: str | None, flag: str) -> dict[str, str]:
    """Return the fields and values of a list such as `mapper=hector,world=medium`; nothing of None.

    Raises:
        ConfigError: it is no such list.
    """
    pairs = [part.partition("=") for part in (text.split(",") if text is not None else ())]
    if not all(name.strip() and value.strip() for name, _, value in pairs):
        raise ConfigError(f"{flag} must be a list such as mapper=hector,world=medium, got {text!r}")
    return {name.strip(): value.strip() for name, _, value in pairs}


def read_drivers(text: str, flag: str = "--driver") -> tuple[str, ...]:
    """Return the drivers of a list such as `tour,replay:out/a,b`, each once.

    A path may hold commas: the list is split where a driver follows.

    Raises:
        ConfigError: one is no driver.
    """
    plain = "|".join(name for name, needs in DRIVERS.items() if not needs)
    needy = "|".join(name for name, needs in DRIVERS.items() if needs)
    drivers = re.split(rf",\s*(?=(?:{plain})\s*(?:,|$)|(?:{needy}):)", text.strip())
    for driver in drivers:
        try:
            driver_parts(driver.strip())
        except ConfigError as error:
            raise ConfigError(f"{flag}: {error}") from error
    return tuple(dict.fromkeys(driver.strip() for driver in drivers))


def read_seeds(text: str, flag: str = "--seeds") -> tuple[int, ...]:
    """Return the seeds of a list such as `1-5` or `1,3,7-9`, each once.

    Raises:
        ConfigError: it is no such list, or has too many seeds.
    """
    seeds: list[int] = []
    for part in text.split(","):
        found = re.fullmatch(r"\s*(\d{1,9})(?:-(\d{1,9}))?\s*", part)
        first, last = (int(found[1]), int(found[2] or found[1])) if found else (1, 0)
        if last < first or last - first >= MAX_SEEDS:
            raise ConfigError(f"{flag} must be a list such as 1-5 or 1,3,7-9, got {text!r}")
        seeds += range(first, last + 1)
    return tuple(dict.fromkeys(seeds))
