"""Validation runs (world x robot x mapper x seed), their records, reports and command line."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lirs_validation.analysis.results import read_results
    from lirs_validation.config import RunConfig
    from lirs_validation.experiment.run import Run, validate
    from lirs_validation.gui import EmbeddedPage, show
    from lirs_validation.logs.map_log import MappedLog, map_log, resolve_source
    from lirs_validation.record.run_record import RunRecord, read_record
    from lirs_validation.report.run_report import report_of

__all__ = [
    "EmbeddedPage",
    "MappedLog",
    "Run",
    "RunConfig",
    "RunRecord",
    "map_log",
    "read_record",
    "read_results",
    "report_of",
    "resolve_source",
    "show",
    "validate",
]

_HOMES = {
    "EmbeddedPage": "gui",
    "show": "gui",
    "MappedLog": "logs.map_log",
    "map_log": "logs.map_log",
    "resolve_source": "logs.map_log",
    "Run": "experiment.run",
    "validate": "experiment.run",
    "RunConfig": "config",
    "RunRecord": "record.run_record",
    "read_record": "record.run_record",
    "read_results": "analysis.results",
    "report_of": "report.run_report",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
