"""Crossing of run options: every combination of their values is a run."""

from __future__ import annotations

import itertools
from dataclasses import fields
from typing import Any

from lirs_validation.config import RunConfig
from lirs_wct.sources.options import BuildOptions


def cross(
    sources: str | tuple[str, ...],
    *,
    build: BuildOptions | None = None,
    kind: type[RunConfig] = RunConfig,
    **options: Any,
) -> tuple[RunConfig, ...]:
    """Return the config of every combination, source by source, in the order of RunConfig's fields.

    >>> [(c.mapper, c.seed) for c in cross("simple", mapper=("hector", "gmapping"), seed=(1, 2))]
    [('hector', 1), ('hector', 2), ('gmapping', 1), ('gmapping', 2)]

    Args:
        sources: one or several.
        build: how sources become worlds; None = the defaults.
        kind: class of the configs.
        **options: fields of RunConfig; a tuple holds the values to cross, anything else is one value.

    Raises:
        ConfigError: a value is not legal.
    """
    names = sorted(options, key=[f.name for f in fields(kind)].index)
    values = [options[name] if isinstance(options[name], tuple) else (options[name],) for name in names]
    worlds = (sources,) if isinstance(sources, str) else sources
    shared: dict[str, Any] = {} if build is None else {"build": build}
    return tuple(
        kind(source=source, **dict(zip(names, crossing, strict=True)), **shared)
        for source, *crossing in itertools.product(worlds, *values)
    )
