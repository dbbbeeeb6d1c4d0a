"""The judge: world x robot x mapper x seed becomes a run record; also the doors, command line and report."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lirs_validation.offline.log_source import resolve_source
    from lirs_validation.offline.mapping import MappedLog, map_log
    from lirs_validation.record import RunConfig, RunRecord, read_record
    from lirs_validation.run import Run, validate

__all__ = [
    "MappedLog",
    "Run",
    "RunConfig",
    "RunRecord",
    "map_log",
    "read_record",
    "resolve_source",
    "validate",
]

_HOMES = {
    "MappedLog": "offline.mapping",
    "map_log": "offline.mapping",
    "resolve_source": "offline.log_source",
    "Run": "run",
    "validate": "run",
    "RunConfig": "record",
    "RunRecord": "record",
    "read_record": "record",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
